"""Free geometry: what a call costs when no geometry is the one of the call before."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
import torch
from torch import Tensor

import torchlc
from benchmarks.cases import EXPOSURE_S, NIGHT, recording_of
from benchmarks.timing import Result, least
from examples.paper import setting
from torchlc.lightcurve.evaluators.expansion import UnsuitableError
from torchlc.lightcurve.model import LightCurve

FREE_WALKERS, FREE_EPOCHS, HOURS = 32, 351, 7.0
RUNS, SLOW_RUNS, SETS = 60, 12, 5
"""Rounds of calls that take a millisecond and of slower ones; sets of geometries that slower ones take in turn."""
DEFAULT = ("exposure_smearing", "light_time", "sun_distance", "finite_sun", "self_shadowing", "earth_shadow")
SPREAD = {"deg": 3.0, "s": 10.0, "size_x": 0.1, "size_y": 0.1, "size_z": 0.1, "size_u": 0.1, "size_v": 0.1}
"""Standard deviations of the geometries, where the prior is wider than a search would be."""
POSTERIOR = {
    "deg": (1.0, 0.05),
    "x": (0.0, 0.1),
    "y": (0.0, 0.1),
    "z": (0.0, 0.1),
    "s": (0.0, 2.0),
    "period_min": (30.0, 0.1),
    "phase_deg": (90.0, 3.0),
    "axis_lon": (60.0, 2.0),
    "axis_lat": (10.0, 2.0),
    "area": (1.0, 0.05),
    "lon": (30.0, 1.0),
    "lat": (40.0, 1.0),
}
"""Value and standard deviation of a geometry, about which it is expanded; sizes have one of a hundredth."""


@dataclass(frozen=True)
class Case:
    """What is free beside the materials: effects whose numbers are, or sizes of the parts, or the rocket's attitude."""

    what: str
    effects: tuple[str, ...] = ()
    sized: bool = False
    rocket: bool = False
    bar: float = 6.0


BARE = (
    Case("sizes", sized=True, bar=1.5),
    Case("panel_offset", ("panel_offset",)),
)
CASES = (
    Case("sizes", sized=True, bar=4.0),
    Case("panel_offset", ("panel_offset",)),
    Case("attitude_offset", ("attitude_offset",)),
    Case("time_offset", ("time_offset",)),
    Case("wobble", ("wobble",)),
    Case("appendage", ("appendage",)),
    Case(
        "sizes and panel, attitude and time offset",
        ("panel_offset", "attitude_offset", "time_offset"),
        sized=True,
        bar=10.0,
    ),
)


def free() -> Iterator[Result]:
    """A likelihood call of 32 walkers x 351 epochs, 32 geometries that no call before had, over one of a fixed geometry
    with the same effects."""
    yield from _against_fixed("bare", (), BARE)
    yield from _against_fixed("default effects", DEFAULT, CASES)
    yield from _rockets()


def _against_fixed(label: str, effects: Sequence[str], cases: Sequence[Case]) -> Iterator[Result]:
    fixed = box_wing(effects)
    seconds = least({"fixed": fresh(fixed)}, RUNS)
    yield Result(f"{label}: geometry fixed", 1e3 * seconds["fixed"], unit=" ms")
    likelihoods = {case.what: box_wing((*effects, *case.effects), sized=case.sized) for case in cases}
    seconds |= least({what: fresh(one) for what, one in likelihoods.items()}, SLOW_RUNS)
    for case in cases:
        ratio = seconds[case.what] / seconds["fixed"]
        yield Result(f"{label}: {case.what} free, exact / fixed", ratio, f"at most {case.bar:g}")
    if effects:
        several = likelihoods[cases[-1].what]
        gradient = least({"gradient": slope(several)}, SLOW_RUNS)["gradient"]
        ratio = gradient / seconds[cases[-1].what]
        yield Result(f"{label}: {cases[-1].what} free, value and gradient / value", ratio, "at most 3.5")
    for case in cases if effects else ():
        yield from _expanded(f"{label}: {case.what} free", likelihoods[case.what], seconds["fixed"], case.bar)


def _expanded(what: str, likelihood: torchlc.Likelihood, fixed: float, bar: float) -> Iterator[Result]:
    """The same by the expansion that a chain moves on, at draws of a posterior."""
    theta, sd = posterior_of(likelihood)
    start = time.process_time()
    try:
        quick = likelihood.expanded(theta, torch.diag(sd**2))
    except UnsuitableError as error:
        yield Result(f"{what}: no expansion, for {error}", math.nan)
        return
    made = time.process_time() - start
    noise = torch.randn(SETS, FREE_WALKERS, len(theta), generator=torch.Generator().manual_seed(1)).to(theta)
    points = cycle(theta + noise * sd)
    seconds = least({"call": torch.no_grad()(lambda: quick.log_prob(next(points)))}, RUNS)["call"]
    yield Result(f"{what}, expanded / fixed", seconds / fixed, f"at most {bar:g}")
    yield Result(f"{what}, expanded: largest error", quick.model.evaluator.error_mag, "at most 0.002", " mag")
    yield Result(f"{what}, expanded: making it / a call of fixed geometry", made / fixed)


