"""How much of a hypothesis says nothing: values of an effect, or of noise, whose change of the rows nobody could see.

A prior reaches down to effects of no size, and a recording that shows nothing leaves those as they were. They are no answer
to what is missing. So the mass of such values counts for the hypothesis without the effect, or without the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from torchlc.diagnosis.hypotheses import effect_columns
from torchlc.inference.density import Fitted
from torchlc.noise.draw import draw

UNSEEN = 3.0
"""Root sum of squares, in errors of a row, of a change of the light that one of some twenty candidates would reach in noise
alone as often as not."""
SURE = 5.0
"""The same of a change that is seen whatever the noise does: the chance of less than 3 of it in noise is one in fifty."""
DRAWS = 200
NOISE_DRAWS, NOISE_RECORDINGS = 16, 8
"""Draws of the numbers of noise, and recordings made of each: the information of a recording is then told to a quarter of UNSEEN^2 / 2."""


@torch.no_grad()
def unseen_shares(fitted: Fitted, without: Fitted, entry: str, seed: int = 0) -> tuple[float, float]:
    """The shares of a fit's posterior mass in which its effect ``entry`` changes the light by less than UNSEEN, and by less than SURE,
    beyond what the rest of the model can take up; ``without`` is the fit of the same hypothesis less that effect. Residuals are taken as
    linear about each minimum."""
    entry_columns = set(effect_columns(fitted.model.parameter_set, entry))
    column_of = {name: column for column, name in enumerate(without.names)}
    rest = set(range(len(without.names))) - set(without.posterior.noise_columns)
    shares, masses = [], []
    for minimum in fitted.minima:
        tangent = minimum.whitened(without.slopes)
        generator = torch.Generator().manual_seed(seed)
        normal = torch.randn(DRAWS, len(minimum.g), generator=generator, dtype=minimum.g.dtype)
        step = normal @ torch.linalg.cholesky(minimum.covariance).T
        moved = minimum.whitened((without.delta - minimum.delta)[:, None] - minimum.slopes @ step.T)
        # what the fit without the effect has moved by already costs under the priors, as do the steps that it may still take
        paid = moved.new_zeros(tangent.shape[1], DRAWS)
        for column, name in enumerate(minimum.names):
            if column in entry_columns or column_of.get(name) not in rest:
                continue
            # halfway, for slopes change on the way from one fit to the other
            there = minimum.whitened(minimum.slopes[:, [column]])[:, 0]
            tangent[:, column_of[name]] = 0.5 * (tangent[:, column_of[name]] + there)
            paid[column_of[name]] = without.g[column_of[name]] - minimum.g[column] - step[:, column]
        basis = torch.linalg.qr(torch.cat([tangent, torch.eye(len(paid), dtype=tangent.dtype)]))[0]
        whole = torch.cat([moved, paid])
        left = torch.linalg.vector_norm(whole - basis @ (basis.T @ whole), dim=0)
        shares.append(torch.stack([(left < limit).to(left).mean() for limit in (UNSEEN, SURE)]))
        masses.append(minimum.laplace)
    weight = torch.softmax(torch.tensor(masses, dtype=torch.float64), 0)
    unseen, unsure = (weight @ torch.stack(shares)).tolist()
    return unseen, unsure


@torch.no_grad()
def unseen_noise_share(fitted: Fitted, quoted: Fitted, seed: int = 0) -> float:
    """The share of a fit's posterior mass in which rows err so nearly as in ``quoted``, the fit without that noise, that the recording
    neither tells nor could tell: ln of its density under the one is less than UNSEEN^2 / 2 above that under the other, which is
    what a change of the light by UNSEEN amounts to, and so it is of half the recordings made with that noise."""
    random = np.random.default_rng(seed)
    likelihood, at, unseen = fitted.likelihood, fitted.found, 0
    plain = at.sigma / fitted.posterior.factor(fitted.g)
    before = float(likelihood.density(quoted.found, quoted.noise))
    for g in fitted.points(NOISE_DRAWS, seed):
        noise = fitted.posterior.noise(g)
        sigma = (plain * fitted.posterior.factor(g)).expand(at.delta.shape)
        if float(likelihood.density(replace(at, sigma=sigma), noise)) - before > 0.5 * UNSEEN**2:
            continue
        made = [draw(noise, sigma, likelihood.curve, random, fitted.scale) for _ in range(NOISE_RECORDINGS)]
        drawn = replace(at, delta=torch.stack(made), sigma=sigma, scale=fitted.scale)
        gained = likelihood.density(drawn, noise)
        gained -= likelihood.density(replace(drawn, sigma=plain), quoted.noise)
        unseen += float(gained.median()) < 0.5 * UNSEEN**2
    return unseen / NOISE_DRAWS
