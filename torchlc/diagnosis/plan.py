"""What to observe next: the night, station and cadence that would tell most of which set of effects is right.

What a night tells is the information that its rows are expected to give on the sets that are possible now, in nats: the entropy of their
probabilities less what is left of it, on average over recordings drawn from what each predicts (Lindley 1956, Ann. Math. Stat. 27,
986). Predictions are linear in the coordinates about each fit, whose covariance says how far they are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from astropy.time import Time, TimeDelta
from torch import Tensor

from torchlc.errors import TorchlcError
from torchlc.geometry.orbit import above_horizon, make_track
from torchlc.geometry.orbit.grid import observation_grid
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.normal_scores import FARTHEST
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.tensors.least_squares import differences

NIGHTS = (1, 3, 7, 14, 30, 60, 91, 182)
"""Days after the recording at which a repeat of its hours is tried."""
ROWS = 120
DRAWS = 400
"""Recordings of a night that are drawn: the chance that it tells is known to 0.025."""
TOLD = 0.9
"""Probability at which a set counts as told from the others."""
ENOUGH = 0.5
"""Chance of that below which a night is not worth the advice."""
LEAST_P, MOST_SETS = 0.01, 6
"""Sets that are asked about."""


@dataclass(frozen=True)
class Option:
    """A candidate night: its first instant, station, seconds between exposures, the ``information`` (nats) that it is expected
    to give, and the chance that after it one set has at least TOLD."""

    start: str
    station: str
    hours: float
    cadence_s: float
    information: float
    chance: float


@dataclass(frozen=True)
class Forecast:
    """A night as a set predicts it: magnitudes (T,), what of them moves with what is not known, and how much (T, P), (P, P)."""

    mean: Tensor
    slopes: Tensor
    spread: Tensor


def next_nights(sets: Sequence[tuple[Fitted, float]], seed: int = 0) -> list[Option]:
    """Candidate nights in order of the information that they are expected to give on which of some fits, with their
    probabilities, is right; empty where the orbit cannot be carried to another night."""
    first = sets[0][0]
    scene, recording = first.model.scene, first.model.recording
    if not scene.orbit.known:
        return []
    hours = float(recording.seconds[-1] - recording.seconds[0]) / 3600
    hours = min(max(hours, 0.5), 10.0)
    error = float(torch.median(first.wide / first.scale))
    exposure = None if recording.exptime is None else float(np.median(recording.exptime))
    p = torch.tensor([weight for _, weight in sets], dtype=torch.float64)
    options = []
    for station in scene.stations:
        for days in NIGHTS:
            start = recording.time[0] + TimeDelta(days, format="jd")
            grid = _grid(scene, start, hours, station.id, error, exposure)
            if grid is None:
                continue
            try:
                forecasts = [_forecast(fitted, grid) for fitted, _ in sets]
            except TorchlcError:
                continue
            gain = told_by(forecasts, p / p.sum(), torch.as_tensor(grid.error), seed)
            if gain is not None:
                options.append(Option(str(start.isot)[:16], station.id, hours, hours * 3600 / ROWS, *gain))
    return sorted(options, key=lambda option: -option.information)


def told_by(forecasts: Sequence[Forecast], p: Tensor, sigma: Tensor, seed: int) -> tuple[float, float] | None:
    """Information (nats) that rows with errors sigma (T,) are expected to give on which of K forecasts is right, of
    probabilities p (K,), and the chance that one then has TOLD; None where fewer than 10 rows are seen under all."""
    usable = torch.stack([torch.isfinite(forecast.mean) for forecast in forecasts]).all(0)
    if int(usable.sum()) < 10:
        return None
    means = torch.stack([forecast.mean[usable] for forecast in forecasts])
    factors = torch.stack(
        [
            torch.linalg.cholesky(
                torch.diag(sigma[usable] ** 2)
                + forecast.slopes[usable] @ forecast.spread @ forecast.slopes[usable].T
            )
            for forecast in forecasts
        ]
    )
    generator = torch.Generator().manual_seed(seed)
    truth = torch.multinomial(p, DRAWS, replacement=True, generator=generator)
    z = torch.randn(DRAWS, means.shape[1], generator=generator, dtype=means.dtype)
    rows = means[truth] + (factors[truth] @ z[..., None])[..., 0]
    off = (rows[:, None] - means)[..., None]
    u = torch.linalg.solve_triangular(factors.expand(DRAWS, -1, -1, -1), off, upper=False)[..., 0]
    log_density = -0.5 * u.square().sum(-1) - torch.log(torch.diagonal(factors, dim1=-2, dim2=-1)).sum(-1)
    after = torch.softmax(log_density + torch.log(p), -1)
    entropy = -torch.special.xlogy(p, p).sum()
    left = -torch.special.xlogy(after, after).sum(-1).mean()
    return max(float(entropy - left), 0.0), float((after.amax(-1) >= TOLD).to(p).mean())


def _grid(
    scene: Scene, start: Time, hours: float, station: str, error: float, exposure: float | None
) -> Recording | None:
    """Rows of one night above the horizon, errors and exposures (s) like the recording's; None if there are too
    few."""
    try:
        grid = observation_grid(scene, str(start.isot), hours, hours * 3600 / ROWS, station)
        grid = grid.keep(above_horizon(make_track(scene, grid)), "below the horizon")
    except TorchlcError:
        return None
    if len(grid.seconds) < 10:
        return None
    rows = len(grid.seconds)
    exptime = None if exposure is None else np.full(rows, exposure)
    return replace(grid, observed=np.zeros(rows), error=np.full(rows, error), exptime=exptime, kind="mag")


def _forecast(fitted: Fitted, grid: Recording) -> Forecast:
    """Another night at a fit's coordinates, under its law of reflection."""
    scene = fitted.model.scene
    entries = [effect.entry for effect in fitted.model.effects]
    model = LightCurve(scene, grid, assembly=assemble(scene, grid, entries))
    if model.parameter_set.names != fitted.names:
        raise TorchlcError("the night has other parameters than the recording")
    night = Posterior(Likelihood(model), scaled=fitted.posterior.scaled)
    far = torch.full_like(fitted.g, FARTHEST + 1)
    with torch.no_grad():
        magnitude = model(fitted.theta)
        slopes = differences(lambda g: model(night.theta(g)), fitted.g[None], -far, far)[0]
    return Forecast(magnitude, slopes, fitted.covariance)


def sentence(options: Sequence[Option], sets: Sequence[str], fixed_orbit: bool) -> str:
    """One sentence for the analyst on sets of effects, the likeliest first."""
    tied = f"{_listed(sets)} {'do' if len(sets) > 1 else 'does'} as well here"
    if not fixed_orbit:
        return (
            f"{tied}, and without orbital elements no other night can be computed: "
            "repeat the object at another phase angle and compare their predictions."
        )
    if not options:
        return f"{tied}, and for no night within half a year could all be computed above the horizon."
    best = options[0]
    if best.chance < ENOUGH:
        return (
            f"{tied}, and no single night of the next half year is likely to separate them: the best, "
            f"{best.start} UTC from {best.station}, has a chance of {100 * best.chance:.0f} %."
        )
    return (
        f"To tell {_listed(sets)} apart, observe from {best.station} on {best.start} UTC for "
        f"{best.hours:.1f} h at one exposure every {best.cadence_s:.0f} s: one of them is then expected to have "
        f"{100 * TOLD:.0f} % with a chance of {100 * best.chance:.0f} %."
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
