"""Magnitudes of passes with their uncertainty: one model for all rows, at draws of its free numbers.

Letters: D draws, P parameters, T rows, Q quantiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from scipy.special import ndtri
from torch import Tensor

from torchlc.effects import effect_class, object_kind
from torchlc.geometry.orbit.earth import julian_dates
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.kind import NoiseKind
from torchlc.prediction.passes import Pass, Span
from torchlc.readers import Recording
from torchlc.readers.groups import compact, local_nights
from torchlc.scene import Free, Orbit, Scene
from torchlc.stages.effect import Effect

LEVELS = (0.025, 0.16, 0.5, 0.84, 0.975)
"""Ends of the 95 % interval and of the 68 % interval, and the median."""
ROWS_AT_ONCE = 20_000
"""Rows of passes that one model has."""
MOST_MOVED = 400_000
"""Draws times rows where every draw has its own geometry: 30 s to 2 min on one core."""
LEAST_DRAWS = 16
"""From which quantiles are told, however many rows there are."""


@dataclass(frozen=True)
class Posterior:
    """Draws (N, P) of a fit's parameters, by full name."""

    names: tuple[str, ...]
    draws: np.ndarray


def recording_of(
    span: Span, passes: Sequence[Pass], rows: Sequence[np.ndarray]
) -> tuple[Recording, np.ndarray]:
    """The ``rows`` of each pass as a recording with vectors, in order of time, a curve a pass; and the order (T,) that
    its rows have among those of the passes one after the other."""
    index = np.concatenate([one.index[some] for one, some in zip(passes, rows, strict=True)])
    order = np.argsort(index, kind="stable")
    station = np.concatenate(
        [np.full(len(some), one.station) for one, some in zip(passes, rows, strict=True)]
    )
    curve = np.concatenate([np.full(len(some), k) for k, some in enumerate(rows)])
    position, velocity = (
        np.concatenate([getattr(one, name)[some] for one, some in zip(passes, rows, strict=True)])[order]
        for name in ("position", "velocity")
    )
    index, station = index[order], station[order]
    time: Any = span.time[index]
    observer = span.into_gcrs(span.place[station], index) - position
    ids = tuple(one.id for one in span.stations)
    longitudes = np.array([one.longitude for one in span.stations])
    night, night_ids = local_nights(np.add(*julian_dates(time, "utc")), longitudes, station, ids)
    curve, curve_ids = compact(curve[order], [f"pass {k + 1}" for k in range(len(passes))])
    return Recording(
        time=time,
        seconds=span.seconds[index] - span.seconds[index[0]],
        first_time=cast(Any, span.time)[0],
        kind="mag",
        observed=np.full(len(index), np.nan),
        error=np.ones(len(index)),  # nothing is measured; jitter asks for errors to be added to
        station=station,
        station_ids=ids,
        curve=curve,
        curve_ids=curve_ids,
        night=night,
        night_ids=night_ids,
        upper_limit=np.zeros(len(index), dtype=bool),
        sun=span.sun[index] - position,
        obs=observer,
        position=position,
        velocity=velocity,
        frame="icrs",
    ), order


def predicting_scene(scene: Scene) -> tuple[Scene, list[str]]:
    """The scene with its places in the recording, and without what belongs to the recording that it was fitted to: effects
    of the clock, of the detector and of noise, offsets along old elements, and turns that count time from its rows.
    Jitter stays: it is what the model is off by. With it the warning that effects were left out.
    """
    listed = scene.model.effects
    zero_point = scene.model.parameters.get("zero_point")
    if isinstance(zero_point, Free) and zero_point.per == "object":  # that of the population
        parameters = {**scene.model.parameters, "zero_point": zero_point.model_copy(update={"per": None})}
        scene = scene.model_copy(update={"model": scene.model.model_copy(update={"parameters": parameters})})
    plain = scene.model_copy(update={"orbit": Orbit(vectors="icrs")})
    if listed is None:
        return plain, []
    kept = [entry for entry in listed if not _of_the_recording(effect_class(entry))]
    # rows of a prediction are instants: exposures have nothing to smear, and nothing is lost
    lost = [
        entry
        for entry in listed
        if entry not in kept
        and not (cls := effect_class(entry)).spans_exposure
        and cls is not object_kind()  # which the scatter of the draws holds
    ]
    said = f"left out of the prediction, for it belongs to a recording: {', '.join(lost)}"
    model = scene.model.model_copy(update={"effects": kept})
    return plain.model_copy(update={"model": model}), [said] if lost else []


def _of_the_recording(effect: type[Effect]) -> bool:
    if issubclass(effect, NoiseKind):
        return not effect.mends_errors  # a model that needs more noise than is quoted is off by as much
    if effect.stage in ("clock", "detector"):
        return True
    moves = effect.stage == "orbit" and bool(effect.quantities)
    return moves or effect.timed_by_rows


