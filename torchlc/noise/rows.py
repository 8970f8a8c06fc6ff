"""The rows of a recording as noise sees them: residuals, curves, upper limits, and what the quoted errors mean.

Letters: T rows, C curves, (...) any batch axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.noise.error_law import above_zero, error_powers
from torchlc.readers import Recording
from torchlc.tensors.normal_tail import log_ndtr


@dataclass(frozen=True)
class Residuals:
    """Datum minus model, (..., T), with the standard deviation of each row, (..., T) or (T,), in the
    recording's own unit (mag or relative flux); ``scale`` (..., T) turns a magnitude of noise into that unit;
    ``gain`` (..., number of curves) for flux; ``prediction`` (..., T) of the datum.

    Of a magnitude whose error follows the measured flux, ``delta`` is on the scale of
    :func:`torchlc.noise.error_law.power_difference`, which is datum minus prediction to first order.
    """

    delta: Tensor
    sigma: Tensor
    scale: Tensor
    gain: Tensor | None
    prediction: Tensor

    def each(self, change: Callable[[Tensor], Tensor]) -> Residuals:
        """The same after a change of what every row has: delta, sigma, scale and prediction."""
        return replace(
            self,
            delta=change(self.delta),
            sigma=change(self.sigma),
            scale=change(self.scale),
            prediction=change(self.prediction),
        )


class Rows:
    """What noise needs to know of a recording's rows, whatever the model.

    ``noise_level`` (C,) is the starting noise of curves without errors, in the recording's unit; ``seconds`` (T,) the
    stamps; tensors are of dtype and device of ``like``.
    """

    def __init__(self, recording: Recording, curve: Tensor, like: Tensor) -> None:
        recording.check_measured()
        self.source = recording.source
        self.flux = recording.kind == "flux"
        self.observed = torch.as_tensor(recording.observed).to(like)
        self.curve = curve
        self.curves = len(recording.curve_ids)
        self.limit = torch.as_tensor(recording.upper_limit, device=like.device)
        self.measured = ~self.limit
        self.censored = bool(np.any(recording.upper_limit))
        self.fainter = 1.0 if self.flux else -1.0
        """Sign of a fainter object in the recording's unit."""
        # counted on the host: how many rows are measured is a number of the recording, whatever device the tensors are on
        count = np.bincount(recording.curve[~recording.upper_limit], minlength=self.curves)
        self.count = torch.as_tensor(count).to(like)
        self.fitted_errors = recording.error is None
        self.noise_level = _successive(recording, self.curves).to(like)
        self.error = (
            self.noise_level[self.curve]
            if recording.error is None
            else torch.as_tensor(recording.error).to(like)
        )
        self.gains = int(np.count_nonzero(count)) if self.flux else 0
        self.power = self._power(recording)
        whole = self.by_curve(self.limit.to(like))[self.curve] == 0
        self.selected = None if self.power is None else whole & (self.power > 0)

    @property
    def rows(self) -> int:
        return len(self.observed)

    def _power(self, recording: Recording) -> Tensor | None:
        """Power of each row's errors, (T,); None where all are 0."""
        if recording.error is None or self.flux:
            return None
        flux = 10 ** (-0.4 * recording.observed)
        powers = error_powers(flux, recording.error, recording.curve, ~recording.upper_limit)
        return torch.as_tensor(powers).to(self.observed) if powers.any() else None

    def by_curve(self, rows: Tensor) -> Tensor:
        """Sums over the rows of each curve, (..., C), of (..., T)."""
        if self.curves == 1:
            return rows.sum(-1, keepdim=True)
        zero = rows.new_zeros(*rows.shape[:-1], self.curves)
        return zero.index_add(-1, self.curve, rows)

    def squares(self, delta: Tensor) -> Tensor:
        """Sum of squares of each curve's measured rows, (..., C), of residuals (..., T)."""
        return self.by_curve(torch.where(self.limit, 0.0, delta) ** 2 if self.censored else delta**2)

    def white_levels(self, delta: Tensor, together: Tensor) -> Tensor:
        """Noise level of each curve, (..., curves), from the steps between successive residuals delta (...,
        T) of measured rows of one number ``together`` (T,), of which a curve may have several and which errors that such
        rows share hardly change: their root mean square over sqrt 2."""
        order = torch.argsort(together, stable=True)
        order = order[self.measured[order]]
        alike = (torch.diff(together[order]) == 0).to(delta)
        step = torch.zeros_like(delta).index_copy(-1, order[1:], torch.diff(delta[..., order]) * alike)
        steps = self.by_curve(torch.zeros_like(self.observed).index_copy(-1, order[1:], alike))
        return self.level_of(self.by_curve(step**2) / (2 * steps.clamp(min=1.0)))

    def level_of(self, variance: Tensor) -> Tensor:
        """Noise level of each curve, (..., C), from the variance of its residuals: at least a thousandth of the starting one,
        so that a model through every row has a density, and slopes (the root has none at 0)."""
        return torch.sqrt(torch.maximum(variance, (1e-3 * self.noise_level) ** 2))

    def log_below(self, u: Tensor) -> Tensor:
        """ln of the probability of each upper limit, (..., T), at residuals over their standard deviation u (...,
        T), limit minus model: that normal noise is above u in magnitudes, below it in flux; 0 for measured rows."""
        fainter = self.fainter * torch.where(self.limit, u, 0.0)
        return torch.where(self.limit, log_ndtr(fainter), 0.0)

    def normalised(self, residuals: Residuals) -> Tensor:
        """Residuals over their errors, (..., T); for an upper limit the square root of its deviance."""
        return self.deviance_rows(residuals.delta / residuals.sigma)

    def deviance_rows(self, u: Tensor) -> Tensor:
        """u (..., T) with sqrt(-2 ln P) in place of upper limits, whose sum of squares is -2 ln density."""
        if not self.censored:
            return u
        return torch.where(self.limit, torch.sqrt((-2 * self.log_below(u)).clamp(min=1e-300)), u)

    def above_zero(self, residuals: Residuals, sigma: Tensor) -> Tensor:
        """Standard deviations (..., T) by which the model is above a flux of 0 in curves of which rows are there
        only if their flux is above 0; 100, as good as infinite, in others."""
        assert self.power is not None and self.selected is not None  # asked of such curves only
        power = torch.where(self.selected, self.power, 1.0)
        return torch.where(self.selected, above_zero(residuals.scale, power) / sigma, 100.0)


def _successive(recording: Recording, curves: int) -> Tensor:
    """1.4826 median |successive difference| / sqrt 2 of each curve's measured rows, (curves,); at least 1e-4 mag or
    1e-4 of the mean."""
    level = np.empty(curves)
    for number in range(curves):
        rows = recording.curve == number
        measured = rows & ~recording.upper_limit
        values = recording.observed[measured if measured.any() else rows]
        steps = np.abs(np.diff(values)) if measured.any() else values[:0]
        floor = 1e-4 if recording.kind == "mag" else 1e-4 * abs(float(np.mean(values))) + 1e-300
        level[number] = max(1.4826 * float(np.median(steps)) / np.sqrt(2) if len(steps) else floor, floor)
    return torch.as_tensor(level)
