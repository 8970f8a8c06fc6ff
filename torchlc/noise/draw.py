"""Random errors of a noise model, as a simulation adds them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchlc.stages.noise import Noise

RIDGE = 1e-9
"""Added to the unit diagonal of a correlation, so that rows at one instant have a Cholesky factor: 3e-5 of the sd."""


def draw(
    noise: Noise,
    quoted: Tensor,
    curve: Tensor,
    random: np.random.Generator,
    scale: Tensor | float = 1.0,
) -> Tensor:
    """Errors (T,) of rows of quoted error (T,) and ``curve`` (T,): each row's own, of its law, and those that the
    rows of a curve, or of another group, share. They are in mag, or in the unit of the recording that ``scale`` (T,) turns a magnitude into."""
    scale = torch.as_tensor(scale).to(quoted).expand(len(quoted))
    sigma = noise.sigma(quoted, scale)
    normal = torch.as_tensor(random.normal(size=len(quoted))).to(quoted)
    delta = noise.law.deviates(normal, random) * sigma
    for process in noise.processes:
        member = process.members(curve)
        for number in torch.unique(member):
            rows = torch.nonzero(member == number)[:, 0]
            correlation = process.correlation(rows)
            factor = torch.linalg.cholesky(
                correlation + RIDGE * torch.eye(len(rows), dtype=correlation.dtype, device=correlation.device)
            )
            shared = factor @ torch.as_tensor(random.normal(size=len(rows))).to(quoted)
            delta[rows] += process.sd.expand(len(quoted))[rows] * scale[rows] * shared
    return delta
