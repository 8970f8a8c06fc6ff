"""From a scene and a recording to rotation states: the periods to look at, a grid of poles, least squares, the counts of
turns between passes, and the model with everything in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.files.numbers import value_of
from torchlc.geometry.orbit.earth import icrs_from_ecliptic
from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import laplace, polish
from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.connect import Connection, connections, differences
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows, rows_of
from torchlc.inference.rotation.pole_grid import GridState
from torchlc.inference.rotation.refine import Local, Refiner
from torchlc.inference.rotation.windows import windows
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, iso_times
from torchlc.scene import Free, Scene
from torchlc.scene.parts import Attitude

POLES = 500
STEPS_A_TURN = 12.0
"""Frequencies of the grid: steps of 1/12 turn over the longest pass."""
STARTS_S, START_S, PAIR_S = 14.0, 0.06, 2.2e-6
"""CPU seconds for the first least squares, of a start, and of each pair of row and facet of a start, as measured on one core."""
LEAST_STARTS, MOST_STARTS = 24, 200
FLOOR = 0.05
"""Relative error of the light of facets."""
LOCALS, JOINED = 4, 3
"""Solutions of different poles, and counts of turns of the best, that the model is fitted to."""
KEPT_CHI2 = 25.0
SAME_DEG = 1.5
TILTED_DEG = 9.0
STRUCTURE = 1.25
"""Chi-square a degree of freedom above which a body is tried with its axes tilted."""
CHANGED = 16.0
"""Fall of chi-square that a change of the period has to bring."""
UNSTEADY = 150.0
"""Squared distance, in standard deviations, of the phases from any steady spin beyond which the model is not tried on one."""
ALIKE_DEG = 12.0
MIN_ROWS = 12
NAMES = ("pole_lon", "pole_lat", "period", "phase", "period_rate", "tilt_x", "tilt_y", "tilt_z")
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class RotationMode:
    """One state that fits: ``numbers`` of the attitude and ``sd`` of the free ones by name (pole deg in the scene's frame,
    period h, phase deg, period_rate ms a day, tilt deg); ``counts``, turns less those of the most probable mode between
    passes; ``probability`` among the modes that were found; ``mirror``, what it is of the best."""

    numbers: Mapping[str, float]
    sd: Mapping[str, float]
    chi2: float
    counts: tuple[float, ...]
    probability: float
    mirror: str | None
    theta: Tensor
    scene: Scene

    @property
    def period_s(self) -> float:
        return 3600.0 * self.numbers["period"]

    @property
    def period_sd_s(self) -> float:
        return 3600.0 * self.sd.get("period", 0.0)


@dataclass(frozen=True)
class RotationSearch:
    """Modes best first, and what was looked at. ``pole_map``: unit vectors (D, 3), GCRS, and misfits (D,) of the grid."""

    modes: Sequence[RotationMode]
    rows: int
    dof: int
    passes: int
    symmetry: int
    searched_s: tuple[float, float]
    frequency: np.ndarray
    power: np.ndarray
    pole_map: tuple[np.ndarray, np.ndarray]
    connected: bool
    decided: bool
    verdict: str
    recording: Recording
    warnings: Sequence[str] = field(default_factory=tuple)


def search_rotation(
    scene: Scene,
    recording: Recording,
    *,
    shortest_s: float | None = None,
    longest_s: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> RotationSearch:
    """Rotation states of a body that turns about a direction fixed in it and in space."""
    say = progress or (lambda _text, _share: None)
    if scene.attitude.mode not in ("spin-pole", "rigid-body"):
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}"',
            '"spin-pole" (pole, period, phase, epoch), whose numbers are where the search starts',
        )
    model = LightCurve(scene, recording)
    rows = rows_of(model)
    if len(rows.flux) < MIN_ROWS:
        raise InputError(
            recording.source,
            None,
            f"{len(rows.flux)} measured rows",
            f"at least {MIN_ROWS} to find a rotation",
        )
    if not float(rows.span.max()) > 0:
        raise InputError(recording.source, "column time", "passes of one row each", "a stretch of time")
    body = FacetLight.of(model.assembly)
    low, high, warnings = _range(scene, recording, rows, shortest_s, longest_s)
    warnings += body.notes
    ranges, frequency, power = windows(rows, low, high)
    step = 1 / (STEPS_A_TURN * float(rows.span.max()))
    grid = torch.cat(
        [torch.linspace(a, b, max(2, math.ceil((b - a) / step) + 1), dtype=torch.float64) for a, b in ranges]
    )
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    symmetry = body.symmetry(axis)
    poles = pole_grid.directions(POLES)
    say("poles", 0.0)
    states = pole_grid.search(
        rows, body, poles, grid, symmetry=_whole_steps(symmetry), progress=lambda share: say("poles", share)
    )
    count = int(STARTS_S / (START_S + PAIR_S * len(body.normal) * len(rows.flux)))
    count = max(LEAST_STARTS, min(MOST_STARTS, count))
    still = torch.zeros(3, dtype=torch.float64)
    say("least squares", 0.0)
    refiner = Refiner(rows, body, FLOOR, tilted=False)
    locals_ = _distinct(refiner.refined(states[:count], [still] * len(states[:count])))
    dof = max(1, len(rows.flux) - rows.passes - 6)
    tilted = "tilt" in scene.attitude.model_fields_set
    if tilted or locals_[0].chi2 / dof > STRUCTURE:
        slanted = _tilted(rows, body, poles, grid, states, count, axis)
        if slanted and slanted[0].chi2 < locals_[0].chi2 - CHANGED:
            locals_, tilted, symmetry = slanted, True, 1
    say("model", 0.0)
    found, connected, told = _fitted(scene, recording, rows, locals_, symmetry, tilted, (low, high), say)
    warnings += told
    modes = _merged(found, rows)
    if not modes:
        raise InputError(
            recording.source, None, "no rotation with a finite chi-square", "rows that the model can fit"
        )
    free = len(modes[0].sd) + len(modes[0].theta) - sum(name in modes[0].sd for name in NAMES)
    left = len(rows.flux) - free
    decided, verdict = _verdict(modes, left, connected, rows.passes)
    order = {tuple(one.pole.tolist()): one.misfit for one in states}
    misfits = np.array([order[tuple(one.tolist())] for one in poles])
    return RotationSearch(
        modes, len(rows.flux), left, rows.passes, symmetry, (1 / high, 1 / low), frequency, power,
        (poles.numpy(), misfits), connected, decided, verdict, recording, tuple(dict.fromkeys(warnings)),
    )  # fmt: skip


def _whole_steps(symmetry: int) -> int:
    """The part of a turn that the grid searches: one of which its steps are a multiple."""
    return max(m for m in range(1, symmetry + 1) if symmetry % m == 0 and (pole_grid.STEPS // 2) % m == 0)


def _range(
    scene: Scene, recording: Recording, rows: Rows, shortest: float | None, longest: float | None
) -> tuple[float, float, list[str]]:
    """Lowest and highest frequency of turns, 1/s."""
    for name, value in (("--shortest", shortest), ("--longest", longest)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(None, name, f"{value:g} s", "a number > 0")
    period = scene.attitude.period
    bounds = (period.low, period.high) if isinstance(period, Free) else (None, None)
    cadence = float(np.median(np.diff(np.unique(rows.seconds.numpy()))))
    warnings = []
    first = shortest or (3600 * bounds[0] if bounds[0] else 2 * cadence)
    last = longest or (3600 * bounds[1] if bounds[1] else float(rows.span.max()))
    if not isinstance(period, Free) and shortest is None and longest is None:
        warnings.append(
            f"the scene's period is fixed: all from {first:.4g} to {last:.4g} s were looked at, not only that"
        )
    if not first < last:
        raise InputError(
            recording.source,
            "--shortest, --longest",
            f"periods from {first:.4g} to {last:.4g} s",
            "a range of periods",
        )
    return 1 / last, 1 / first, warnings


def _tilted(
    rows: Rows,
    body: FacetLight,
    poles: Tensor,
    grid: Tensor,
    states: Sequence[GridState],
    count: int,
    axis: Tensor,
) -> list[Local]:
    """Solutions with the body's axes turned against the axis of the spin, from the best of the straight ones turned
    either way, each pass at each of the phases that a straight body cannot tell apart."""
    angle = math.radians(TILTED_DEG)
    tilts = [
        angle * torch.tensor(one, dtype=torch.float64)
        for one in ([1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0])
    ]
    generator = torch.Generator().manual_seed(0)
    ways = torch.nn.functional.normalize(
        torch.randn(2, 40, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    exponent = torch.full((40, sum(body.lobed)), 3.0, dtype=torch.float64)
    plain = body.light(ways[0], ways[1], exponent)
    near = torch.stack([one.pole for one in states[: max(12, count // 4)]])
    best = torch.tensor([one.frequency for one in states[:3]], dtype=torch.float64)
    close = grid[(grid[:, None] - best).abs().amin(-1) < 2.5 / float(rows.span.max()) / STEPS_A_TURN]
    symmetric = body.symmetry(axis) % 2 == 0
    starts: list[GridState] = []
    turned: list[Tensor] = []
    for number, tilt in enumerate(tilts):
        slanted = body.turned(rotation_of(tilt))
        moved = slanted.light(ways[0], ways[1], exponent)
        if bool(((moved - plain).abs() <= 1e-3 * plain.abs().amax(0)).all()) or (symmetric and number > 1):
            continue  # a turn that changes nothing, or the half turn of another
        for state in pole_grid.search(rows, slanted, near, close)[: max(6, count // 8)]:
            starts.append(state)
            turned.append(tilt)
    if not starts:
        return []
    return _distinct(Refiner(rows, body, FLOOR, tilted=True).refined(starts, turned, iterations=40))


def _distinct(found: Sequence[Local]) -> list[Local]:
    """Solutions of different poles or periods, best first."""
    kept: list[Local] = []
    for one in found:
        if not math.isfinite(one.chi2):
            continue
        if all(
            _apart_deg(one.pole, other.pole) > SAME_DEG or abs(one.frequency / other.frequency - 1) > 1e-3
            for other in kept
        ):
            kept.append(one)
    return kept


def _apart_deg(a: Tensor, b: Tensor) -> float:
    return math.degrees(2 * math.asin(min(1.0, float(torch.linalg.vector_norm(a - b)) / 2)))


@dataclass(frozen=True)
class _Candidate:
    scene: Scene
    theta: Tensor
    numbers: dict[str, float]
    sd: dict[str, float]
    chi2: float
    counts: tuple[float, ...]
    changing: bool
    pole: Tensor


def _fitted(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    locals_: Sequence[Local],
    symmetry: int,
    tilted: bool,
    bounds: tuple[float, float],
    say: Progress,
) -> tuple[list[_Candidate], bool, list[str]]:
    """The model fitted at the solutions and counts of turns that may be right; whether the passes are connected."""
    told: list[str] = []
    rate = scene.attitude.period_rate
    may_change = isinstance(rate, Free) or rows.passes > 2
    always = isinstance(rate, Free)
    wide = (bounds[0] * (1 - 1e-9), bounds[1] * (1 + 1e-9))
    tasks: list[tuple[Local, Connection, bool]] = []
    connected = True
    for number, local in enumerate(locals_[:LOCALS]):
        if number and local.chi2 > 1.5 * locals_[0].chi2 + 200:
            break
        for changing in (False, True) if may_change else (False,):
            joined = connections(rows, local, symmetry, changing=changing, bounds=wide)
            if not joined.complete:
                connected = False
            if not changing and may_change and joined.found and joined.found[0].distance > UNSTEADY:
                continue  # no steady spin has these phases
            near = [one for one in joined.found if one.distance < joined.found[0].distance + KEPT_CHI2]
            tried = JOINED if number == 0 else 1
            if number == 0 and len(near) > tried:
                told.append(
                    f"{len(near)} counts of turns between the passes are possible by their phases"
                    f"{' if the period changes' if changing else ''}; the {tried} best were tried with the model"
                )
            tasks += [(local, one, changing) for one in near[:tried]]
    if not tasks:
        told.append(
            "no count of turns between the passes joins their phases to one rotation within its bounds"
        )
    if not connected:
        told.append(
            "the passes are too far apart for their phases to be connected: the counts of turns between them that are "
            "shown are some of many"
        )
    found: list[_Candidate] = []
    for number, (local, one, changing) in enumerate(tasks):
        if changing and not always and found and not _wanting(found, rows):
            continue
        found.append(_polished(scene, recording, rows, local, one, changing, tilted, symmetry))
        say("model", (number + 1) / len(tasks))
    return [one for one in found if math.isfinite(one.chi2)], connected, told


def _wanting(found: Sequence[_Candidate], rows: Rows) -> bool:
    """Whether steady spin leaves more than the errors allow: chi-square beyond 3 of its standard deviations."""
    least = (
        min(one.chi2 for one in found if not one.changing)
        if any(not one.changing for one in found)
        else math.inf
    )
    count = len(rows.flux)
    return least > count + 3 * math.sqrt(2 * count)


def _polished(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    local: Local,
    one: Connection,
    changing: bool,
    tilted: bool,
    symmetry: int,
) -> _Candidate:
    """The model's own least squares from a solution and a count of turns."""
    trial, start = _scene_at(scene, recording, rows, local, one, changing, tilted)
    model = LightCurve(trial, recording)
    likelihood = Likelihood(model)
    parameters = model.parameter_set
    theta = parameters.start().clone()
    _materials(model, local, theta)
    noise = model.noise(theta) if model.assembly.stage("noise") else None
    moving = model.assembly.geometry_columns
    if len(moving) < len(theta):  # the materials first, so that the attitude does not stand in for them
        settled = polish(likelihood, theta[None], noise, iterations=12, held=moving)
        theta = parameters.from_flat(settled.y[0])
    best = polish(likelihood, theta[None], noise, iterations=40)
    place = int(best.cost.argmin())
    natural = parameters.from_flat(best.y[place])
    with torch.no_grad():
        chi2 = float(likelihood.chi2(natural))
    low, high = parameters.flat_bounds()
    covariance, _ = laplace(best.jacobian[place], best.y[place], low, high)
    spread = torch.sqrt(torch.diagonal(covariance).clamp(min=0))
    shifted = parameters.from_flat(best.y[place] + 1e-4 * spread)
    natural_sd = ((shifted - natural).abs() / 1e-4).tolist()
    numbers = dict(start)
    sd: dict[str, float] = {}
    for name, value, width in zip(parameters.names, natural.tolist(), natural_sd, strict=True):
        short = name.removeprefix("attitude.")
        if name.startswith("attitude.") and short in NAMES:
            numbers[short] = value
            sd[short] = width
    return _Candidate(
        trial, natural, numbers, sd, chi2, differences(one.counts, symmetry), changing, _pole(scene, numbers)
    )


