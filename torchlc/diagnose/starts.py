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

from torchlc.likelihood import MAG_PER_LN, Likelihood

REFLECTANCES = ("r_spec", "r_diff", "f0", "albedo")
REWEIGHTED = 2
"""Times that the regression is done again about its own result, so that it is one of magnitudes, not of flux."""
SWEEPS = 25


def screened(likelihood: Likelihood, trials: Tensor, count: int, group: Tensor) -> Tensor:
    """The best ``count`` of natural trials (N, P), by the objective that they reach with reflectances found
    anew, as natural values (count, P); at most a third of them from one ``group`` (N,).

    A trial is judged both as it is given and with its reflectances from the regression.
    """
    with torch.no_grad():
        trials = torch.cat([trials, regressed(likelihood, trials)])
        cost = objective(likelihood, trials)
    group = group.repeat(2)
    room = {int(one): max(1, -(-count // 3)) for one in torch.unique(group)}
    chosen: list[int] = []
    for index in torch.argsort(cost).tolist():
        if room[int(group[index])] > 0 and len(chosen) < count:
            room[int(group[index])] -= 1
            chosen.append(index)
    return trials[chosen]


def objective(likelihood: Likelihood, theta: Tensor) -> Tensor:
    """Chi-square with prior rows, (N,), of natural theta (N, P); where errors are fitted, what the logarithm
    of the residuals' scatter stands for."""
    found = likelihood.residuals(theta)
    pull = likelihood.model.parameter_set.prior_residuals(theta).square().sum(-1)
    if likelihood.fitted_errors:
        square = likelihood.by_curve(found.delta**2) / likelihood.count
        cost = (likelihood.count * torch.log(square.clamp(min=1e-300))).sum(-1)
    else:
        cost = likelihood.normalised(found).square().sum(-1)
    return torch.nan_to_num(cost + pull, torch.inf, torch.inf, torch.inf)


def regressed(likelihood: Likelihood, theta: Tensor) -> Tensor:
    """Natural values (N, P) with their reflectances replaced by the regression's, within their bounds; theta
    itself where nothing is linear."""
    model = likelihood.model
    parameters = model.parameter_set
    held = set(model.assembly.geometry_columns)
    first = {second: one for one, second in parameters.pairs}
    short = [name.partition("[")[0].rpartition(".")[2] for name in parameters.names]
    linear = [i for i, name in enumerate(short) if name in REFLECTANCES and i not in held]
    if not linear:
        return theta.clone()
    x = parameters.to_straight(theta)
    points = x[:, None].repeat(1, len(linear) + 1, 1)
    points[:, :, linear] = 0.0
    for place, column in enumerate(linear):
        points[:, place + 1, column] = 1.0
    flux = model.brightness(parameters.from_straight(points)[0]).flux
    dark, design = flux[:, 0], (flux[:, 1:] - flux[:, :1]).transpose(1, 2)
    found = likelihood.residuals(theta)
    sigma = torch.where(likelihood.limit, torch.inf, found.sigma.expand(found.delta.shape))
    if likelihood.kind == "flux":
        assert found.gain is not None  # flux has one
        gain = found.gain[:, likelihood.curve].abs().clamp(min=1e-300)
        target, near, weight = likelihood.observed / gain, None, gain / sigma
    else:
        target = likelihood.observed_flux * 10 ** (0.4 * model.zero_point(theta))
        target = target.expand(flux[:, 0].shape)
        near, weight = target, MAG_PER_LN / sigma / target
    observed = target
    limits = [(parameters.free[i].prior.low, parameters.free[i].prior.high) for i in linear]
    rest = {linear.index(i): linear.index(first[i]) for i in linear if first.get(i) in linear}
    values = x[:, linear]
    for _ in range(1 if near is None else 1 + REWEIGHTED):
        values = bounded(weight[..., None] * design, weight * (target - dark), limits, rest)
        if near is not None:
            predicted = dark + (design @ values[..., None])[..., 0]
            near = torch.minimum(torch.maximum(predicted, 0.2 * observed), 5.0 * observed)
            target = near * (1.0 + torch.log(observed / near))
            weight = MAG_PER_LN / sigma / near
    x = x.clone()
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
        for place, (low, high) in enumerate(limits):
            pull = right[:, place] - (normal[:, place] * x).sum(-1) + normal[:, place, place] * x[:, place]
            value = (pull / diagonal[:, place]).clamp(low, high)
            if place in rest:
                room = 1.0 - x[:, rest[place]]
                value = torch.minimum(torch.maximum(value, low * room), room.clamp(max=high) * room)
            x[:, place] = value
    return x
