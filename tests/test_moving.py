"""A light curve in another precision or on another device, and defaults of torch that change nothing.

The device "meta" holds shapes and no numbers: what is left on the CPU, or is read as a number, ends in an error there, as it
would cost or fail on a GPU.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import torchlc
from torchlc.effects import Effect, registry
from torchlc.files.numbers import value_of
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.stages.effect import EFFECTS
from torchlc.tensors.moving import moved

ROOT = Path(__file__).parent.parent
DEMO = (Path(torchlc.__file__).parent / "demo" / "scene.toml").read_text(encoding="utf-8")
KNOWN = ["light_time", "sun_distance", "earth_shadow"]
CASES = {
    "fixed": [*KNOWN, "self_shadowing"],
    "shares": ["color_term[panel +Y]"],
    "smeared": [*KNOWN, "exposure_smearing"],
    "a disc": ["finite_sun"],
    "between parts": ["interreflection", "back_transmission[panel +Y]"],
    "materials": ["second_material[panel]", "opposition_surge[body]"],
    "a surface more": ["appendage"],
    "panels": [*KNOWN, "self_shadowing", "panel_offset"],
    "attitude": ["attitude_offset", "wobble", "attitude_jump"],
    "a clock": [*KNOWN, "time_offset"],
    "noise": ["jitter", "background", "zero_point_drift"],
}
"""Effects of a model: tables kept, stepped, and worked out anew."""
SIZED = DEMO.replace("[1.72, 6.60]", "[1.72, { value = 6.6, low = 3.0, high = 9.0 }]", 1).replace(
    "size = [2.010,", "size = [{ value = 2.01, low = 1.0, high = 3.0 },"
)
_components = DEMO[DEMO.index("[[components]]") : DEMO.index("[materials.body]")]
ROCKET = DEMO.replace(
    'mode = "nadir"',
    """mode = "spin-pole"
pole = [{ value = 200.0, low = 150.0, high = 250.0 }, { value = 30.0, low = -20.0, high = 80.0 }]
period = { value = 0.05, low = 0.045, high = 0.055 }
phase = { value = 20.0, low = 0.0, high = 360.0 }
epoch = "2020-10-17T13:00:00\"""",
).replace(
    _components,
    """[[components]]
name = "stage"
shape = "cylinder"
radius = 1.2
length = { value = 8.0, low = 4.0, high = 12.0 }
axis = [1, 0, 0]
centre = [0, 0, 0]
material = "body"

""",
)
ROCKET = ROCKET.replace(ROCKET[ROCKET.index("[materials.panel]") : ROCKET.index("[model]")], "").replace(
    '"light_time", ', ""
)
_station = DEMO[DEMO.index("[[stations]]") : DEMO.index("[attitude]")]
STATIONS = DEMO.replace(
    _station,
    _station + _station.replace('"weihai"', '"kunming"').replace("122.05", "102.8").replace("37.536", "25.0"),
).replace("zero_point = { value = 0.0,", 'zero_point = { per = "station", value = 0.0,')
OTHERS = {
    "free sizes": (SIZED, KNOWN),
    "free sizes and all known": (SIZED, [*KNOWN, "self_shadowing", "exposure_smearing"]),
    "a rocket body": (ROCKET, ["sun_distance", "earth_shadow"]),
    "a rocket body in exposures": (ROCKET, ["exposure_smearing", "finite_sun"]),
    "stations": (STATIONS, [*KNOWN, "time_offset@station"]),
}
"""Scenes with geometries of their own, and the effects on them."""
SPUN_MAG = 1e-3
"""Of a body that has turned 40 times: 1e-7 of that is 1.5e-5 rad, of which a lobe n = 1000 makes up to 60 times as much in mag."""
SINGLE_MAG = 5e-5
"""Single precision has 1e-7 of a number; of n = 1000 the power of a cosine multiplies it by n: 1e-4, in mag."""


def recorded(scene: Scene) -> Recording:
    """Two hours with 20 mmag of noise, in exposures of 5 s."""
    curve = torchlc.simulate(
        scene, start="2020-10-17T13:00:00", hours=2.0, cadence=1200.0, noise=0.02, seed=1
    )
    return replace(curve.recording, observed=curve.mag, exptime=np.full(len(curve.mag), 5.0))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.from_toml(DEMO)


