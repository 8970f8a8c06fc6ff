"""How rows err: one file a noise model, and the densities that follow from it.

A noise model is an effect of the noise stage, a :class:`~torchlc.noise.kind.NoiseKind`. Whatever computes with noise
asks :class:`~torchlc.stages.noise.Noise` for its variance, law and processes, and knows no kind by name.
"""

from __future__ import annotations

from torch import Tensor

from torchlc.noise import correlated, fitted_level, white
from torchlc.noise.rows import Residuals, Rows
from torchlc.stages.noise import Noise


def log_density(rows: Rows, residuals: Residuals, noise: Noise) -> Tensor:
    """Log density (...) of residuals under a noise model."""
    if noise.processes:
        return correlated.log_density(rows, residuals, noise)
    if rows.fitted_errors:
        return fitted_level.log_density(rows, residuals, noise)
    return white.log_density(rows, residuals, noise)


__all__ = ["Noise", "Residuals", "Rows", "log_density"]
