"""Families of Mini-MegaTORTORA's satellites: the tracks of one design in one fit, and each predicted by the others.

    python examples/calibration/mmt9_families.py DIRECTORY [--only TEXT]

Scenes are nominal, so sizes, the attitude, the angle of the arrays and the materials are free, and shared by all tracks of a family;
each satellite has an offset from a population whose spread is learnt. Rows err by what successive rows of their camera differ by, and
by what the family learns beyond that. What remains of a track, and of a track that was left out, is told beside that noise. Results go
to mmt9_families.json. Needs ../shared/data/mmt9; without it the script says so and ends.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchlc
from torchlc.diagnosis.alternatives import with_free_sizes
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.readers import Recording
from torchlc.terminal import quiet_libraries

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "mmt9"
THIN = 12
"""Of the rows, which come at 10 Hz: what a model leaves lasts longer than 1.2 s."""
STARTS, ADAM_STEPS = 8, 100
FREED = """[model]
effects = ["attitude_offset", "panel_offset", "sun_distance", "jitter"]
[model.parameters]
zero_point = { value = 0.0, sigma = 0.2, per = "object" }
"jitter.mag" = { value = 0.1, sigma = 0.3, prior = "halfnormal" }
"panel_offset.deg" = { value = 0.0, sigma = 20.0, low = -180.0, high = 180.0, prior = "normal" }
band_sun_magnitude = -26.74
"""
"""Of every family's scene in place of its bare facet sum."""


def families() -> dict[str, list[str]]:
    """Numbers of the tracks of each family, by the scenes' names."""
    found: dict[str, list[str]] = {}
    for scene in sorted(DATA.glob("scene_*.toml")):
        number = scene.stem.partition("_")[2]
        name = torchlc.Scene.from_toml(scene.read_text(), DATA).name.partition(",")[0]
        found.setdefault(name, []).append(number)
    return found


def successive_noise(mag: np.ndarray, curve: Sequence[str]) -> float:
    """1.4826 median |successive difference| / sqrt 2 within the cameras, mag."""
    steps = [np.diff(mag[np.array(curve) == one]) for one in dict.fromkeys(curve)]
    return float(1.4826 * np.median(np.abs(np.concatenate(steps))) / np.sqrt(2))


def track(number: str) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of a track's table."""
    lines = [line for line in (DATA / f"track_{number}.ecsv").read_text().splitlines() if line[0] != "#"]
    return lines[0].split(), [line.split() for line in lines[1:]]


def family(numbers: Sequence[str], folder: Path) -> tuple[torchlc.Scene, Recording, dict[str, float]]:
    """Scene with all that is nominal free, all tracks in one recording, each an object, and the noise of successive rows of each."""
    text = (DATA / f"scene_{numbers[0]}.toml").read_text().split("[model]")[0]
    scene = with_free_sizes(torchlc.Scene.from_toml(text + FREED, DATA))
    assert scene is not None
    lines, noise = [], {}
    for number in numbers:
        names, rows = track(number)
        mag, curve = names.index("mag"), names.index("curve")
        noise[number] = successive_noise(
            np.array([float(row[mag]) for row in rows]), [row[curve] for row in rows]
        )
        lines = lines or [",".join([*names, "mag_err", "object"])]
        for row in rows[::THIN]:
            row[curve] = f"{number} {row[curve]}"
            lines.append(",".join([*row, f"{noise[number]:.4f}", number]))
    path = folder / "family.csv"
    path.write_text("\n".join(lines) + "\n")
    scene, recording = torchlc.load(scene, path)
    return scene, recording, noise


def fitted(scene: torchlc.Scene, recording: Recording) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording and its most probable theta."""
    model = torchlc.LightCurve(scene, recording)
    return model, fit_map(Likelihood(model), starts=STARTS, adam_steps=ADAM_STEPS).theta


def left(scene: torchlc.Scene, recording: Recording, names: Sequence[str], theta: torch.Tensor) -> np.ndarray:
    """Recorded minus model, mag, (T,), at another recording's theta: every satellite at the mean of its population."""
    model = torchlc.LightCurve(scene, recording)
    assert model.names == list(names)
    with torch.no_grad():
        return recording.observed - model(theta).numpy()


def rms(delta: np.ndarray) -> float:
    return float(np.sqrt(np.mean(delta**2)))


def told(numbers: Sequence[str]) -> dict[str, Any]:
    """What the shared model of a family leaves, track by track, and what it leaves of tracks that it has not seen."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, noise = family(numbers, Path(folder))
    assert recording.object is not None
    ids = list(recording.object_ids)
    model, theta = fitted(scene, recording)
    seen = left(scene, recording, model.names, theta)
    tracks = {}
    for number in numbers:
        own = recording.object == ids.index(number)
        one, other = fitted(scene, recording.keep(~own, "left out"))
        unseen = left(scene, recording.keep(own, "fitted to"), one.names, other)
        tracks[number] = {
            "rows": int(own.sum()),
            "noise": noise[number],
            "recorded": float(np.std(recording.observed[own])),
            "rms": rms(seen[own]),
            "rms_about_own_offset": float(np.std(seen[own])),
            "unseen_rms": rms(unseen),
            "unseen_rms_about_own_offset": float(np.std(unseen)),
        }
        print(number, tracks[number], flush=True)
    return {
        "parameters": dict(zip(model.names, theta.tolist(), strict=True)),
        "tracks": tracks,
        "cpu_seconds": time.process_time() - began,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", default="", help="families whose name contains this")
    options = parser.parse_args()
    if not DATA.is_dir():
        print(f"{DATA} is not here: nothing to do")
        return
    torch.set_num_threads(1)
    quiet_libraries()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "mmt9_families.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    for name, numbers in families().items():
        if options.only in name:
            known[name] = told(numbers)
            file.write_text(json.dumps(known, indent=1) + "\n")
            print(f"{name}: {known[name]['cpu_seconds']:.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
