"""A laboratory's body before a lamp, as its organisers published the geometry: scene and recording for torchlc.

    python examples/calibration/laboratory.py DIRECTORY [--rows NAME] [--sense -1]

Body 3 of the Helsinki Asteroid Challenge 2026: a known shape, 21 cameras, one turn, each curve divided by its own mean. The page does not
state the sense of the turn nor the cameras' distance: the sense is an argument, the distance 30 half heights, which an effect may
correct. Needs ../shared/data/hac_body03; without it the script says so and ends.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tomllib
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "hac_body03"
START = np.datetime64("2026-01-01T00:00:00", "ms")
TURN_S = 3600.0
"""Seconds that a turn is given: only angles are recorded."""
CAMERA_KM, LAMP_KM = 0.03, 1.5e8
"""A camera at 30 m of a body of 1 m stands for one of unknown distance, a lamp at 1 au for a parallel beam."""
SCENE = """format = "torchlc-scene/1"
name = "{title}"

[orbit]
vectors = "icrs"

[attitude]
mode = "inertial"
x_angle = 0.0
spin_axis = [0, 0, 1]
spin_rate = {rate}     # rev/h
spin_epoch = "{start}"

[[components]]
name = "body"
shape = "mesh"
file = "shape.obj"
centre = [0, 0, 0]
material = "paint"

[materials.paint]       # matte white
model = "lambert"
albedo = 0.8

[model]
effects = []
"""


def directions(camera: str, geometry: dict) -> np.ndarray:
    """Unit vector (3,) from the body to a camera, az045_top say."""
    azimuth, _, level = camera[2:].partition("_")
    top = geometry["elevation_top_deg"][str(int(azimuth))]
    height = np.radians({"hor": geometry["elevation_hor_deg"], "top": top, "bottom": -top}[level])
    around = np.radians(180.0 + int(azimuth))
    return np.array([np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)])


def written(out: Path, sense: int = -1, data: Path = DATA, rows: str = "blender.csv") -> tuple[Path, Path]:
    """Scene and recording in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    published = tomllib.loads((data / "geometry.toml").read_text())
    scene, recording = out / "scene.toml", out / "recording.csv"
    scene.write_text(SCENE.format(title=published["title"], rate=sense * 3600.0 / TURN_S, start=START))
    shutil.copy(data / "shape.obj", out / "shape.obj")
    lines = ["time,flux,curve,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z"]
    with (data / rows).open() as stream:
        for row in csv.DictReader(stream):
            seconds = float(row["angle_deg"]) / 360.0 * TURN_S
            time = START + np.timedelta64(round(1000 * seconds), "ms")
            to_camera = CAMERA_KM * directions(row["camera"], published["cameras"])
            place = ",".join(f"{value:.9f}" for value in (-LAMP_KM, 0.0, 0.0, *to_camera))
            lines.append(f"{time},{row['intensity']},{row['camera']},{place}")
    recording.write_text("\n".join(lines) + "\n")
    return scene, recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument(
        "--rows", default="blender.csv", help="table of the folder with frame, angle, camera, intensity"
    )
    parser.add_argument("--sense", type=int, default=-1, choices=(-1, 1), help="of the turn about +z")
    options = parser.parse_args()
    if not DATA.is_dir():
        print(f"{DATA} is not here: nothing to do")
        return
    scene, recording = written(options.out, options.sense, rows=options.rows)
    print(f"torchlc diagnose {scene} {recording} -o {options.out / 'diagnosis'}")


if __name__ == "__main__":
    main()
