"""Large batches are cut by a stated rule, and a compiler is never needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import torchlc
from tests.effects.cases import seen_from, still, unit
from tests.effects.test_finite_sun import CYLINDER
from torchlc.inference.likelihood import compiled
from torchlc.lightcurve.evaluators.contract import VALUES_AT_ONCE

DEMO = Path(torchlc.__file__).parent / "demo"


class Largest(TorchDispatchMode):
    """Notes how many numbers the largest result of any operation holds."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        found = func(*args, **(kwargs or {}))
        sizes = [one.numel() for one in tree_leaves(found) if isinstance(one, torch.Tensor)]
        self.numbers = max([self.numbers, *sizes])
        return found


@pytest.fixture(scope="module")
def likelihood() -> torchlc.Likelihood:
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    return torchlc.Likelihood(torchlc.LightCurve(scene, recording, effects=["self_shadowing"]))


def test_nothing_larger_than_the_rule_is_held(likelihood):
    """4,000 values of theta at once would need 1.7 million numbers in a buffer."""
    theta = likelihood.model.parameter_set.sample_prior(4000, torch.Generator().manual_seed(0))
    with torch.no_grad():
        likelihood.log_prob(theta[:2])
        with Largest() as largest:
            whole = likelihood.log_prob(theta)
        few = torch.cat([likelihood.log_prob(piece) for piece in theta[:40].split(7)])
    assert 0.2 * VALUES_AT_ONCE < largest.numbers <= VALUES_AT_ONCE
    torch.testing.assert_close(whole[:40], few, rtol=1e-12, atol=0)


def test_gradients_of_a_cut_batch(likelihood):
    count = 2 * likelihood.model.batch_size() + 3
    theta = likelihood.model.parameter_set.sample_prior(count, torch.Generator().manual_seed(1))
    slopes = []
    for one in (theta, theta[-3:]):
        leaf = one.clone().requires_grad_()
        slopes.append(torch.autograd.grad(likelihood.log_prob(leaf).sum(), leaf)[0])
    torch.testing.assert_close(slopes[0][-3:], slopes[1], rtol=1e-12, atol=0)


def test_without_a_compiler_the_plain_call_serves(likelihood, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    theta = likelihood.model.parameter_set.start()[None]
    with pytest.warns(UserWarning, match="no C\\+\\+ compiler"):
        call = compiled(likelihood, theta)
    with torch.no_grad():
        torch.testing.assert_close(call(theta), likelihood.log_prob(theta), rtol=0, atol=0)


@pytest.mark.parametrize(
    "effects",
    [
        ["panel_offset", "self_shadowing"],
        ["time_offset", "panel_cant"],
        ["appendage"],
        ["appendage", "exposure_smearing"],
    ],
)
def test_geometries_of_a_batch_are_those_of_each(effects):
    """On one grid of planes, with what they share shared, as facet by facet under a transform."""
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    model = torchlc.LightCurve(scene, recording, effects=effects)
    theta = model.parameter_set.sample_prior(7, torch.Generator().manual_seed(2))
    theta[3:5, model.assembly.geometry_columns] = theta[0, model.assembly.geometry_columns]
    with torch.no_grad():
        together = model.brightness(theta).flux
        facets = torch.vmap(lambda one: model.brightness(one).flux)(theta)
    torch.testing.assert_close(together, facets, rtol=1e-11, atol=1e-11 * float(facets.max()))


def test_lobes_of_a_curved_shape_are_tabulated(tmp_path):
    """Light of a cylinder under a Sun with a disc, from each pair of facet and direction, and from the table: the same."""
    free = '[materials.white]\nn = { value = 50.0, low = 1.0, high = 1e5, prior = "loguniform" }\n'
    scene = still(CYLINDER, free + "r_spec = { value = 0.3, low = 0.0, high = 1.0 }\nr_diff = 0.2\n")
    directions = unit(np.random.default_rng(3).normal(size=(2, 300, 3)))
    model = torchlc.LightCurve(scene, seen_from(scene, tmp_path, *directions), effects=["finite_sun"])
    theta = torch.tensor([[n, 0.4] for n in (3.0, 80.0, 2e3, 6e4)], dtype=torch.float64)
    with torch.no_grad():
        assert model.evaluation.tabulated == ("white",)
        pairs = model.make_tables(model.view(model.values(theta[0])), False, compact=True)
        summed = model.magnitude(model.shine(pairs, model.values(theta)), theta)
        torch.testing.assert_close(model(theta), summed, rtol=0, atol=2e-6)
