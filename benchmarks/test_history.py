"""Absolute times of what is called most, kept from run to run: ``pytest benchmarks --benchmark-autosave``, then
``pytest-benchmark compare``. They are of one machine and of its load; the ratios are in ``python -m benchmarks``.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from benchmarks.cases import EFFECTS, draws, near_truth, object_1, torus
from torchlc.lightcurve.model import LightCurve


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["bare", "known physics"])
def test_likelihood(benchmark, effects) -> None:
    likelihood = object_1(effects)
    theta = draws(likelihood)
    with torch.no_grad():
        assert torch.isfinite(benchmark(likelihood.log_prob, theta)).all()


def test_gradient(benchmark) -> None:
    likelihood = object_1()
    leaf = draws(likelihood).requires_grad_()
    (found,) = benchmark(lambda: torch.autograd.grad(likelihood.log_prob(leaf).sum(), leaf))
    assert torch.isfinite(found).all()


@pytest.mark.parametrize("name", ["panel_offset", "time_offset"])
def test_free_geometry(benchmark, name) -> None:
    likelihood = object_1([name])
    seeds = iter(range(10_000))

    def new_values() -> torch.Tensor:
        return likelihood.log_prob(near_truth(likelihood, seed=next(seeds)))

    with torch.no_grad():
        assert torch.isfinite(benchmark(new_values)).all()


def test_mesh_with_shadows(benchmark, tmp_path) -> None:
    scene, recording = torus(tmp_path)
    with torch.no_grad():
        curve = benchmark.pedantic(
            lambda: LightCurve(scene, recording, effects=["self_shadowing"])(), rounds=3, warmup_rounds=1
        )
    assert torch.isfinite(curve).all()
