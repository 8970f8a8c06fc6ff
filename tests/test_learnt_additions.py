"""Networks inside of effects and laws of reflection that are defined here: they learn, are stored, and stay out of kept tables."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import pytest
import torch
from torch import nn

from tests.additions import ADDITIONS, ConstantGlow, known, scene_with, taken_out
from tests.effects.passes import rows
from torchlc.brdf.angles import per_epoch
from torchlc.effects import Effect
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene


class LearntGain(Effect):
    """A network of the hour that brightens or dims everything; for a test.

    Neglects nothing.
    """

    name = "learnt_gain"
    stage = "detector"

    def __init__(self, target=None):
        super().__init__(target)
        torch.manual_seed(3)
        self.net = nn.Sequential(nn.Linear(1, 8), nn.Tanh(), nn.Linear(8, 1))

    def detector(self, brightness, p, context):
        hours = context.seconds[:, None] / 3600 - 3.0
        return replace(brightness, flux=brightness.flux * torch.exp(self.net(hours)[:, 0]))


class LearntTilt(Effect):
    """A learnt turn of the body about Z; for a test of what tables would hold.

    Neglects nothing.
    """

    name = "learnt_tilt"
    stage = "attitude"

    def __init__(self, target=None):
        super().__init__(target)
        self.angle = nn.Parameter(torch.tensor(0.1, dtype=torch.float64))

    def attitude(self, rotation, state, p, context):
        sine, cosine, zero, one = (
            torch.sin(self.angle), torch.cos(self.angle), torch.zeros_like(self.angle), torch.ones_like(self.angle),
        )  # fmt: skip
        turn = torch.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one]).reshape(3, 3)
        return rotation @ turn


class LearntGlow(ConstantGlow):
    """Lambert's law times a learnt function of the albedo; for a test."""

    model = "learnt-glow"

    def build(self):
        torch.manual_seed(5)
        self.net = nn.Linear(1, 1)

    def parts(self, table, values):
        albedo = torch.sigmoid(self.net(per_epoch(values["r_diff"])))
        return per_epoch(values["glow"]) * table["area"], albedo * table["diffuse"]


def of_law(law):
    text = scene_with().to_toml().replace('"constant-glow"', f'"{law}"')
    return Scene.from_toml(text)


LEARNT = taken_out(__name__)


@pytest.fixture(scope="module", autouse=True)
def additions():
    with known([*ADDITIONS, *LEARNT]):
        yield


@pytest.mark.parametrize("kind", ["effect", "law"])
def test_a_network_is_a_submodule(kind, tmp_path):
    scene = scene_with() if kind == "effect" else of_law("learnt-glow")
    effects = ["learnt_gain"] if kind == "effect" else []
    recording = rows(scene, cadence_s=1800.0)
    model = LightCurve(scene, recording, effects=effects)
    learnt = [name for name, _ in model.named_parameters() if ".net." in name]
    assert len(learnt) == (4 if kind == "effect" else 2)
    assert set(learnt) <= set(model.state_dict())
    assert model.names == ["paint.glow", "paint.r_diff"]
    assert all(parameter.dtype == torch.float64 for parameter in model.parameters())

    before = model().detach()
    target = before - 0.2
    optimiser = torch.optim.Adam(model.learners.parameters(), lr=0.05)
    losses = []
    for _ in range(40):
        optimiser.zero_grad()
        loss = ((model() - target) ** 2).mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]

    after = model().detach()
    copied, pickled = copy.deepcopy(model), pickle.loads(pickle.dumps(model))
    fresh = LightCurve(scene, recording, effects=effects)
    assert not torch.equal(fresh(), after)
    fresh.load_state_dict(model.state_dict())
    for other in (copied, pickled, fresh):
        torch.testing.assert_close(other().detach(), after, rtol=1e-14, atol=0)
        assert next(other.learners.parameters()) is not next(model.learners.parameters())
    named = dict(model.named_parameters())
    named[learnt[0]] = torch.zeros_like(named[learnt[0]])
    assert not torch.equal(torch.func.functional_call(model, named, ()).detach(), after)

    likelihood = Likelihood(model)
    assert torch.isfinite(likelihood.log_prob(model.theta().detach()))
    assert likelihood.log_prob(model.theta().detach()[None].repeat(3, 1)).shape == (3,)
    assert model.to(torch.float32).state_dict()[learnt[0]].dtype == torch.float32


def test_models_of_one_assembly_and_hypotheses_beside_it_have_what_it_learnt():
    scene = scene_with()
    recording = rows(scene, cadence_s=1800.0)
    base = assemble(scene, recording, ["learnt_gain"])
    wider = assemble(scene, recording, ["learnt_gain", "thin_cloud"], base=base)
    one, other = LightCurve(scene, recording, assembly=base), LightCurve(scene, recording, assembly=wider)
    assert [id(p) for p in one.learners.parameters()] == [id(p) for p in other.learners.parameters()]
    law = of_law("learnt-glow")
    base = assemble(law, recording, [])
    wider = assemble(law, recording, ["thin_cloud"], base=base)
    assert base.models["paint"] is wider.models["paint"]


def test_what_is_learnt_on_the_way_of_the_light_is_in_no_kept_table():
    """The slope by the turn against a finite difference, and another turn at once another curve, with and without gradients
    and in a batch."""
    scene = scene_with()
    recording = rows(scene, cadence_s=1800.0)
    model = LightCurve(scene, recording, effects=["learnt_tilt"])
    angle = next(model.learners.parameters())
    (slope,) = torch.autograd.grad(model().sum(), angle)
    theta = model.theta().detach()

    def at(value):
        with torch.no_grad():
            angle.fill_(value)
            single, batch = model(theta), model(theta.repeat(2, 1))
        torch.testing.assert_close(batch, single.expand(2, -1), rtol=1e-12, atol=1e-12)
        return single

    step = 1e-6
    up, down = at(0.1 + step), at(0.1 - step)
    assert float(slope) == pytest.approx(float((up - down).sum() / (2 * step)), rel=1e-5)
    still = LightCurve(scene, recording, effects=[])
    torch.testing.assert_close(at(0.0), still(theta).detach(), rtol=1e-12, atol=1e-12)