def _pole(scene: Scene, numbers: Mapping[str, float]) -> Tensor:
    """Unit vector of the pole in GCRS."""
    lon, lat = math.radians(numbers["pole_lon"]), math.radians(numbers["pole_lat"])
    way = torch.tensor(
        [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)], dtype=torch.float64
    )
    return torch.from_numpy(icrs_from_ecliptic()) @ way if scene.orbit.vectors == "ecliptic" else way


def _epoch_s(scene: Scene, recording: Recording) -> tuple[Any, float]:
    """Epoch of the states and its seconds from row 0: the scene's, if it is within a day of the rows, else the first row."""
    from torchlc.geometry.rotation.attitude import epoch_seconds

    seconds = epoch_seconds(scene, recording, "epoch")
    if -86400.0 <= seconds <= float(recording.seconds[-1]) + 86400.0:
        return scene.attitude.epoch, seconds
    return iso_times(recording)[0], 0.0


def _scene_at(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    local: Local,
    one: Connection,
    changing: bool,
    tilted: bool,
) -> tuple[Scene, dict[str, float]]:
    """The scene with the attitude of a solution, its numbers free near it."""
    epoch, seconds = _epoch_s(scene, recording)
    away = seconds - one.middle
    frequency = one.frequency + one.change * away
    phase = one.phase + one.frequency * away + one.change * away**2 / 2
    period = 1 / frequency / 3600
    rate = -one.change / frequency**2 * 86400e3
    pole = local.pole
    if scene.orbit.vectors == "ecliptic":
        pole = torch.from_numpy(icrs_from_ecliptic()).T @ pole
    longitude = math.degrees(math.atan2(float(pole[1]), float(pole[0]))) % 360
    latitude = math.degrees(math.asin(max(-1.0, min(1.0, float(pole[2])))))
    phase_deg = 360 * (phase % 1.0)
    total = max(float(np.ptp(rows.seconds.numpy())), 1.0)
    reach = period * min(0.03, 4 / (frequency * total))
    values = {"pole_lon": longitude, "pole_lat": latitude, "period": period, "phase": phase_deg}
    table: dict[str, Any] = {
        "mode": "spin-pole",
        "pole": (
            Free(value=longitude, low=longitude - 180, high=longitude + 180),
            Free(value=latitude, prior="isotropic"),
        ),
        "period": Free(value=period, low=period - reach, high=period + reach),
        "phase": Free(value=phase_deg, low=phase_deg - 180, high=phase_deg + 180),
        "epoch": epoch,
    }
    if changing:
        most = max(20.0, 3 * abs(rate))
        values["period_rate"] = rate
        table["period_rate"] = Free(value=rate, low=-most, high=most)
    elif value_of(scene.attitude.period_rate):
        values["period_rate"] = table["period_rate"] = value_of(scene.attitude.period_rate)
    if tilted:
        tilt = [math.degrees(x) for x in local.tilt.tolist()]
        values |= {f"tilt_{axis_}": x for axis_, x in zip("xyz", tilt, strict=True)}
        table["tilt"] = (
            Free(value=tilt[0], low=min(-45.0, tilt[0]), high=max(45.0, tilt[0])),
            Free(value=tilt[1], low=min(-45.0, tilt[1]), high=max(45.0, tilt[1])),
            0.0,
        )
    return scene.model_copy(update={"attitude": Attitude(**table)}), values


