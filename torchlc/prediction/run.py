"""From a scene, orbits and stations to a prediction: passes found, magnitudes drawn, glints looked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from astropy.time import Time

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.geometry.orbit.earth import after, in_scale, julian_dates
from torchlc.geometry.orbit.elements import FRESH_DAYS, ElementSet
from torchlc.geometry.orbit.ephemeris import Ephemeris
from torchlc.lightcurve.model import LightCurve
from torchlc.prediction import brightness
from torchlc.prediction.brightness import Posterior
from torchlc.prediction.glints import Glint, facet_angles, find_glints, lit_runs, lobe_widths_deg
from torchlc.prediction.passes import Orbiter, Pass, Span, along_track_sd_s, find_passes, make_span
from torchlc.prediction.result import PredictedPass, Prediction
from torchlc.readers.table import MAX_ROWS
from torchlc.scene import Scene, Station, value_of
from torchlc.scene.timestamps import UnreadableTime, instant
from torchlc.scene.tle import Elements, nearest, passed_over, read_catalogue, sound_sets

Progress = Callable[[str, float], None]
LONGEST_HOURS = 24.0 * 31
"""A month: elements are not good for longer."""
MOST_ELEMENTS_TOLD = 5
FAST_DEG = 5.0
"""Turn between rows beyond which lobes of the usual widths fall between them."""
UNSEARCHED = "glints of a mesh of many facets are not looked for; they are in the magnitudes"


@dataclass(frozen=True)
class Wanted:
    """What is asked of a prediction: see :func:`torchlc.predict`."""

    elevation_deg: float = 10.0
    sun_deg: float = -6.0
    extinction: float = 0.0
    scatter_mag: float = 0.0
    faintest_mag: float | None = None
    draws: int = 256
    seed: int = 0


LIMITS = {
    "elevation_deg": ("elevation", 0.0, 89.0, "deg"),
    "sun_deg": ("sun", -90.0, 90.0, "deg"),
    "extinction": ("extinction", 0.0, 5.0, "mag an airmass"),
    "scatter_mag": ("scatter", 0.0, 10.0, "mag"),
    "draws": ("draws", 2, 100_000, ""),
}
"""Name of the option and argument, least and largest value, and unit."""


def check(wanted: Wanted) -> None:
    """Raise InputError at the first number that is out of its range."""
    for name, (argument, low, high, unit) in LIMITS.items():
        value = getattr(wanted, name)
        if not low <= value <= high:
            found, expected = f"{value:g} {unit}".strip(), f"{low:g} to {high:g} {unit}".strip()
            raise InputError(None, option(argument), found, expected)
    faintest = wanted.faintest_mag
    if faintest is not None and not math.isfinite(faintest):
        raise InputError(None, option("faintest"), f"{faintest}", "a magnitude")


def span_of(
    stations: Sequence[Station],
    date: str | None,
    start: str | float | None,
    hours: float | None,
    cadence_s: float,
) -> Span:
    """The grid of times of a night, ``date`` being that of its evening at the first station, or of ``hours`` from ``start``."""
    if (date is None) == (start is None):
        found = "both a night and a start" if date is not None else "neither a night nor a start"
        expected = f"{option('date')} YYYY-MM-DD, or {option('start')} with {option('hours')}"
        raise InputError(None, f"{option('date')}, {option('start')}", found, expected)
    if date is not None:
        if hours is not None:
            found, expected = f"given with {option('date')}", f"it with {option('start')}; a night has 24 h"
            raise InputError(None, option("hours"), found, expected)
        noon = _instant("date", f"{date}T12:00:00")
        first = in_scale(after(noon, np.asarray(-240.0 * _east(stations[0].longitude))), "utc")
        hours = 24.0
    else:
        assert start is not None
        first = _instant("start", start)
    if hours is None:
        raise InputError(None, option("hours"), "missing", f"the length of the span, with {option('start')}")
    if not (math.isfinite(hours) and 0 < hours <= LONGEST_HOURS):
        raise InputError(
            None, option("hours"), f"{hours:g} h", f"more than 0 and at most {LONGEST_HOURS:g} h"
        )
    if not (math.isfinite(cadence_s) and 0.1 <= cadence_s <= 600):
        raise InputError(None, option("cadence"), f"{cadence_s:g} s", "0.1 to 600 s")
    count = hours * 3600 / cadence_s * len(stations)
    if count > MAX_ROWS:
        raise InputError(None, option("cadence"), f"{count:,.0f} instants", f"at most {MAX_ROWS:,}")
    return make_span(first, hours, cadence_s, stations)


def _east(longitude: float) -> float:
    """East longitude, deg, from -180 to 180."""
    return (longitude + 180.0) % 360.0 - 180.0


def _instant(argument: str, value: str | float) -> Time:
    try:
        return instant(value, "utc")
    except UnreadableTime as error:
        expected = "a night as YYYY-MM-DD" if argument == "date" else error.expected
        found = value.removesuffix("T12:00:00") if isinstance(value, str) else error.found
        raise InputError(None, option(argument), repr(found), expected) from None


def orbiter_of(scene: Scene, span: Span) -> Orbiter:
    """The object of a scene with its orbit."""
    orbit = scene.orbit
    if not orbit.known:
        raise InputError(
            scene.source,
            "orbit",
            "no TLE and no ephemeris",
            "tle, tle_file or oem_file",
            f"Or give {option('elements')} FILE.",
        )
    with scene.reading():
        if orbit.oem_file is not None:
            ephemeris = Ephemeris(scene.file_path(orbit.oem_file), span.time)
            return Orbiter(scene.name, None, ephemeris, celestial=True)
        if orbit.tle is not None:
            return _with_elements(scene.name, Elements(None, orbit.tle), scene.source, span)
        path = scene.file_path(str(orbit.tle_file))
        sets = read_catalogue(path)
    return _with_elements(scene.name, _nearest(sets, span), path, span)


def orbiters_of(path: str | Path, span: Span) -> tuple[list[Orbiter], list[str]]:
    """Every object of a file of elements, each with the set nearest to the middle of the span; and how many sets that
    leaves out, or are not right."""
    sets: dict[str, list[Elements]] = {}
    right, wrong = sound_sets(path)
    for one in right:
        sets.setdefault(one.number, []).append(one)
    found = []
    for number, several in sets.items():
        chosen = _nearest(several, span)
        name = (
            chosen.name or next((one.name for one in several if one.name), None) or f"object {number.strip()}"
        )
        found.append(_with_elements(name, chosen, path, span))
    spare = sum(map(len, sets.values())) - len(sets)
    said = f"{Path(path).name}: {spare} element sets are left out; of each object the nearest to the span is taken"
    return found, [*passed_over(wrong), *([said] if spare else [])]


def _nearest(sets: list[Elements], span: Span) -> Elements:
    return sets[int(nearest(sets, np.array([_middle(span)]))[0])]


def _middle(span: Span) -> float:
    middle = cast(Time, span.time[[len(span.seconds) // 2]])
    return float(np.add(*julian_dates(middle, "utc"))[0])


def _with_elements(name: str, elements: Elements, source: str | Path | None, span: Span) -> Orbiter:
    places = ElementSet(elements.lines, source)
    age = places.age_days(cast(Time, span.time[[0, len(span.seconds) - 1]]))
    return Orbiter(name, elements.number.strip(), places, age_days=age)


def run(
    scene: Scene,
    orbiters: Sequence[Orbiter],
    span: Span,
    wanted: Wanted,
    posterior: Posterior | None = None,
    progress: Progress | None = None,
) -> Prediction:
    """Passes of the orbiters, each of which is taken for an object of the scene's shape and materials."""
    passes, said = _all_passes(orbiters, span, wanted, progress)
    if not passes:
        said.append(_why_none(span, wanted))
    plain, notes = brightness.predicting_scene(scene)
    said += notes
    if plain.attitude.spins_from_first_row:
        plain = plain.with_spin_epoch(str(cast(Any, span.time[0]).isot))
        said.append("the spin has no epoch: its phase is taken to be that of the start of the prediction")
    said += _fast_turns(scene, span)
    lit = [np.flatnonzero(path.lit) for path in passes]
    groups = brightness.batches(passes, lit)
    finished: dict[int, PredictedPass] = {}
    draws, free = 1, False
    for number, group in enumerate(groups):
        those, rows = [passes[k] for k in group], [lit[k] for k in group]
        model, theta, notes = _model(plain, span, those, rows, wanted, posterior, sum(map(len, lit)))
        said += [text for text in notes if text not in said]
        draws, free = max(draws, len(theta)), bool(model.names)
        learnt = brightness.between_objects(posterior, len(theta), wanted.seed)
        lighted, passed_over = _lighted(model, theta, span, orbiters, passes, lit, group, wanted, learnt)
        finished |= dict(zip(group, lighted, strict=True))
        if passed_over and UNSEARCHED not in said:
            said.append(UNSEARCHED)
        if progress is not None:
            progress("magnitudes", (number + 1) / len(groups))
    whole = [finished.get(k) or _dark(path) for k, path in enumerate(passes)]
    bright, dropped = _bright(whole, wanted)
    if dropped:
        said.append(
            f"{number_of(dropped, 'pass')} left out: fainter than {wanted.faintest_mag:g} mag, or dark"
        )
    order = sorted(bright, key=lambda one: (float(one.brightest[2]), one.path.begin))
    said += _ages(orbiters)
    kind = "none" if not free else "posterior" if posterior is not None else "priors"
    return Prediction(
        name=scene.name,
        span=span,
        orbiters=orbiters,
        passes=order,
        uncertainty=kind,
        draws=draws,
        scatter_mag=wanted.scatter_mag,
        extinction=wanted.extinction,
        elevation_deg=wanted.elevation_deg,
        sun_deg=wanted.sun_deg,
        faintest_mag=wanted.faintest_mag,
        warnings=list(dict.fromkeys([*said, *scene.warnings, *span.frame.warnings])),
        seed=wanted.seed,
    )