@pytest.fixture(scope="module")
def recording(scene: Scene) -> Recording:
    return replace(recorded(scene), exptime=None)


def tensors(thing: object, seen: set[int]) -> list[Tensor]:
    """Every tensor that an object holds, however deep; what a scene and a recording hold is no tensor."""
    if id(thing) in seen or isinstance(thing, type | Scene | Recording | str | bytes | np.ndarray):
        return []
    seen.add(id(thing))
    if isinstance(thing, Tensor):
        return [thing]
    inner: list[object] = []
    if isinstance(thing, dict):
        inner += thing.values()
    elif isinstance(thing, list | tuple | set | frozenset):
        inner += thing
    elif isinstance(thing, FunctionType):
        inner += [cell.cell_contents for cell in thing.__closure__ or ()]
    elif hasattr(thing, "__dict__"):
        inner += vars(thing).values()
    return [tensor for one in inner for tensor in tensors(one, seen)]


def all_tensors(model: LightCurve) -> list[Tensor]:
    return tensors(vars(model), set())


def made(case: str, scene: Scene, recording: Recording) -> LightCurve:
    """The model of a case of CASES on a scene, or of OTHERS."""
    if case in CASES:
        return LightCurve(scene, recording, effects=CASES[case])
    text, effects = OTHERS[case]
    other = Scene.from_toml(text, known_effects=registry())
    return LightCurve(other, recorded(other), effects=effects)


@pytest.mark.parametrize("case", [*CASES, *OTHERS])
def test_everything_moves_to_a_device_without_numbers(case: str, scene: Scene, recording: Recording) -> None:
    model = made(case, scene, recording)
    rows, count = len(model.recording), len(model.names)
    model.to("meta")
    held = all_tensors(model)
    assert held and all(tensor.is_meta for tensor in held)
    theta = torch.empty(3, count, dtype=torch.float64, device="meta")
    alone = model()
    assert alone.is_meta and alone.shape == (rows,)
    with torch.no_grad():
        assert model(theta[0]).shape == (rows,)
        found = model.brightness(theta, shares=True)
        assert found.flux.is_meta and found.flux.shape == (3, rows)
        assert found.shares is not None
        assert found.shares.shape == (3, len(model.assembly.components), rows)
        variance = model.noise(theta).variance
        assert variance is None or variance.is_meta


@pytest.mark.parametrize("case", [*CASES, *OTHERS])
def test_single_precision_is_near_double(case: str, scene: Scene, recording: Recording) -> None:
    model = made(case, scene, recording)
    single = LightCurve(model.scene, model.recording, assembly=model.assembly).to(torch.float32)
    theta = model.theta().detach()
    theta = torch.stack([theta, 0.99 * theta])
    with torch.no_grad():
        expected = model(theta)
        found = single(theta.float())
        np.testing.assert_allclose(
            found.double(), expected, rtol=0, atol=SPUN_MAG if "rocket" in case else SINGLE_MAG
        )
    assert found.dtype == torch.float32
    assert not any(one.dtype == torch.float64 for one in all_tensors(single))
    assert any(one.dtype == torch.long for one in all_tensors(single)), "places stay whole numbers"
    slope = torch.autograd.grad(single().sum(), list(single.free.parameters()))
    assert all(one.dtype == torch.float32 and bool(torch.isfinite(one).all()) for one in slope)
    assert model().dtype == torch.float64, "a model of the same assembly stays as it is"


def test_a_likelihood_follows_its_model(scene: Scene, recording: Recording) -> None:
    """The sum of some ten squares of residuals over errors is right to 1e-4 where each magnitude is to 1e-6."""
    model = LightCurve(scene, recording, effects=KNOWN)
    theta = model.theta().detach()
    expected = float(Likelihood(model).log_prob(theta))
    model.to(torch.float32)
    found = Likelihood(model).log_prob(theta.float())
    assert found.dtype == torch.float32
    assert np.isfinite(expected)
    assert float(found) == pytest.approx(expected, rel=1e-3)


def with_limit(recording: Recording) -> Recording:
    """The recording with its third row as an upper limit."""
    return replace(recording, upper_limit=np.arange(len(recording)) == 2)


