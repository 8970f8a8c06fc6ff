"""An analyst: elements of forty objects and a folder of recordings, to the four that stand out and their verdicts.

    python examples/forty_objects.py [DIRECTORY]

Forty satellites stand along the demo's orbit. Each has a recording of twelve rows in a file named by its catalogue number;
the clock of every tenth camera was two minutes late. Files are matched to objects, scenes and manifest are written, every recording is
compared with its scene, and the four that fit worst are diagnosed. They are the four with the late clock. Twelve rows cannot tell a
clock from other materials: the verdict is "adequate", and longer recordings would be the next step.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path

import numpy as np

import torchlc
from torchlc.cli import run

DEMO = Path(torchlc.__file__).parent / "demo"
OBJECTS, EVERY, WORST = 40, 10, 4
STATION = "weihai,37.536,122.05,110"
SHAPE = "box-wing"
LATE_S = 120.0


def elements(number: int, lines: tuple[str, str]) -> tuple[str, str]:
    """The demo's elements under another number, a fraction of a degree further along the orbit, with new checksums."""
    first, second = (f"{line[:2]}{number:05}{line[7:68]}" for line in lines)
    anomaly = (float(second[43:51]) + 0.2 * (number - 90_000)) % 360
    second = f"{second[:43]}{anomaly:8.4f}{second[51:]}"
    return checked(first), checked(second)


def checked(line: str) -> str:
    total = sum(int(sign) if sign.isdigit() else sign == "-" for sign in line[:68])
    return f"{line[:68]}{total % 10}"


def make_data(folder: Path) -> Path:
    """Elements of all objects, and a recording of each."""
    from torchlc.cli.scaffold import new_scene, read_station
    from torchlc.scene.tle import Elements

    scene = torchlc.load(DEMO / "scene.toml")
    assert scene.orbit.tle is not None
    lines = (scene.orbit.tle[0], scene.orbit.tle[1])
    catalogue = []
    for index in range(OBJECTS):
        number = 90_001 + index
        both = elements(number, lines)
        catalogue += [f"OBJECT {index + 1:02}", *both]
        truth = torchlc.Scene.from_toml(
            new_scene(Elements("", both), SHAPE, station=read_station(STATION), exact=True)
        )
        curve = torchlc.simulate(
            truth, start="2020-10-17T15:00:00", hours=0.2, cadence=65, noise=0.02, seed=index
        )
        late = LATE_S if index % EVERY == 0 else 0.0
        with (folder / f"{number}.csv").open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["time", "mag", "mag_err"])
            days = curve.recording.seconds / 86400 + 2459140.125
            writer.writerows(
                (f"{day + late / 86400:.7f}", f"{mag:.4f}", "0.02")
                for day, mag in zip(days, curve.mag, strict=True)
            )
    (folder / "elements.txt").write_text("\n".join(catalogue) + "\n")
    return folder / "elements.txt"


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()) / "forty_objects"
    out.mkdir(parents=True, exist_ok=True)
    catalogue = make_data(out)
    assert run(["campaign", "init", str(catalogue), str(out), "--shape", SHAPE, "--station", STATION, "--exact", "--force", "--quiet"]) == 0  # fmt: skip
    with (out / "manifest.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    misfit = {}
    for row in rows:
        scene, recording = torchlc.load(out / row["scene"], out / row["recording"])
        curve = torchlc.simulate(scene, recording)
        misfit[row["id"]] = float(np.sqrt(np.mean((recording.observed - curve.mag) ** 2)))
    worst = sorted(rows, key=lambda row: -misfit[row["id"]])[:WORST]
    for row in worst:
        row["options"] = "--quick --effects time_offset"
    with (out / "worst.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(worst[0]))
        writer.writeheader()
        writer.writerows(worst)
    result = torchlc.campaign(out / "worst.csv", out=out / "results", workers=1)
    print(f"{len(rows)} objects matched; {result}")
    for row in result.rows():
        print(f"{row['id']}  rms {misfit[row['id']]:.3f} mag  {row['result'] or row['reason']}")
    print(f"open {out / 'results' / 'index.html'}")


if __name__ == "__main__":
    main()
