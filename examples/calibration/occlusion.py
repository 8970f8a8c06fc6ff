"""Can occlusion sharpen the peak of Object 1? What diagnose says where occlusion is concealed, and where other
physics is that does sharpen it.

    python examples/calibration/occlusion.py docs/paper

The night of 17 October 2020 by the brute-force reference, with errors of 0.02 mag and all six numbers of the
materials free: wings that touch the body and shadow it, while the scene leaves shadows out; and panels a fifth
of which has a lobe of n = 2000, which the scene leaves out too.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).parents[1]
sys.path[:0] = [str(EXAMPLES / "reference"), str(EXAMPLES / "paper")]

from body import Scene  # noqa: E402
from bruteforce import simulate  # noqa: E402
from detector import photometry  # noqa: E402
from observe import errors, noise, stamps, usable, write_recording  # noqa: E402
from setting import GAP_OBJECT_1, TABLE_3, free_materials, object_1  # noqa: E402

import torchlc  # noqa: E402
from torchlc.terminal import quiet_libraries  # noqa: E402

SEED, ROWS, FLOOR = 20201017, 300, 0.02
CONCEALED: dict[str, tuple[float, dict[str, Any]]] = {
    "occlusion, wings at the wall": (0.0, {"self_shadowing": {}}),
    "a second lobe of the panels": (
        GAP_OBJECT_1,
        {"second_material": {"material": "panel", "weight": 0.2, "n": 2000.0, "r_spec": 0.2, "r_diff": 0.01}},
    ),
}
"""By name: how far the wings stand off the wall, m, and what the recording has and the scene has not."""


def told(gap: float, effects: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Verdict on the night with ``effects``, given a scene without."""
    rng = np.random.default_rng(SEED)
    (folder / "scene.toml").write_text(object_1(free_materials(), gap=gap).to_toml())
    truth = Scene.read(folder / "scene.toml").with_materials(TABLE_3[1])
    t = stamps("2020-10-17T14:00:00", 7.0, ROWS, rng)
    curve, bare = (simulate(truth, t, 0.0, "weihai", one, seed=SEED) for one in (effects, {}))
    mag, without = (photometry(one, truth, {}) for one in (curve, bare))
    keep = usable(curve)
    error = errors(mag, FLOOR)
    observed = mag + noise(t, error, {}, rng)
    rows = [one[keep] for one in (t, observed, error, np.zeros(ROWS), np.full(ROWS, "weihai"))]
    write_recording(folder / "recording.ecsv", *rows)
    found = torchlc.diagnose(folder / "scene.toml", folder / "recording.ecsv").to_json()
    return {
        "largest_change_mag": float(np.abs(mag - without)[keep].max()),
        "verdict": found["verdict"],
        "families": found["families"],
        "global_p": found["global_p"],
        "improvement": found["improvement"],
        "materials": found["materials"],
    }


def main() -> None:
    quiet_libraries()
    out = Path(sys.argv[1])
    results = {}
    for name, (gap, effects) in CONCEALED.items():
        with tempfile.TemporaryDirectory() as folder:
            results[name] = told(gap, effects, Path(folder))
        print(
            name, results[name]["verdict"], results[name]["families"], results[name]["global_p"], flush=True
        )
    (out / "occlusion.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
