"""What to observe next: the night, station and cadence that would separate the members of a tied family
best."""

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
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.normal_scores import FARTHEST
from torchlc.inference.posterior import Fitted, Posterior
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.tensors.least_squares import differences

NIGHTS = (1, 3, 7, 14, 30, 60, 91, 182)
"""Days after the recording at which a repeat of its hours is tried."""
ROWS = 120
ENOUGH = 10.0


@dataclass(frozen=True)
class Option:
    """A candidate night: its first instant, station, seconds between exposures, and the log-likelihood margin
    it is expected to give."""

    start: str
    station: str
    hours: float
    cadence_s: float
    margin: float


def next_nights(first: Fitted, second: Fitted) -> list[Option]:
    """Candidate nights in order of the expected margin between two refits; empty where the orbit cannot be
    carried to another night."""
    model = first.model
    scene, recording = model.scene, model.recording
    if not scene.orbit.known:
        return []
    hours = float(recording.seconds[-1] - recording.seconds[0]) / 3600
    hours = min(max(hours, 0.5), 10.0)
    error = float(torch.median(first.wide / first.scale))
    exposure = None if recording.exptime is None else float(np.median(recording.exptime))
    options = []
    for station in scene.stations:
        for days in NIGHTS:
            start = recording.time[0] + TimeDelta(days, format="jd")
            grid = _grid(scene, start, hours, station.id, error, exposure)
            if grid is None:
                continue
            margin = _margin(first, second, scene, grid)
            if margin is not None:
                options.append(Option(str(start.isot)[:16], station.id, hours, hours * 3600 / ROWS, margin))
    return sorted(options, key=lambda one: -one.margin)


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


def _margin(first: Fitted, second: Fitted, scene: Scene, grid: Recording) -> float | None:
    """Half the squared distance between the two predictions, less what the uncertainty of either's parameters
    could absorb."""
    try:
        a, slopes_a = _prediction(first, scene, grid)
        b, slopes_b = _prediction(second, scene, grid)
    except TorchlcError:
        return None
    usable = torch.isfinite(a) & torch.isfinite(b)
    if int(usable.sum()) < 10:
        return None
    sigma = torch.as_tensor(grid.error)[usable]
    difference = (a - b)[usable] / sigma
    slopes = [slope[usable] / sigma[:, None] for slope in (slopes_a, slopes_b)]
    spread = torch.eye(len(difference), dtype=difference.dtype)
    for slope, fitted in zip(slopes, (first, second), strict=True):
        spread = spread + slope @ fitted.covariance @ slope.T
    return 0.5 * float(difference @ torch.linalg.solve(spread, difference))


def _prediction(fitted: Fitted, scene: Scene, grid: Recording) -> tuple[Tensor, Tensor]:
    """Magnitudes (T,) and their slopes (T, P) at a fit's coordinates on another night."""
    entries = [one.entry for one in fitted.model.effects]
    model = LightCurve(scene, grid, assembly=assemble(scene, grid, entries))
    if model.parameter_set.names != fitted.names:
        raise TorchlcError("the night has other parameters than the recording")
    night = Posterior(Likelihood(model), scaled=fitted.posterior.scaled)
    far = torch.full_like(fitted.g, FARTHEST + 1)
    with torch.no_grad():
        magnitude = model(fitted.theta)
        slopes = differences(lambda g: model(night.theta(g)), fitted.g[None], -far, far)[0]
    return magnitude, slopes


def sentence(options: Sequence[Option], first: str, second: str, fixed_orbit: bool) -> str:
    """One sentence for the analyst."""
    tied = f"{first} and {second} do as well here"
    if not fixed_orbit:
        return (
            f"{tied}, and without orbital elements no other night can be computed: "
            "repeat the object at another phase angle and compare their predictions."
        )
    if not options:
        return f"{tied}, and for no night within half a year could both be computed above the horizon."
    best = options[0]
    if best.margin < ENOUGH:
        return (
            f"{tied}, and no single night of the next half year would separate them: the best, "
            f"{best.start} UTC from {best.station}, is expected to give {best.margin:.1f} in log-likelihood."
        )
    return (
        f"To tell {first} from {second}, observe from {best.station} on {best.start} UTC for "
        f"{best.hours:.1f} h at one exposure every {best.cadence_s:.0f} s: the expected margin in "
        f"log-likelihood is {best.margin:.0f}."
    )
