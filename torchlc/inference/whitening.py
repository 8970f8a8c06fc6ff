"""Residuals as rows of unit variance, as the noise and its numbers say."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchlc.inference.likelihood import Likelihood
from torchlc.noise import Noise, Residuals
from torchlc.noise.correlated import correlated_parts, white_levels
from torchlc.tensors.normal_tail import hazard


def whitener(
    likelihood: Likelihood, at: Residuals, noise: Noise | None, *, fitted: bool = False
) -> Callable[[Residuals], Tensor]:
    """A function that turns residuals into rows of unit variance, with the noise and its scale taken at the
    residuals ``at``. With ``fitted`` these are near the minimum: levels of errors that are fitted, what weight the law of
    errors gives to rows, and how far rows are bright because those below a flux of 0 are not there, are taken from them; repeated,
    this is expectation and maximisation (Dempster, Laird & Rubin 1977, J. R. Stat. Soc. B 39, 1). Upper limits among rows
    that err together count one by one here, each given the measured rows."""
    noise = Noise() if noise is None else noise
    sigma = noise.sigma(at.sigma, at.scale).expand(at.delta.shape)
    if likelihood.fitted_errors and fitted:
        levels = (
            white_levels(likelihood, at.delta, noise)
            if noise.processes
            else likelihood.fitted_levels(at.delta)
        )
        sigma = levels[likelihood.curve]
    if noise.processes:
        parts = correlated_parts(likelihood, at, sigma, noise)
        order = torch.argsort(torch.cat([part.rows.flatten() for part in parts]))
        spread = [torch.sqrt(part.limits.square().sum(-1)) for part in parts]

        def correlated(residuals: Residuals) -> Tensor:
            pieces = []
            for part, sd in zip(parts, spread, strict=True):
                white, left = part.whitened(residuals.delta)
                pieces.append(torch.cat([white, left / sd], -1).flatten(-2))
            return likelihood.deviance_rows(torch.cat(pieces, -1)[..., order])

        return correlated

    shift = torch.zeros_like(sigma)
    if fitted:
        sigma = noise.law.weighted(at.delta, sigma)
    if fitted and likelihood.selected is not None:
        shift = hazard(likelihood.above_zero(at, sigma))

    def independent(residuals: Residuals) -> Tensor:
        return likelihood.deviance_rows(residuals.delta / sigma + shift)

    return independent


def noise_columns(likelihood: Likelihood) -> list[int]:
    """Which elements of theta belong to noise effects."""
    owners = {effect.name for effect in likelihood.model.assembly.stage("noise")}
    free = likelihood.model.parameter_set.free
    return [
        i
        for i, parameter in enumerate(free)
        if parameter.origin.role == "effects" and parameter.origin.owner in owners
    ]