def _why_none(span: Span, wanted: Wanted) -> str:
    """Why there is no pass at all."""
    if not _is_dark(span, wanted):
        return f"the Sun is never below {wanted.sun_deg:g} deg"
    return f"no object is above {wanted.elevation_deg:g} deg while the Sun is below {wanted.sun_deg:g} deg"


def _fast_turns(scene: Scene, span: Span) -> list[str]:
    """A sentence where the body turns so far between rows that they are no curve."""
    attitude = scene.attitude
    turns_an_hour = 0.0 if attitude.spin_axis is None else abs(value_of(attitude.spin_rate))
    if attitude.period is not None:
        turns_an_hour = 1.0 / value_of(attitude.period)
    degrees = 360.0 * turns_an_hour * span.cadence_s / 3600.0
    if degrees <= FAST_DEG:
        return []
    return [
        f"the body turns {degrees:.3g} deg between rows: magnitudes are samples of its rotation, and glints between rows "
        f"are not seen; a smaller {option('cadence')} follows it"
    ]


def _is_dark(span: Span, wanted: Wanted) -> bool:
    return bool((span.sun_elevation < wanted.sun_deg).any())


def _all_passes(
    orbiters: Sequence[Orbiter], span: Span, wanted: Wanted, progress: Progress | None
) -> tuple[list[Pass], list[str]]:
    """Passes of all objects, and which objects have no orbit in the span; of a single object that is an error."""
    found: list[Pass] = []
    lost: list[str] = []
    for number, orbiter in enumerate(orbiters):
        try:
            found += find_passes(
                span, orbiter, number, elevation_deg=wanted.elevation_deg, sun_deg=wanted.sun_deg
            )
        except InputError:
            if len(orbiters) == 1:
                raise
            lost.append(orbiter.name)
        if progress is not None and number % 20 == 19:
            progress("passes", (number + 1) / len(orbiters))
    more = f" and {len(lost) - MOST_ELEMENTS_TOLD} more" if len(lost) > MOST_ELEMENTS_TOLD else ""
    said = f"without an orbit in this span (decayed?), and left out: {', '.join(lost[:MOST_ELEMENTS_TOLD])}{more}"
    return found, [said] if lost else []


