"""Writes the recording of ``torchlc demo``: python examples/reference/make_demo.py

The truth holds what the scene does not say: the panels' lobe has a heavier tail than a cosine power, so that the
recording's peak is both sharp and wide. The disc of the Sun, which the scene leaves out, is in the truth as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from body import Scene
from bruteforce import scene_effects, simulate
from detector import photometry
from observe import errors, noise, stamps, usable, write_recording

DEMO = Path(__file__).parents[2] / "torchlc" / "demo"
SEED = 20201017
EXPTIME_S = 10.0
MATERIALS = {
    "body": {"n": 12030.0, "r_spec": 0.491, "r_diff": 0.157},
    "panel": {"n": 154.0, "r_spec": 0.0325, "r_diff": 0.0172},
}
MISSING = {"finite_sun": {}, "lobe_tail": {"material": "panel", "g": 3.0}}


def main() -> None:
    rng = np.random.default_rng(SEED)
    scene = Scene.read(DEMO / "scene.toml").with_materials(MATERIALS)
    effects = {**scene_effects(scene), **MISSING}
    t = stamps("2020-10-17T14:00:00", 7.0, 240, rng)
    curve = simulate(scene, t, EXPTIME_S, "weihai", effects, seed=SEED)
    mag = photometry(curve, scene, effects)
    error = errors(mag, 0.022)
    mag = mag + noise(t, error, effects, rng)
    keep = usable(curve)
    rows = int(keep.sum())
    comments = (
        "simulated by examples/reference/make_demo.py (brute force, shares no code with torchlc)",
        f"seed {SEED}; the truth is in README.md",
    )
    write_recording(
        DEMO / "recording.ecsv",
        t[keep],
        mag[keep],
        error[keep],
        np.full(rows, EXPTIME_S),
        np.full(rows, "weihai"),
        comments,
    )


if __name__ == "__main__":
    main()