def _materials(model: LightCurve, local: Local, theta: Tensor) -> None:
    """Reflectances and exponents of a solution put among the starting values theta (P,), where the law has such."""
    parameters = model.parameter_set
    names = list(dict.fromkeys(name for part in model.assembly.shape.parts for name in part.materials))
    body = FacetLight.of(model.assembly)
    place = {}
    number = 0
    for k, name in enumerate(names):
        diffuse = float(local.weights[k])
        place[name, "r_diff"] = place[name, "albedo"] = diffuse
        if body.lobed[k]:
            lobe, n = float(local.weights[len(names) + number]), float(local.exponents[number])
            place[name, "r_spec"] = place[name, "f0"] = lobe
            place[name, "n"] = place[name, "n_u"] = place[name, "n_v"] = n
            place[name, "alpha"] = place[name, "m"] = math.sqrt(2 / n)
            number += 1
    for k, free in enumerate(parameters.free):
        origin = free.origin
        value = place.get((origin.owner, origin.quantity))
        if origin.role == "materials" and value is not None:
            low, high = max(free.prior.low, 0.0), free.prior.high
            if origin.quantity in ("r_diff", "r_spec"):  # well inside of the triangle that they share
                low, high = max(low, 0.01), min(high, 0.6 if origin.quantity == "r_diff" else 0.35)
            theta[k] = min(max(value, low), high)