def _model(
    scene: Scene,
    span: Span,
    passes: Sequence[Pass],
    rows: Sequence[np.ndarray],
    wanted: Wanted,
    posterior: Posterior | None,
    rows_in_all: int,
) -> tuple[LightCurve, torch.Tensor, list[str]]:
    """The model of some passes, and draws of its numbers; with what was left out or cut short."""
    recording, _ = brightness.recording_of(span, passes, rows)
    model, said = LightCurve(scene, recording), []
    count = brightness.affordable(model, wanted.draws, rows_in_all)
    if count < wanted.draws and model.names:
        said.append(f"every draw has its own geometry: {count} draws are worked out, not {wanted.draws}")
    theta, lacking = brightness.drawn(model, posterior, count, wanted.seed)
    return model, theta, [*said, *lacking, *model.assembly.warnings]


def _lighted(
    model: LightCurve,
    theta: torch.Tensor,
    span: Span,
    orbiters: Sequence[Orbiter],
    passes: Sequence[Pass],
    lit: Sequence[np.ndarray],
    group: Sequence[int],
    wanted: Wanted,
    learnt: np.ndarray | None,
) -> tuple[list[PredictedPass], bool]:
    """The passes of one batch with their magnitudes and glints; and whether a mesh was not searched for glints."""
    own, rows = [passes[k] for k in group], [lit[k] for k in group]
    _, order = brightness.recording_of(span, own, rows)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    drawn = brightness.magnitudes(model, theta, wanted.scatter_mag, wanted.seed, learnt)[:, back]
    names, angles, passed_over = facet_angles(model, theta)
    angles = angles[..., back]
    widths = {material: lobe_widths_deg(model, theta, material) for _, _, material in names}
    found, start = [], 0
    for path, some in zip(own, rows, strict=True):
        piece = slice(start, start + len(some))
        start += len(some)
        mag = np.full((len(brightness.LEVELS), len(path.index)), np.inf)
        mag[:, some] = brightness.quantiles(drawn[:, piece])
        seconds = span.seconds[path.index[some]]
        glints: list[Glint] = find_glints(
            names,
            angles[..., piece],
            widths,
            seconds,
            lit_runs(path, seconds),
            along_track_sd_s(orbiters[path.orbiter]),
        )
        found.append(_predicted(path, mag, brightness.quantiles(drawn[:, piece].min(axis=1)), glints))
    return found, passed_over


