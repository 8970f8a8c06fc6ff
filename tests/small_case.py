"""A small scene with an answer, for tests of what surrounds the model: a box-wing seen for four hours,
three numbers free.
"""

from __future__ import annotations

from pathlib import Path

from tests.good_input import SCENE

NAME = "box & wing <script>alert(1)</script> $\\frac$"
"""A hostile name: markup, a formula."""


def scene_text(name: str = "box-wing") -> str:
    """Panel n, r_spec and r_diff free; self-shadowing in the model."""
    return SCENE.replace('name = "box-wing"', f"name = '{name}'")


def write_case(
    folder: Path, *, noise: float = 0.02, name: str = "box-wing", rows: int = 49
) -> tuple[Path, Path]:
    """scene.toml and a recording of it with normal errors, simulated at the scene's values."""
    import torchlc

    scene = folder / "scene.toml"
    scene.write_text(scene_text(name))
    curve = torchlc.simulate(
        scene, start="2020-10-17T15:00:00", hours=4.0, cadence=4 * 3600 / (rows - 1), noise=noise, seed=5
    )
    return scene, curve.write(folder / "recording.ecsv")
