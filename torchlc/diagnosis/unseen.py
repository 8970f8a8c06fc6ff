"""How much of a hypothesis says nothing: values of an effect whose change of the light nobody could see.

A prior reaches down to effects of no size, and a recording that shows nothing leaves those as they were. They are no answer
to what is missing. So the mass of such values counts for the hypothesis without the effect.
"""

from __future__ import annotations

import torch

from torchlc.diagnosis.hypotheses import effect_columns
from torchlc.inference.density import Fitted

UNSEEN = 3.0
"""Root sum of squares, in errors of a row, of a change of the light that one of some twenty candidates would reach in noise
alone as often as not."""
DRAWS = 200


@torch.no_grad()
def unseen_share(fitted: Fitted, without: Fitted, entry: str, seed: int = 0) -> float:
    """The share of a fit's posterior mass in which its effect ``entry`` changes the light by less than UNSEEN beyond what the
    rest of the model can take up; ``without`` is the fit of the same hypothesis less that effect. Residuals are taken as
    linear about each minimum."""
    own = set(effect_columns(fitted.model.parameter_set, entry))
    place = {name: column for column, name in enumerate(without.names)}
    rest = set(range(len(without.names))) - set(without.posterior.noise_columns)
    shares, masses = [], []
    for one in fitted.minima:
        tangent = one.whitened(without.slopes)
        generator = torch.Generator().manual_seed(seed)
        normal = torch.randn(DRAWS, len(one.g), generator=generator, dtype=one.g.dtype)
        step = normal @ torch.linalg.cholesky(one.covariance).T
        moved = one.whitened((without.delta - one.delta)[:, None] - one.slopes @ step.T)
        # what the fit without the effect has moved by already costs under the priors, as do the steps that it may still take
        paid = moved.new_zeros(tangent.shape[1], DRAWS)
        for column, name in enumerate(one.names):
            if column in own or place.get(name) not in rest:
                continue
            # halfway, for slopes change on the way from one fit to the other
            there = one.whitened(one.slopes[:, [column]])[:, 0]
            tangent[:, place[name]] = 0.5 * (tangent[:, place[name]] + there)
            paid[place[name]] = without.g[place[name]] - one.g[column] - step[:, column]
        basis = torch.linalg.qr(torch.cat([tangent, torch.eye(len(paid), dtype=tangent.dtype)]))[0]
        whole = torch.cat([moved, paid])
        left = torch.linalg.vector_norm(whole - basis @ (basis.T @ whole), dim=0)
        shares.append((left < UNSEEN).to(left).mean())
        masses.append(one.laplace)
    weight = torch.softmax(torch.tensor(masses, dtype=torch.float64), 0)
    return float((weight * torch.stack(shares)).sum())