def _predicted(path: Pass, mag: np.ndarray, brightest: np.ndarray, glints: Sequence[Glint]) -> PredictedPass:
    seen = np.isfinite(mag[2])
    row = int(np.argmin(np.where(seen, mag[2], np.inf))) if seen.any() else None
    return PredictedPass(path, mag, brightest if row is not None else np.full(len(mag), np.inf), row, glints)


def _dark(path: Pass) -> PredictedPass:
    levels = len(brightness.LEVELS)
    return PredictedPass(path, np.full((levels, len(path.index)), np.inf), np.full(levels, np.inf), None)


def _bright(passes: list[PredictedPass], wanted: Wanted) -> tuple[list[PredictedPass], int]:
    """Passes whose median reaches the limit, and how many do not."""
    if wanted.faintest_mag is None:
        return passes, 0
    kept = [one for one in passes if one.brightest[2] <= wanted.faintest_mag]
    return kept, len(passes) - len(kept)


def _ages(orbiters: Sequence[Orbiter]) -> list[str]:
    old = [one for one in orbiters if one.age_days is not None and one.age_days > FRESH_DAYS]
    if not old:
        return []
    oldest = max(old, key=lambda one: one.age_days or 0.0)
    return [
        f"elements of {number_of(len(old), 'object')} are more than {FRESH_DAYS:.0f} days from the span: {oldest.name} may be "
        f"{along_track_sd_s(oldest):.0f} s ahead or behind; find elements of the date"
    ]
