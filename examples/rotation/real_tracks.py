"""What ``torchlc rotation`` says of real debris: 10 Hz tracks of Mini-MegaTORTORA, each by itself and those of one body together.

    python examples/rotation/real_tracks.py docs/evidence [--only TEXT]

Results go to tumbling.json in the folder given, a search after the other; those that are there are not done again. The tracks are looked
for in ../shared/data/tumbling; without them the script says so and ends.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from unseen_pass import unseen

import torchlc
from torchlc.api import usable
from torchlc.readers.joining import joined
from torchlc.results.rotation_result import RotationResult
from torchlc.terminal import quiet_libraries

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "tumbling"
SKIN = """
[materials.{name}]
n = {{ value = 50.0, low = 1.0, high = 1e5, prior = "loguniform" }}
r_spec = {{ value = 0.3, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.3, low = 0.0, high = 1.0 }}
"""
PAINTS = """material = "skin"
face_materials = { "cap+" = "fore end", "cap-" = "aft end" }
sectors = [{ start = -90.0, width = 180.0, material = "other side" }]
"""
"""The half of a cylinder's side about body +Y of its own paint, which a flat spin about Z turns to and away, and both ends."""


@dataclass(frozen=True)
class Search:
    """Tracks searched together for turns between ``shortest`` and ``longest``, s, as a body of one paint or ``painted`` in four."""

    tracks: Sequence[str]
    shortest: float
    longest: float
    painted: bool = False


ATLAS = ("10025_10419535", "10025_21881793", "10025_27890120")
TRANSTAGE = ("1863_10198570", "1863_32164168")
SEARCHES = {
    **{f"10025, {when}": Search((track,), 4.0, 40.0) for when, track in zip(("2016", "2022", "2024"), ATLAS, strict=True)},
    "10025, three passes": Search(ATLAS, 11.0, 13.5),
    "10025, three passes, four paints": Search(ATLAS, 11.0, 13.5, painted=True),
    **{f"1863, {when}": Search((track,), 0.6, 6.0) for when, track in zip(("2016", "2025"), TRANSTAGE, strict=True)},
    "1863, two passes": Search(TRANSTAGE, 1.3, 3.6),
    "40209": Search(("40209_25396882",), 2.0, 40.0),
    "FLTSATCOM 2": Search(("11353_32585200",), 18.0, 360.0),
}  # fmt: skip


def scene_text(search: Search) -> str:
    """The scene of its last track; painted, the cylinder has four materials."""
    text = (DATA / f"scene_{search.tracks[-1]}.toml").read_text()
    if not search.painted:
        return text
    text = text.replace('material = "skin"\n', PAINTS, 1)
    skins = "".join(SKIN.format(name=f'"{name}"') for name in ("fore end", "aft end", "other side"))
    return text.replace("[model]", f"{skins}\n[model]", 1)


def successive_noise(recordings: Sequence[torchlc.Recording]) -> float:
    """1.4826 median |difference of rows at most 0.25 s apart| / sqrt 2, mag."""
    steps = [
        np.diff(one.observed)[np.diff(one.seconds) < 0.25]
        for one in recordings
        for one in [one.keep(~one.upper_limit, "a limit")]
    ]
    return float(1.4826 * np.median(np.abs(np.concatenate(steps))) / np.sqrt(2))


def told(search: Search) -> dict[str, Any]:
    """The answer and what it rests on; of several passes also how well some predict the others."""
    files = [DATA / f"track_{track}.ecsv" for track in search.tracks]
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "scene.toml"
        scene_file.write_text(scene_text(search))
        found = torchlc.rotation(scene_file, *files, shortest=search.shortest, longest=search.longest)
        seconds = time.process_time() - began
        scene = torchlc.load(scene_file)
        rows = [usable(scene, file) for file in files]
    return {
        "searched_s": [search.shortest, search.longest],
        "rows": [int((~one.upper_limit).sum()) for one in rows],
        "noise": successive_noise(rows),
        **{
            key: found.to_json()[key] for key in ("verdict", "decided", "modes", "phase_per_pass", "warnings")
        },
        "unseen": left_out(found, rows),
        "cpu_seconds": seconds,
    }


def left_out(found: RotationResult, rows: Sequence[torchlc.Recording]) -> list[dict[str, Any]]:
    """Each pass predicted by the others with the best rotation, in which each has a phase of its own."""
    if len(rows) < 2:
        return []
    scene = (found.search.loose or found.modes)[0].scene
    recording = joined(list(rows))
    return [vars(unseen(scene, recording, night)) for night in recording.night_ids]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", default="", help="searches whose name contains this")
    options = parser.parse_args()
    if not DATA.is_dir():
        parser.exit(0, f"{DATA} is not here: nothing to do\n")
    torch.set_num_threads(1)
    quiet_libraries()
    file = options.out / "tumbling.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    for name, search in SEARCHES.items():
        if options.only not in name or name in known:
            continue
        known[name] = told(search)
        file.write_text(json.dumps(known, indent=1) + "\n")
        print(f"{name}: {known[name]['verdict']}, {known[name]['cpu_seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
