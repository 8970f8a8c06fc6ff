"""What diagnose says of real recordings left alone: Eros, a laboratory's body, Starlink over Pomenis, the tracks of Mini-MegaTORTORA.

    python examples/calibration/real_recordings.py docs/real_data [--only TEXT] [--budget SECONDS]

Results go to verdicts.json in the folder given, a recording after the other; those that are there are not done
again. The recordings are looked for in ../shared/data.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import laboratory
import numpy as np
import torch

import torchlc
from torchlc.diagnosis.run import diagnose
from torchlc.diagnosis.values import effect_parameters
from torchlc.inference.density import Fitted
from torchlc.terminal import quiet_libraries

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
MOST = 6


def recordings() -> Iterator[tuple[str, Path, Path]]:
    """Name, scene and recording of each."""
    with tempfile.TemporaryDirectory() as folder:
        yield "hac_body03", *laboratory.written(Path(folder))
    for name in ("eros", "starlink_v15"):
        yield name, DATA / name / "scene.toml", DATA / name / "recording.ecsv"
    for track in sorted((DATA / "mmt9").glob("track_*.ecsv")):
        number = track.stem.partition("_")[2]
        yield f"mmt9 {number}", track.with_name(f"scene_{number}.toml"), track


def scatter(refit: Fitted) -> dict[str, float]:
    """Robust sigma of all residuals, mag, and the median over curves of their rms, in mag or of their mean."""
    left = (refit.delta / refit.scale).numpy()
    curve = refit.model.recording.curve
    middle = np.median(left)
    return {
        "robust_sigma": float(1.4826 * np.median(np.abs(left - middle))),
        "median_curve": float(
            np.median([np.sqrt(np.mean(left[curve == one] ** 2)) for one in np.unique(curve)])
        ),
    }


def told(scene_file: Path, recording_file: Path, budget: float | None) -> dict[str, Any]:
    """Verdict, names, and what they rest on."""
    scene, recording = torchlc.load(scene_file, recording_file)
    began = time.process_time()
    found = diagnose(scene, recording, budget=budget)
    content = found.to_json()
    keys = ("verdict", "named", "families", "global_p", "improvement", "remaining", "next_observation")
    return {
        "object": scene.name,
        "rows": len(recording),
        "curves": len(recording.curve_ids),
        **{key: content[key] for key in keys},
        "probability": content["probabilities"]["told"],
        "effects": content["probabilities"]["effects"],
        "untried": list(content["untried"]),
        "law": found.law,
        "parameters": {
            entry: effect_parameters(found.final, entry)
            for entry in found.final.hypothesis.added
            if "@" not in entry  # offsets of single curves are too many to tell
        },
        "farthest": {
            entry: dict(
                sorted(effect_parameters(found.final, entry).items(), key=lambda row: -abs(row[1]["median"]))[
                    :MOST
                ]
            )
            for entry in found.final.hypothesis.added
            if "@" in entry
        },
        "before": scatter(found.baseline),
        "after": scatter(found.final),
        "candidates": [
            {key: row[key] for key in ("effect", "target", "per", "delta_log_evidence")}
            for row in content["candidates"][:MOST]
        ],
        "sets": content["sets"][:MOST],
        "budget": budget,
        "cpu_seconds": time.process_time() - began,
    }


def begun(
    parser: argparse.ArgumentParser, name: str, data: Path
) -> tuple[argparse.Namespace, Path, dict[str, Any]]:
    """What was asked of a script that keeps each result as it is made: its options, the file of that ``name``, and what is there.
    Without the folder ``data`` it ends."""
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    if not data.is_dir():
        parser.exit(0, f"{data} is not here: nothing to do\n")
    torch.set_num_threads(1)
    quiet_libraries()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / name
    return options, file, json.loads(file.read_text()) if file.exists() else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="recordings whose name contains this")
    parser.add_argument(
        "--budget", type=float, help="CPU seconds of the search of each, after which the best so far is told"
    )
    options, file, known = begun(parser, "verdicts.json", DATA)
    for name, scene, recording in recordings():
        if options.only not in name or name in known:
            continue
        known[name] = told(scene, recording, options.budget)
        file.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n")
        one = known[name]
        print(f"{name}: {one['verdict']} {one['named']}, {one['cpu_seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