def posterior_of(likelihood: torchlc.Likelihood) -> tuple[Tensor, Tensor]:
    """Natural values theta (P,) and standard deviations (P,) of a posterior about the paper's materials."""
    theta = likelihood.model.parameter_set.start().clone()
    sd = 0.01 * theta
    for column, one in enumerate(likelihood.model.parameter_set.free):
        known = setting.TABLE_3[1].get(one.origin.owner, {})
        if one.origin.quantity in known:
            theta[column], sd[column] = known[one.origin.quantity], 0.01 * known[one.origin.quantity]
        elif one.origin.quantity in POSTERIOR:
            theta[column], sd[column] = POSTERIOR[one.origin.quantity]
    return theta, sd


def _rockets() -> Iterator[Result]:
    effects = tuple(name for name in DEFAULT if name != "self_shadowing")
    fixed = rocket(effects, turning=False, most=1e6)
    seconds = least({"fixed": fresh(fixed)}, RUNS)
    yield Result("rocket body: geometry fixed", 1e3 * seconds["fixed"], unit=" ms")
    calls = {f"n to {most:.0e}": fresh(rocket(effects, turning=True, most=most)) for most in (1e6, 1e3)}
    seconds |= least(calls, 1)
    for name in calls:
        yield Result(
            f"rocket body: spin axis and phase free, {name} / fixed",
            seconds[name] / seconds["fixed"],
            "at most 10",
        )


def fresh(likelihood: torchlc.Likelihood):
    """A call of the likelihood that takes another set of geometries each time."""
    sets = [around(likelihood, seed=seed) for seed in range(SETS if likelihood.model.geometry_free else 1)]
    points = cycle(sets)

    def call() -> Tensor:
        with torch.no_grad():
            return likelihood.log_prob(next(points) * (1 + 1e-9 * float(torch.rand(()))))

    return call


def slope(likelihood: torchlc.Likelihood):
    """A call with its gradient that takes another set of geometries each time."""
    points = cycle([around(likelihood, seed=seed) for seed in range(SETS)])

    def call() -> Tensor:
        theta = (next(points) * (1 + 1e-9 * float(torch.rand(())))).requires_grad_()
        return torch.autograd.grad(likelihood.log_prob(theta).sum(), theta)[0]

    return call


def around(likelihood: torchlc.Likelihood, count: int = FREE_WALKERS, seed: int = 0) -> Tensor:
    """Natural values theta (count, P): what moves the geometry about the truth, the rest from the prior."""
    model = likelihood.model
    generator = torch.Generator().manual_seed(seed)
    theta = model.parameter_set.sample_prior(count, generator)
    start = model.parameter_set.start()
    for column in model.assembly.geometry_columns:
        one = model.parameter_set.free[column]
        spread = SPREAD.get(one.origin.quantity)
        if spread is not None:
            noise = torch.randn(count, generator=generator, dtype=theta.dtype)
            theta[:, column] = start[column] + spread * noise
    return theta


def box_wing(effects: Sequence[str], *, sized: bool = False) -> torchlc.Likelihood:
    """Object 1 of the paper, materials free, and all its sizes if ``sized``; exposures of 5 s."""
    curve = torchlc.simulate(
        setting.object_1(),
        start=NIGHT,
        hours=HOURS,
        cadence=HOURS * 3600 / (FREE_EPOCHS - 1),
        noise=0.02,
        seed=1,
    )
    scene = setting.object_1(setting.free_materials())
    if sized:
        scene = _sized(scene)
    recording = recording_of(curve, scene)
    exposed = replace(recording, exptime=np.full(len(recording.seconds), EXPOSURE_S))
    return torchlc.Likelihood(LightCurve(scene, exposed, effects=list(effects)))


def _sized(scene: torchlc.Scene) -> torchlc.Scene:
    parts = [
        part.model_copy(update={"size": tuple(_about(float(edge)) for edge in part.size)})
        for part in scene.components
    ]
    return scene.model_copy(update={"components": parts})


def _about(value: float) -> torchlc.scene.Free:
    return torchlc.scene.Free(value=value, low=0.3 * value, high=1.5 * value)


ROCKET = """
format = "torchlc-scene/1"
name = "rocket body"
[orbit]
tle = ["{}",
       "{}"]
[[stations]]
id = "station"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "inertial"
x_angle = {}
spin_axis = [0.2, 1.0, 0.3]
spin_rate = 1.0
spin_phase = {}
[[components]]
name = "stage"
shape = "cylinder"
radius = 1.2
length = 7.0
centre = [0, 0, 0]
material = "paint"
[materials.paint]
n = {{ value = 200.0, low = 1.0, high = {}, prior = "loguniform" }}
r_spec = {{ value = 0.1, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.3, low = 0.0, high = 1.0 }}
[model]
effects = []
[model.parameters]
band_sun_magnitude = -26.7
"""
AXIS = "{ value = 30.0, low = 0.0, high = 90.0 }", "{ value = 10.0, low = 0.0, high = 180.0 }"


def rocket(effects: Sequence[str], *, turning: bool, most: float) -> torchlc.Likelihood:
    """A cylinder that tumbles; angle of its axis and phase free where it is ``turning``."""
    angles = AXIS if turning else (30.0, 10.0)
    scene = torchlc.Scene.from_toml(ROCKET.format(*setting.ORBITS[1], *angles, most))
    curve = torchlc.simulate(
        scene, start=NIGHT, hours=HOURS, cadence=HOURS * 3600 / (FREE_EPOCHS - 1), noise=0.02, seed=1
    )
    recording = recording_of(curve, scene)
    exposed = replace(recording, exptime=np.full(len(recording.seconds), EXPOSURE_S))
    return torchlc.Likelihood(LightCurve(scene, exposed, effects=list(effects)))