def _merged(found: Sequence[_Candidate], rows: Rows) -> list[RotationMode]:
    """Modes within KEPT_CHI2 of the best, equal ones once. A change of the period counts only where it takes CHANGED off
    chi-square."""
    steady = [one for one in found if not one.changing]
    moving = [one for one in found if one.changing]
    if steady and moving and min(one.chi2 for one in moving) > min(one.chi2 for one in steady) - CHANGED:
        found = steady
    ranked = sorted(found, key=lambda one: one.chi2)
    kept: list[_Candidate] = []
    for one in ranked:
        if one.chi2 > ranked[0].chi2 + KEPT_CHI2:
            break
        if all(
            _apart_deg(one.pole, other.pole) > SAME_DEG
            or abs(one.numbers["period"] / other.numbers["period"] - 1) > 3 * _relative(one, other)
            for other in kept
        ):
            kept.append(one)
    if not kept:
        return []
    weights = np.exp(-0.5 * np.array([one.chi2 - kept[0].chi2 for one in kept]))
    weights /= weights.sum()
    base = kept[0].counts
    return [
        RotationMode(
            one.numbers,
            one.sd,
            one.chi2,
            tuple(a - b for a, b in zip(one.counts, base, strict=True)),
            float(weight),
            None if one is kept[0] else _mirror(one.pole, kept[0].pole, rows),
            one.theta,
            one.scene,
        )
        for one, weight in zip(kept, weights, strict=True)
    ]


