"""An Iridium NEXT satellite in a minute of 10 Hz photometry by Mini-MegaTORTORA: one track, fitted.

    python examples/mmt9.py [DIRECTORY]

Shape and attitude are nominal, the materials free, and the errors of the recording unknown: their level is fitted
with the rest. Beside it stands the noise that successive rows tell. Needs ../shared/data/mmt9; without it the
script says so and ends.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import torchlc
from torchlc.figures.curves import draw_curves
from torchlc.figures.style import style

ROOT = Path(__file__).parents[1]
MMT9 = ROOT.parent / "shared" / "data" / "mmt9"
TRACK = 18908930
STEPS = 1600


def successive_noise(recording: torchlc.Recording) -> float:
    """1.4826 median |successive difference| / sqrt 2 within the curves, mag."""
    steps = np.concatenate(
        [np.diff(recording.observed[recording.curve == k]) for k in range(len(recording.curve_ids))]
    )
    return float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2))


def numbers_of(result: torchlc.FitResult) -> dict[str, object]:
    """What the page tells of the fit."""
    return {
        "track": TRACK,
        "rows": len(result.recording),
        "curves": len(result.recording.curve_ids),
        "converged": result.converged,
        "rms_mag": result.rms_mag,
        "successive_noise_mag": successive_noise(result.recording),
        "recorded_range_mag": float(np.ptp(result.recording.observed)),
        "parameters": {
            name: {key: row[key] for key in ("median", "q05", "q95", "informed")}
            for name, row in result.parameters().items()
        },
        "components": result.mean_shares(),
        "warnings": result.all_warnings,
    }


def draw(result: torchlc.FitResult, path: Path) -> None:
    with matplotlib.rc_context(style()):
        figure = Figure(figsize=(8.2, 4.6), layout="constrained")
        draw_curves(result.comparison, figure)
        figure.savefig(path, dpi=100, facecolor="white")


def main() -> None:
    if not MMT9.exists():
        print(f"{MMT9} is not here: nothing to do")
        return
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out")
    out.mkdir(parents=True, exist_ok=True)
    files = MMT9 / f"scene_{TRACK}.toml", MMT9 / f"track_{TRACK}.ecsv"
    result = torchlc.fit(*files, steps=STEPS)
    print(result)
    draw(result, out / "mmt9.png")
    (out / "mmt9.json").write_text(json.dumps(numbers_of(result), indent=1) + "\n")


if __name__ == "__main__":
    main()
