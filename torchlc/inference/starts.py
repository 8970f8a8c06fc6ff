"""Where refits begin: many values of what light depends on in a curved way, each with the reflectances that a
bounded regression finds for it.

Light is linear in the reflectances, so that only exponents, widths and the effect's own parameters have to be
searched; a lobe that is ten times too wide is a minimum of its own, out of which no descent leads.

Letters: N trials, P parameters, K reflectances, T rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torchlc.inference.likelihood import Likelihood
from torchlc.inference.reflectances import REWEIGHTED, about, linear_columns, linear_light
from torchlc.noise.error_law import MAG_PER_LN

SWEEPS = 25
"""Over all coordinates: starts need no more digits, for Adam goes on from them."""


def regressed(likelihood: Likelihood, theta: Tensor) -> Tensor:
    """Natural values (N, P) with their reflectances replaced by the regression's, within their bounds."""
    model = likelihood.model
    parameters = model.parameter_set
    linear = linear_columns(model)
    first = {second: partner for partner, second in parameters.pairs}
    limits = [(parameters.free[i].prior.low, parameters.free[i].prior.high) for i in linear]
    rest = {linear.index(i): linear.index(first[i]) for i in linear if first.get(i) in linear}
    x = parameters.to_straight(theta)
    dark, design = linear_light(model, x, linear)
    residuals = likelihood.residuals(theta)
    sigma = torch.where(likelihood.limit, torch.inf, residuals.sigma.expand(residuals.delta.shape))

    def solved(target: Tensor, error: Tensor) -> Tensor:
        return bounded(design / error[..., None], (target - dark) / error, limits, rest)

    if likelihood.kind == "flux":
        assert residuals.gain is not None  # flux has one
        gain = residuals.gain[:, likelihood.curve].abs().clamp(min=1e-300)
        values = solved(likelihood.observed / gain, sigma / gain)
    else:
        observed = (likelihood.observed_flux * 10 ** (0.4 * model.zero_point(theta))).expand(dark.shape)
        values = solved(observed, observed * sigma / MAG_PER_LN)
        for _ in range(REWEIGHTED):
            target, near = about(dark, design, values, observed, likelihood.power)
            values = solved(target, near * sigma / MAG_PER_LN)
    x[:, linear] = values
    return parameters.from_straight(x)[0]


def bounded(
    design: Tensor, target: Tensor, limits: Sequence[tuple[float, float]], rest: Mapping[int, int]
) -> Tensor:
    """Least squares |design x - target|^2 (N, T, K), (N, T) within ``limits``, by coordinate descent: (N, K).

    Where ``rest`` maps a second reflectance to its first, the second is r_diff (1 - r_spec), and r_diff stays
    within its limits and 1 - r_spec.
    """
    normal = design.transpose(1, 2) @ design
    right = (design.transpose(1, 2) @ target[..., None])[..., 0]
    diagonal = torch.diagonal(normal, dim1=1, dim2=2).clamp(min=1e-300)
    x = torch.zeros_like(right)
    for _ in range(SWEEPS):
        for index, (low, high) in enumerate(limits):
            pull = right[:, index] - (normal[:, index] * x).sum(-1) + normal[:, index, index] * x[:, index]
            value = (pull / diagonal[:, index]).clamp(low, high)
            if index in rest:
                room = 1.0 - x[:, rest[index]]
                value = torch.minimum(torch.maximum(value, low * room), room.clamp(max=high) * room)
            x[:, index] = value
    return x