def _relative(one: _Candidate, other: _Candidate) -> float:
    """Standard deviation of the ratio of two periods, at least one of rounding."""
    return 1e-12 + sum(
        candidate.sd.get("period", 0.0) / candidate.numbers["period"] for candidate in (one, other)
    )


def _mirror(pole: Tensor, best: Tensor, rows: Rows) -> str | None:
    """What a pole is of the best one, if it is a mirror image."""
    if _apart_deg(pole, -best) < ALIKE_DEG:
        return "the opposite pole"
    normal = torch.linalg.cross(rows.to_sun.mean(0), rows.to_observer.mean(0))
    if float(torch.linalg.vector_norm(normal)) < 1e-6:
        return None
    normal = normal / torch.linalg.vector_norm(normal)
    image = best - 2 * (best @ normal) * normal
    if _apart_deg(pole, image) < ALIKE_DEG:
        return "the mirror image in the plane of Sun and observer"
    if _apart_deg(pole, -image) < ALIKE_DEG:
        return "the opposite of the mirror image in the plane of Sun and observer"
    return None


def _verdict(modes: Sequence[RotationMode], dof: int, connected: bool, passes: int) -> tuple[bool, str]:
    """Whether the data decide, and what they say."""
    best = modes[0]
    fits = best.chi2 < dof + 5 * math.sqrt(2 * max(dof, 1))
    poles = [mode for mode in modes if mode.probability > 0.01]
    period = f"{best.period_s:.6g} s"
    if not fits:
        return False, (
            f"cannot tell: the best rotation found, a turn in {period}, leaves chi-square {best.chi2:.0f} for {dof} degrees of "
            "freedom; shape, materials or the kind of rotation are not those of the scene"
        )
    if len(poles) > 1:
        return False, (
            f"cannot tell: {len(poles)} rotations fit about as well, the best with a turn in {period}; the table lists them"
        )
    if passes > 1 and not connected:
        return False, (
            f"cannot tell how often it turned between the passes: a turn takes {period} to about a thousandth, and neither its further "
            "digits nor a change of the period is known; errors that are given hold for the counts of turns that are shown"
        )
    joined = "" if passes < 2 else ", the turns between the passes counted"
    return True, f"one turn in {period}{joined}"