def drawn(model: LightCurve, posterior: Posterior | None, count: int, seed: int) -> tuple[Tensor, list[str]]:
    """Draws (D, P) of the model's parameters: from the posterior those that it has, from their priors the others; (1, 0)
    where nothing is free. And the warning that names the others."""
    names = model.names
    if not names:
        return torch.zeros(1, 0, dtype=torch.float64), []
    theta = model.parameter_set.sample_prior(count, torch.Generator().manual_seed(seed))
    if posterior is None:
        return theta, []
    chosen = _chosen(posterior, count, seed)
    lacking = []
    for column, name in enumerate(names):
        if name in posterior.names:
            values = posterior.draws[chosen, posterior.names.index(name)]
            theta[:, column] = torch.from_numpy(values.copy())
        else:
            lacking.append(name)
    said = f"not in the posterior, and drawn from the prior: {', '.join(lacking)}"
    return theta, [said] if lacking else []


def between_objects(posterior: Posterior | None, count: int, seed: int) -> np.ndarray | None:
    """Standard deviation between objects that a fit has learnt, mag, of each draw (D,) of :func:`drawn`; None without."""
    learnt = f"{object_kind().name}.mag"
    if posterior is None or learnt not in posterior.names:
        return None
    return np.abs(posterior.draws[_chosen(posterior, count, seed)][:, posterior.names.index(learnt)])


def _chosen(posterior: Posterior, count: int, seed: int) -> np.ndarray:
    """Which draws of a posterior are taken."""
    enough = len(posterior.draws) >= count
    return np.random.default_rng(seed).choice(len(posterior.draws), count, replace=not enough)


def affordable(model: LightCurve, draws: int, rows: int) -> int:
    """Draws that are worked out: fewer where each has a geometry of its own and rows are many."""
    if not model.geometry_free:
        return draws
    return max(min(draws, MOST_MOVED // max(rows, 1)), min(draws, LEAST_DRAWS))


def magnitudes(
    model: LightCurve, theta: Tensor, scatter_mag: float, seed: int, learnt: np.ndarray | None = None
) -> np.ndarray:
    """Magnitudes (D, T) at draws theta (D, P), each as of one object that differs from the model's by a normal offset of
    standard deviation ``scatter_mag`` and ``learnt`` (D,), and by what jitter the model has. Infinite without light.

    The offset of a draw is the same at all rows; offsets are evenly spread quantiles in random order, so that quantiles
    over few draws are those of the normal. One draw of theta (nothing free) stands for as many as there are offsets.
    """
    with torch.no_grad():
        mag = model.magnitude(model.brightness(theta), theta).expand(len(theta), -1).numpy()
        added = model.noise(theta).variance
    sigma = np.hypot(scatter_mag, 0.0 if learnt is None else learnt[:, None]).reshape(-1, 1)
    if added is not None:
        sigma = np.sqrt(sigma**2 + added.expand(len(theta), -1).numpy())
    if not sigma.any():
        return mag
    if len(mag) == 1:
        mag = np.repeat(mag, SCATTERED, axis=0)
    return mag + sigma * offsets(len(mag), seed)[:, None]


SCATTERED = 256
"""Offsets between objects where nothing else is uncertain."""


def offsets(count: int, seed: int) -> np.ndarray:
    """Evenly spread quantiles (count,) of the standard normal, in random order."""
    even = ndtri((np.arange(count) + 0.5) / count)
    return np.random.default_rng(seed).permutation(even)


def quantiles(values: np.ndarray) -> np.ndarray:
    """Quantiles (Q, ...) of draws (D, ...) at LEVELS. Draws without light, infinite, count as faintest: they stay apart from
    the others, and a quantile between is the nearest draw's."""
    ordered = np.sort(values, axis=0)
    place = np.asarray(LEVELS) * len(values) - 0.5
    low = np.clip(np.floor(place).astype(int), 0, len(values) - 1)
    high = np.clip(low + 1, 0, len(values) - 1)
    share = np.clip(place - low, 0.0, 1.0).reshape(-1, *(1,) * (values.ndim - 1))
    below, above = ordered[low], ordered[high]
    both = np.isfinite(below) & np.isfinite(above)
    with np.errstate(invalid="ignore"):
        return np.where(both, below + share * (above - below), np.where(share < 0.5, below, above))


def batches(passes: Sequence[Pass], rows: Sequence[np.ndarray]) -> list[list[int]]:
    """Numbers of passes that are worked out together, at most ROWS_AT_ONCE rows, those without any left out."""
    found: list[list[int]] = [[]]
    held = 0
    for k, some in enumerate(rows):
        if held + len(some) > ROWS_AT_ONCE and found[-1]:
            found.append([])
            held = 0
        if len(some):
            found[-1].append(k)
            held += len(some)
    return [one for one in found if one]