def in_flux(recording: Recording) -> Recording:
    """The recording as relative flux, 1 at mag 12, with errors of a hundredth of that."""
    flux = 10 ** (-0.4 * (recording.observed - 12))
    return replace(recording, kind="flux", observed=flux, error=np.full(len(flux), 0.01))


def weak(recording: Recording) -> Recording:
    """The recording with errors that follow the measured flux: 0.3 mag at its mean."""
    mag = recording.observed
    return replace(recording, error=0.3 * 10 ** (0.4 * (mag - mag.mean())))


RECORDINGS: dict[str, Callable[[Recording], Recording]] = {
    "magnitudes": lambda recording: recording,
    "magnitudes with a limit": with_limit,
    "magnitudes compared in flux": weak,
    "magnitudes without errors": lambda recording: replace(recording, error=None),
    "flux": in_flux,
    "flux with a limit": lambda recording: with_limit(in_flux(recording)),
    "flux without errors, with a limit": lambda recording: replace(
        with_limit(in_flux(recording)), error=None
    ),
}
"""Every way in which a likelihood compares a recording with its model."""


@pytest.mark.parametrize("effects", [KNOWN, ["outliers"]], ids=" ".join)
@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_likelihood_has_shapes_on_a_device_without_numbers(
    kind: str, effects: list[str], scene: Scene, recording: Recording
) -> None:
    model = LightCurve(scene, RECORDINGS[kind](recording), effects=effects)
    elsewhere = Likelihood(model)
    likelihood = Likelihood(model.to("meta"))
    assert (likelihood.gains, likelihood.fitted_errors) == (elsewhere.gains, elsewhere.fitted_errors)
    held = tensors({key: value for key, value in vars(likelihood).items() if key != "model"}, set())
    assert held and all(tensor.is_meta for tensor in held)
    theta = torch.empty(3, len(model.names), dtype=torch.float64, device="meta")
    for density in (likelihood.log_prob, likelihood.log_likelihood, likelihood.chi2):
        assert density(theta).is_meta
        assert density(theta).shape == (3,) and density(theta[0]).shape == ()


def test_rows_that_err_together_are_refused_in_words_where_no_number_says_which(
    scene: Scene, recording: Recording
) -> None:
    model = LightCurve(scene, recording, effects=["red_noise"]).to("meta")
    likelihood = Likelihood(model)
    with pytest.raises(
        torchlc.InputError, match=r"red_noise on the device meta: .*Leave out red_noise to look at shapes"
    ):
        likelihood.log_prob(torch.empty(len(model.names), dtype=torch.float64, device="meta"))


def test_there_and_back(scene: Scene, recording: Recording) -> None:
    """``double`` after ``float`` gives back the dtype, and of the numbers what single precision has kept."""
    model = LightCurve(scene, recording, effects=["panel_offset", "self_shadowing"])
    before = model().detach()
    model.float().double()
    assert model().dtype == torch.float64
    torch.testing.assert_close(model().detach(), before, rtol=0, atol=SINGLE_MAG)


def test_to_the_same_changes_nothing(scene: Scene, recording: Recording) -> None:
    model = LightCurve(scene, recording, effects=KNOWN)
    before, assembly = model().detach(), model.assembly
    model.to("cpu").to(torch.float64)
    assert model.assembly is assembly
    assert torch.equal(model().detach(), before)


class Tinted(Effect):
    """A small network of the hour; for these tests.

    Neglects nothing.
    """

    name = "tinted"
    stage = "detector"

    def __init__(self, target: str | None = None) -> None:
        super().__init__(target)
        self.net = nn.Linear(1, 1)

    def detector(self, brightness, p, context):
        dimmed = torch.exp(self.net(context.seconds[:, None] / 3600)[:, 0])
        return type(brightness)(brightness.flux * dimmed, brightness.shares, brightness.components)


EFFECTS.pop("tinted")


def test_what_an_effect_learns_moves_along_and_still_learns(scene: Scene, recording: Recording) -> None:
    with EFFECTS.restored():
        EFFECTS.enter("tinted", Tinted)
        model = LightCurve(scene, recording, effects=["tinted"])
        for where in (torch.float32, torch.float64, torch.float32):
            model.to(where)
            assert {id(one) for one in model.learners.parameters()} == {
                id(one) for effect in model.effects for one in effect.parameters()
            }
            before = model().detach()
            optimiser = torch.optim.SGD(model.learners.parameters(), lr=1e-3)
            model().sum().backward()
            optimiser.step()
            optimiser.zero_grad()
            assert not torch.equal(model().detach(), before)
        model.to("meta")
        assert model().shape == (len(recording),)


