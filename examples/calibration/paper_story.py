"""What made the peak of Object 1 steeper than its model? Occlusion, which its authors suspect, against a tail of the lobe and a
cant of the panels: how large each must be to be seen on that night, and what a diagnosis says of each.

    python examples/calibration/paper_story.py docs/evidence

The night of 17 October 2020 (Aerospace 2023, 10(1), 41) by the brute-force reference at the materials of Table 3, errors of
0.02 mag, all six numbers of the materials free in the scene that is handed out. A cause counts as just seen where the refit
without it leaves a chi-square of SEEN squared in the noiseless curve, as plain at PLAIN squared. What the file has already is
kept.
"""

from __future__ import annotations

import json
import sys
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).parents[1]
sys.path[:0] = [str(EXAMPLES / "reference"), str(EXAMPLES / "paper")]

from circumstances import QUICK, Setup  # noqa: E402
from concealed import Concealed, by, tail  # noqa: E402
from gain import Baseline, gain, sized, truth_of  # noqa: E402
from observe import errors, noise, stamps, usable, write_recording  # noqa: E402
from scene_files import toml  # noqa: E402
from setting import GAP_OBJECT_1, TABLE_3, free_materials, object_1  # noqa: E402

import torchlc  # noqa: E402
from torchlc.terminal import quiet_libraries  # noqa: E402

SEED, ROWS, FLOOR = 20201017, 200, 0.02
SEEN, PLAIN = 6.0, 20.0
PEAK = ("2020-10-17T15:45:00", "2020-10-17T17:15:00")
"""Where the curve is above half of its greatest flux."""
BUDGET_S = 90.0
Make = Callable[[float, Setup], tuple[Setup, Concealed]]


def night(gap: float = GAP_OBJECT_1) -> Setup:
    """The night of Object 1, its wings ``gap`` m off the wall, rows that can be observed."""
    tree = tomllib.loads(object_1(free_materials(), gap=gap).to_toml())
    t = stamps("2020-10-17T14:00:00", 7.0, ROWS, np.random.default_rng(SEED))
    setup = Setup("Object 1", tree, {k: dict(v) for k, v in TABLE_3[1].items()}, t, 0.0, "weihai", FLOOR)
    return replace(setup, t=t[usable(truth_of(setup, {}, **QUICK)[0])])


def measured(setup: Setup, concealed: Concealed) -> dict[str, float]:
    """What a cause changes, mag, before and after the materials are refitted without it; slopes in mag/h at the peak."""
    plain = truth_of(setup, {}, seed=SEED)[1]
    with_it = truth_of(setup, concealed, seed=SEED)[1]
    baseline = Baseline(setup, errors(with_it, FLOOR), plain)
    left, _, model = baseline.best_refit(with_it)
    start, end = (np.datetime64(one) for one in PEAK)
    stamp = np.datetime64("2000-01-01T00:00:00") + (1e3 * setup.t).astype("timedelta64[ms]")
    peak = (stamp > start) & (stamp < end)

    def steepest(mag: np.ndarray) -> float:
        return float(np.abs(np.gradient(mag, setup.t / 3600.0))[peak].max())

    change = with_it - plain
    return {
        "gain": float(np.sqrt(left)),
        "largest_change_mag": float(np.abs(change).max()),
        "uneven_at_peak_mag": float(np.ptp(change[peak])),
        "left_by_refit_mag": float(np.abs(with_it - model).max()),
        "left_at_peak_mag": float(np.abs(with_it - model)[peak].max()),
        "slope_with": steepest(with_it),
        "slope_refit": steepest(model),
    }


def verdict(setup: Setup, concealed: Concealed) -> dict[str, Any]:
    """What a diagnosis says of a recording with the cause, given the scene without."""
    mag = truth_of(setup, concealed, seed=SEED)[1]
    error = errors(mag, FLOOR)
    observed = mag + noise(setup.t, error, {}, np.random.default_rng(SEED))
    rows = len(mag)
    with tempfile.TemporaryDirectory() as folder, quiet_libraries():
        scene, recording = Path(folder) / "scene.toml", Path(folder) / "recording.ecsv"
        scene.write_text(toml(setup.tree), encoding="utf-8")
        write_recording(recording, setup.t, observed, error, np.zeros(rows), np.full(rows, setup.station))
        found = torchlc.diagnose(scene, recording, budget=BUDGET_S).to_json()
    return {
        "verdict": found["verdict"],
        "named": found["named"],
        "families": found["families"],
        "told": found["probabilities"]["told"],
        "global_p": found["global_p"],
    }


def line(name: str, one: dict[str, Any]) -> dict[str, Any]:
    """A row of the overview of the evidence."""
    hidden = one["gain"] < 1.0
    cause = {"lobe tail": "lobe_tail", "panel cant": "panel_cant"}.get(
        name.partition(",")[0], "self_shadowing"
    )
    first = one["named"][:1] == [cause]
    family = any(cause in members for members in one["families"])
    right = (
        "yes"
        if first
        else "in the family"
        if family
        else "silent"
        if one["verdict"] != "missing_physics"
        else "no"
    )
    return {
        "recording": f"Object 1's peak, {name}",
        "cause": f"`{cause}`" + (", which a refit hides" if hidden else ""),
        "named": ", ".join(f"`{effect}`" for effect in one["named"]) or one["verdict"],
        "probability": one["told"],
        "right": "yes: nothing shows" if hidden and one["verdict"] == "adequate" else right,
        "command": "python examples/calibration/paper_story.py docs/evidence",
    }


def main() -> None:
    out = Path(sys.argv[1])
    setup, touching = night(), night(gap=0.0)
    causes: dict[str, tuple[Make, float, tuple[float, float], float]] = {
        "lobe tail": (tail, 0.3, (0.02, 0.9), SEEN),
        "lobe tail, plain": (tail, 0.1, (0.02, 0.9), PLAIN),
        "panel cant": (by("panel_cant", "deg"), 0.5, (0.01, 10.0), SEEN),
    }
    shadow: Concealed = {"self_shadowing": {}}
    path = out / "paper_story.json"
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if "occlusion" not in found:
        one = {**measured(touching, shadow), **verdict(touching, shadow), "gap_m": 0.0}
        found["occlusion"] = {**one, "error_to_be_seen_mag": FLOOR * one["gain"] / SEEN}
        found["occlusion as published"] = {"gain": gain(setup, shadow), "gap_m": GAP_OBJECT_1}
    for name, (make, first, limits, target) in causes.items():
        if name in found:
            continue
        size = sized(setup, make, first, limits, target)
        concealed = make(size, setup)[1]
        found[name] = {
            "parameters": concealed,
            "size": size,
            **measured(setup, concealed),
            **verdict(setup, concealed),
        }
        print(name, found[name], flush=True)
    out.mkdir(parents=True, exist_ok=True)
    found = {name: found[name] for name in ("occlusion", "occlusion as published", *causes)}
    found["overview"] = [line(name, found[name]) for name in ("occlusion", *causes)]
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
