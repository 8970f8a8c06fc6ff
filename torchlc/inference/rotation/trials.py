"""Rotations to fit the model to, made of what the light of facets suggests: the scene with its attitude free near each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.files.numbers import value_of
from torchlc.geometry.orbit.earth import icrs_from_ecliptic
from torchlc.geometry.rotation.attitude import epochs_seconds
from torchlc.inference.rotation.connect import Connection, differences
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.refine import MOST_TILT, Local, free_tilts
from torchlc.inference.rotation.tumble_refine import Tumble, advanced
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, iso_times
from torchlc.scene import Free, Scene
from torchlc.scene.parts import Attitude

MOST_DIFFUSE, MOST_LOBE = 0.6, 0.35
"""Starting reflectances are put well inside of the triangle that they share."""
SECOND_MOMENT = 0.9
"""Share of the way to the edge of the possible bodies that the bounds of the moments go."""
NUTATION_DEG = 15.0
"""Either way: more than the light of facets, on its grid of angles, has it wrong by."""


@dataclass(frozen=True)
class Count:
    """One count of turns between passes that is possible: turns more than in the fit, probability among the counts of its kind, and
    the period, s, at the epoch of the fit and its change, ms a day, that go with it."""

    more: tuple[float, ...]
    probability: float
    period_s: float
    period_rate: float


@dataclass(frozen=True)
class Trial:
    """A rotation to fit the model to: a scene whose attitude is free near it, its ``numbers``, materials; ``counts``, turns
    between passes, and ``ways``, of the angular momentum round the body; ``possible``, how many counts the phases leave, which spread the
    numbers by ``spread`` (standard deviations); ``changing``: the period does; ``periods`` of the passes, each by itself, s, with
    standard deviations. ``apart``: what each night has for itself, "phase" or "phase" and "period"; of the ``reference`` night are then
    the numbers by these names."""

    scene: Scene
    numbers: Mapping[str, float]
    exponents: Tensor
    weights: Tensor
    counts: tuple[float, ...]
    ways: tuple[float, ...] = ()
    changing: bool = False
    possible: int = 1
    complete: bool = True
    spread: Mapping[str, float] = field(default_factory=dict)
    likely: tuple[Count, ...] = ()
    periods: tuple[tuple[float, float], ...] = ()
    apart: tuple[str, ...] = ()
    reference: str = ""


def epoch_seconds(scene: Scene, recording: Recording) -> tuple[Any, float]:
    """Epoch of the states and its seconds from row 0: the scene's, if it is one and within a day of the rows, else the first
    row."""
    seconds, *others = epochs_seconds(scene, recording, "epoch")
    if not others and -86400.0 <= seconds <= float(recording.seconds[-1]) + 86400.0:
        return scene.attitude.epoch, seconds
    return iso_times(recording)[0], 0.0


def steady_trial(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    local: Local,
    one: Connection,
    symmetry: int,
    *,
    changing: bool,
    tilted: bool,
) -> Trial:
    """A turn about one axis with one count of turns between passes, free near it."""
    epoch, seconds = epoch_seconds(scene, recording)
    phase, frequency = one.at(seconds)
    period, rate = 1 / frequency / 3600, one.rate
    longitude, latitude = _angles(scene, local.pole)
    phase_deg = 360 * (phase % 1.0)
    total = max(float(np.ptp(rows.seconds.numpy())), 1.0)
    reach = period * min(0.03, 4 / (frequency * total))
    values = {"pole_lon": longitude, "pole_lat": latitude, "period": period, "phase": phase_deg}
    table: dict[str, Any] = {
        "mode": "spin-pole",
        "pole": _free_pole(longitude, latitude),
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
        _tilt(scene, recording, local, values, table)
    return _trial(scene, local, values, table, counts=differences(one.counts, symmetry), changing=changing)


def _trial(scene: Scene, local: Local, values: dict[str, float], table: dict[str, Any], **more: Any) -> Trial:
    """A model near ``local`` with the attitude of a table."""
    attitude = {"attitude": Attitude(**table)}
    return Trial(
        scene=scene.model_copy(update=attitude),
        numbers=values,
        exponents=local.exponents,
        weights=local.weights,
        periods=_periods(local),
        **more,
    )


def _tilt(
    scene: Scene, recording: Recording, local: Local, values: dict[str, float], table: dict[str, Any]
) -> None:
    """The tilt of a solution, put into the numbers and the attitude of a trial."""
    free = free_tilts(FacetLight.of(LightCurve(scene, recording).assembly))
    tilt = [math.degrees(x) for x in local.tilt.tolist()]
    values |= {f"tilt_{axis_}": x for axis_, x in zip("xyz", tilt, strict=True)}
    most = math.degrees(MOST_TILT) + 1
    table["tilt"] = tuple(
        Free(value=x, low=-most, high=most) if component in free else x for component, x in enumerate(tilt)
    )


def alike(local: Local) -> bool:
    """Whether one frequency is that of every pass, within 3 standard deviations of each."""
    count = len(local.frequencies)
    variance = torch.diagonal(local.covariance)[:count].clamp(min=1e-30)
    common = _common(local)
    return bool(((local.frequencies - common).square() <= 9 * variance).all())


def _common(local: Local) -> float:
    """The mean frequency of the passes by their errors, 1/s."""
    weight = 1 / torch.diagonal(local.covariance)[: len(local.frequencies)].clamp(min=1e-30)
    return float((weight * local.frequencies).sum() / weight.sum())


def loose_trial(
    scene: Scene, recording: Recording, rows: Rows, local: Local, *, periods: bool, tilted: bool
) -> Trial:
    """A turn about one axis in common, of which each night has its own phase, and with ``periods`` its own period: where the turns
    between nights cannot be counted, or no one rate holds over them. Passes of one night are joined by the period."""
    index = rows.index.numpy()
    night, number = recording.night[index], rows.number.numpy()
    epochs = night_epochs(recording, night, number, index)
    seconds, texts = recording.seconds, iso_times(recording)
    at = {key: float(seconds[row]) for key, row in epochs.items()}
    common = _common(local)
    phase: dict[str, float] = {}
    period: dict[str, float] = {}
    for night_number, name in enumerate(recording.night_ids):
        held = np.unique(number[night == night_number])
        if not len(held):
            continue
        longest = int(held[np.argmax(rows.span.numpy()[held])])
        frequency = float(local.frequencies[longest]) if periods else common
        away = at[night_number] - float(rows.middle[longest])
        phase[name] = 360 * ((float(local.phases[longest]) + frequency * away) % 1.0)
        period[name] = 1 / frequency / 3600
    reference = recording.night_ids[int(night[number == rows.longest][0])]
    reach = min(0.03, 4 / (common * max(float(rows.span.max()), 1.0)))
    low, high = min(period.values()) * (1 - reach), max(period.values()) * (1 + reach)
    longitude, latitude = _angles(scene, local.pole)
    values = {
        "pole_lon": longitude,
        "pole_lat": latitude,
        "period": period[reference],
        "phase": phase[reference],
    }
    several = {"per": "night", "values": period} if periods else {}
    table: dict[str, Any] = {
        "mode": "spin-pole",
        "pole": _free_pole(longitude, latitude),
        "period": Free.model_validate({"value": period[reference], "low": low, "high": high, **several}),
        "phase": Free(value=phase[reference], low=-180.0, high=540.0, per="night", values=phase),
        "epoch": tuple(texts[row] for row in sorted(set(epochs.values()))),
    }
    if tilted:
        _tilt(scene, recording, local, values, table)
    apart = ("phase", "period") if periods else ("phase",)
    return _trial(scene, local, values, table, counts=(), apart=apart, reference=reference)


def night_epochs(
    recording: Recording, night: np.ndarray, number: np.ndarray, index: np.ndarray
) -> dict[int, int]:
    """By the number of a night, the row of the recording that it counts from: nights that share a pass, as those of two stations
    do, have one. ``night`` and pass ``number`` are those of the rows ``index``."""
    groups: list[tuple[set[int], set[int]]] = []
    for night_number, held in sorted(set(zip(night.tolist(), number.tolist(), strict=True))):
        met = [group for group in groups if night_number in group[0] or held in group[1]]
        groups = [group for group in groups if group not in met]
        groups.append(({night_number}.union(*(a for a, _ in met)), {held}.union(*(b for _, b in met))))
    epochs: dict[int, int] = {}
    for nights, _ in groups:
        of = index[np.isin(night, list(nights))]
        seconds = recording.seconds[of]
        row = int(of[np.abs(seconds - (seconds.min() + seconds.max()) / 2).argmin()])
        epochs |= dict.fromkeys(nights, row)
    return epochs


def _periods(local: Local) -> tuple[tuple[float, float], ...]:
    """Periods of the passes, s, with standard deviations."""
    sd = torch.sqrt(torch.diagonal(local.covariance)[: len(local.frequencies)].clamp(min=0))
    return tuple((1 / f, s / f**2) for f, s in zip(local.frequencies.tolist(), sd.tolist(), strict=True))


def tumbling_trial(scene: Scene, recording: Recording, rows: Rows, state: Tumble) -> Trial:
    """A free rotation, free near a state with phases at one instant."""
    epoch, seconds = epoch_seconds(scene, recording)
    moments = state.moments[None]
    nutation, long = moments.new_tensor([state.nutation]), moments.new_tensor([state.long])
    reference = int(state.at.shape[0] > 1) * rows.longest
    elapsed = (seconds - state.at[reference])[None].to(moments)
    turn, way = advanced(
        moments, nutation, long, state.turn[reference, None], state.way[reference, None], elapsed
    )
    x, y = float(moments[0, 0]), float(moments[0, 1])
    quarter = 0.25 if y < x < 1 else 0.0  # from where `rigid-body` counts the phase
    longitude, latitude = _angles(scene, state.pole)
    values = {
        "pole_lon": longitude,
        "pole_lat": latitude,
        "period": 1 / state.long / 3600,
        "phase": 360 * ((float(turn) - quarter) % 1.0),
        "polhode_phase": 360 * (float(way) % 1.0),
        "nutation": math.degrees(state.nutation),
        "inertia_x": x,
        "inertia_y": y,
    }
    total = max(float(np.ptp(rows.seconds.numpy())), 1.0)
    reach = min(0.03, 4 / (state.long * total))
    room = SECOND_MOMENT * min(x + y - 1, 1 + y - x, 1 + x - y) / 2
    nutation_deg, period = values["nutation"], values["period"]
    table: dict[str, Any] = {
        "mode": "rigid-body",
        "pole": _free_pole(longitude, latitude),
        "period": Free(value=period, low=period * (1 - reach), high=period * (1 + reach)),
        "phase": Free(value=values["phase"], low=values["phase"] - 180, high=values["phase"] + 180),
        "polhode_phase": Free(
            value=values["polhode_phase"],
            low=values["polhode_phase"] - 180,
            high=values["polhode_phase"] + 180,
        ),
        "nutation": Free(
            value=nutation_deg,
            low=max(0.0, nutation_deg - NUTATION_DEG),
            high=min(90.0, nutation_deg + NUTATION_DEG),
        ),
        "inertia": tuple(Free(value=moment, low=moment - room, high=moment + room) for moment in (x, y)),
        "epoch": epoch,
    }
    return Trial(
        scene.model_copy(update={"attitude": Attitude(**table)}),
        values,
        state.exponents,
        state.weights,
        tuple(turns for turns, _ in state.counts),
        ways=tuple(ways for _, ways in state.counts),
        possible=state.possible,
        complete=state.complete,
    )


def _free_pole(longitude: float, latitude: float) -> tuple[Free, Free]:
    return (
        Free(value=longitude, low=longitude - 180, high=longitude + 180),
        Free(value=latitude, prior="isotropic"),
    )


def _angles(scene: Scene, pole: Tensor) -> tuple[float, float]:
    """Longitude and latitude, deg, of a unit vector (3,), GCRS, in the scene's frame."""
    if scene.orbit.vectors == "ecliptic":
        pole = torch.from_numpy(icrs_from_ecliptic()).T @ pole
    longitude = math.degrees(math.atan2(float(pole[1]), float(pole[0]))) % 360
    return longitude, math.degrees(math.asin(max(-1.0, min(1.0, float(pole[2])))))
