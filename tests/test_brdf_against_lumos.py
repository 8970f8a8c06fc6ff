"""Reflection models against lumos-sat (Fankhauser, Tyson and Askari 2023), run in an environment of its own.

lumos-sat pins an old numpy, so it lives in a virtual environment below pytest's cache, made on first use.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchlc.brdf import MODELS

Z, X = torch.eye(3, dtype=torch.float64)[[2, 0]]
SCRIPT = """
import json, sys, numpy, lumos.brdf.library as library
job = json.load(sys.stdin)
s, o = (tuple(numpy.array(job[key]).T) for key in ("s", "o"))
print(json.dumps(getattr(library, job["model"])(*job["arguments"])(s, (0, 0, 1), o).tolist()))
"""


@pytest.fixture(scope="module")
def lumos(request: pytest.FixtureRequest) -> Callable[..., Tensor]:
    """f_r of a model of lumos-sat at directions (N, 3)."""
    folder = Path(request.config.cache.mkdir("lumos-sat"))  # type: ignore[union-attr]
    python, ready = folder / "bin" / "python", folder / "ready"
    if not ready.exists():
        packages = ["lumos-sat==1.0.9", "numpy~=1.24.3"]
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True, capture_output=True)
            install = [python, "-m", "pip", "install", "--quiet", "--no-deps", *packages]
            subprocess.run(install, check=True, capture_output=True, timeout=200)
        except (subprocess.SubprocessError, OSError) as error:
            pytest.skip(f"lumos-sat with its numpy 1.24 cannot be installed for this Python: {error}")
        ready.touch()

    def evaluate(model: str, arguments: list[float], s: Tensor, o: Tensor) -> Tensor:
        job = {"model": model, "arguments": arguments, "s": s.tolist(), "o": o.tolist()}
        run = subprocess.run(
            [python, "-c", SCRIPT], input=json.dumps(job), capture_output=True, text=True, check=True
        )
        return torch.tensor(json.loads(run.stdout), dtype=torch.float64)

    return evaluate


def directions(count: int, seed: int) -> Tensor:
    """Towards the whole sphere: lumos-sat too gives 0 to an observer behind the facet."""
    vectors = torch.tensor(np.random.default_rng(seed).normal(size=(count, 3)))
    return torch.nn.functional.normalize(vectors, dim=-1)


def above(vectors: Tensor) -> Tensor:
    """lumos-sat's LAMBERTIAN forgets whether the facet is lit, so the Sun stays in front."""
    return torch.cat([vectors[:, :2], vectors[:, 2:].abs()], -1)


def test_lambert(lumos: Callable[..., Tensor]) -> None:
    s, o = above(directions(100, 1)), directions(100, 2)
    found = MODELS["lambert"](albedo=0.4)(Z, X, s, o).detach()
    torch.testing.assert_close(found, lumos("LAMBERTIAN", [0.4], s, o), rtol=1e-12, atol=0)


@pytest.mark.parametrize("n", [0.5, 1.0, 26.0, 300.0, 1e5])
def test_phong_about_the_mirror_direction(n: float, lumos: Callable[..., Tensor]) -> None:
    s, o = directions(200, 3), directions(200, 4)
    mirror = s * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    o[::2] = torch.nn.functional.normalize(mirror + o / n**0.5, dim=-1)[::2]
    found = MODELS["phong-mirror"](n=n, r_spec=0.5, r_diff=0.3)(Z, X, s, o).detach()
    expected = lumos("PHONG", [0.3, 0.5, n], s, o)
    torch.testing.assert_close(found, expected, rtol=1e-15 * max(n, 100) * 10, atol=0)