@pytest.mark.parametrize("where", [torch.float32, "meta"])
def test_a_model_that_shares_what_an_effect_learns_stays_where_it_is(
    scene: Scene, recording: Recording, where: torch.dtype | str
) -> None:
    with EFFECTS.restored():
        EFFECTS.enter("tinted", Tinted)
        model = LightCurve(scene, recording, effects=["tinted"])
        other = LightCurve(scene, recording, assembly=model.assembly)
        before, learnt = model().detach(), list(model.learners.parameters())
        other.to(where)
        assert torch.equal(model().detach(), before)
        assert all(a is b for a, b in zip(model.learners.parameters(), learnt, strict=True))
        moved_ones = {(one.dtype, one.device.type) for one in other.parameters()}
        assert moved_ones == {(torch.float32, "cpu") if where is torch.float32 else (torch.float64, "meta")}
        assert other().shape == before.shape


def test_moved_keeps_what_is_one_and_enters_closures() -> None:
    """Against what is written out: a tensor in two places is one tensor after; a function sees the new one."""
    shared, count, learnt = torch.ones(2), torch.arange(2), nn.Parameter(torch.zeros(1))
    thing = {"a": shared, "b": [shared, count], "f": lambda: shared, "learnt": learnt, "dtype": torch.float32}
    other = moved(
        thing, lambda one: one.double() if one.is_floating_point() else one, torch.float32, shared.device
    )
    assert other["a"].dtype == torch.float64
    assert other["a"] is other["b"][0]
    assert other["f"]().dtype == torch.float64
    assert other["b"][1].dtype == torch.long
    assert other["learnt"] is learnt
    assert other["dtype"] == torch.float64
    assert thing["a"].dtype == torch.float32


# ------------------------------------------------------------------ defaults of torch

DEFAULTS = "torch.set_default_dtype(torch.float64); torch.set_default_device('meta')"
COMMAND = f"import torch; torch.set_num_threads(1); {DEFAULTS}; from tests.test_moving import outcome; print(outcome())"


def outcome() -> str:
    """Numbers of a simulation, a model with its slopes, a likelihood and a short fit, as JSON."""
    scene = Scene.from_toml(DEMO, known_effects=registry())
    curve = torchlc.simulate(scene, start="2020-10-17T13:00:00", hours=6.0, cadence=900.0, noise=0.02, seed=1)
    recording = replace(curve.recording, observed=curve.mag)
    model = LightCurve(scene, recording, effects=["earth_shadow", "self_shadowing", "panel_offset"])
    value = model()
    value.sum().backward()
    theta = model.theta().detach().repeat(2, 1)
    fixed = {name: value_of(number) for name, number in scene.materials["body"].parameters.items()}
    body = scene.materials["body"].model_copy(update={"parameters": fixed})  # few numbers are quick to fit
    fewer = scene.model_copy(update={"materials": {**scene.materials, "body": body}})
    others = [made(case, scene, recording) for case in OTHERS]
    for other in others:
        other().sum().backward()
    numbers = {
        "mag": curve.mag.tolist(),
        "others": [other().tolist() for other in others],
        "slopes": [[float(one.grad) for one in other.free.parameters()] for other in others],
        "value": value.tolist(),
        "slope": [float(one.grad) for one in model.free.parameters()],
        "log_prob": Likelihood(model).log_prob(theta).tolist(),
        "fit": torchlc.fit(fewer, recording, steps=4).parameters(),
        "made": [str(value.dtype), str(value.device)],
    }
    return json.dumps(numbers)


@pytest.mark.long
def test_defaults_of_torch_change_no_number() -> None:
    """A tensor made on the default device "meta" would have no number; one made in the other default precision another."""
    expected = outcome()
    assert json.loads(expected)["made"] == ["torch.float64", "cpu"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, "-c", COMMAND], capture_output=True, text=True, cwd=ROOT, env=environment
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == expected
