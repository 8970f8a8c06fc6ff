"""What a search of rotations is asked: a scene, its rows in passes, the body that they show, and the range of its turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.inference.likelihood import MAG_PER_LN
from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.model_fit import Candidate
from torchlc.inference.rotation.modes import fits_the_rows
from torchlc.inference.rotation.passes import Rows, rows_of
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Free, Scene

MIN_ROWS = 12
"""A rotation with reflectances and lobes has eight numbers and more."""
MOST_CHANGE = 0.1
"""Relative change of a period between passes up to which the scene's bounds, which are of its epoch, are widened: rocket bodies
change by 5 % in six years."""


@dataclass(frozen=True)
class Problem:
    """``low`` and ``high`` bound the frequency of turns, 1/s; ``told`` is what has to be said of all this."""

    scene: Scene
    recording: Recording
    rows: Rows
    body: FacetLight
    low: float
    high: float
    told: list[str]

    @classmethod
    def posed(
        cls, scene: Scene, recording: Recording, shortest_s: float | None, longest_s: float | None
    ) -> Problem:
        """The problem; InputError where the scene, the rows or the range allow no search."""
        _check_attitude(scene)
        model = LightCurve(scene, recording)
        rows = rows_of(model)
        _check_rows(rows, recording)
        body = FacetLight.of(model.assembly)
        low, high, notes = _range(scene, recording, rows, shortest_s, longest_s)
        return cls(scene, recording, rows, body, low, high, [*notes, *body.notes])

    @property
    def wide(self) -> tuple[float, float]:
        """Bounds of the frequency that rounding does not push a solution over."""
        return self.low * (1 - 1e-9), self.high * (1 + 1e-9)

    @property
    def longest_pass_s(self) -> float:
        return float(self.rows.span.max())

    @property
    def noise_mag(self) -> float | None:
        """Noise of successive rows, where the recording has no errors."""
        return None if self.rows.noise is None else MAG_PER_LN * self.rows.noise

    def fits(self, one: Candidate) -> bool:
        """Whether a fit of the model leaves no more than the errors allow."""
        return fits_the_rows(one.chi2, one.rms, len(self.rows.flux) - len(one.theta), self.noise_mag)


def _check_attitude(scene: Scene) -> None:
    """InputError where the scene's attitude is none that a search can begin at."""
    if scene.attitude.mode not in ("spin-pole", "rigid-body"):
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}"',
            '"spin-pole" (pole, period, phase, epoch), whose numbers are where the search starts',
        )


def _check_rows(rows: Rows, recording: Recording) -> None:
    """InputError where they are too few, or a pass is of one row."""
    if len(rows.flux) < MIN_ROWS:
        raise InputError(
            recording.source,
            None,
            number_of(len(rows.flux), "measured row"),
            f"at least {MIN_ROWS} to find a rotation",
        )
    if not float(rows.span.max()) > 0:
        raise InputError(recording.source, "column time", "passes of one row each", "a stretch of time")


def _range(
    scene: Scene, recording: Recording, rows: Rows, shortest: float | None, longest: float | None
) -> tuple[float, float, list[str]]:
    """Lowest and highest frequency of turns, 1/s."""
    for name, value in (("shortest", shortest), ("longest", longest)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(None, option(name), f"{value:g} s", "a number > 0")
    period = scene.attitude.period
    bounds = (period.low, period.high) if isinstance(period, Free) else (None, None)
    cadence = float(np.median(np.diff(np.unique(rows.seconds.numpy()))))
    warnings = []
    first = shortest or (3600 * bounds[0] if bounds[0] else 2 * cadence)
    last = longest or (3600 * bounds[1] if bounds[1] else float(rows.span.max()))
    change = min(MOST_CHANGE, pole_grid.DRIFT_SD * float(rows.drift.max()))
    if bounds[0] and shortest is None:
        first /= 1 + change
    if bounds[1] and longest is None:
        last *= 1 + change
    if not isinstance(period, Free) and shortest is None and longest is None:
        warnings.append(
            f"the scene's period is fixed: all from {first:.4g} to {last:.4g} s were looked at, not only that"
        )
    if not first < last:
        raise InputError(
            recording.source,
            f"{option('shortest')}, {option('longest')}",
            f"periods from {first:.4g} to {last:.4g} s",
            "a range of periods",
        )
    return 1 / last, 1 / first, warnings
