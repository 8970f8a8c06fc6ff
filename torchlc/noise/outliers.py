"""A share of the rows is bad."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.noise.kind import NoiseKind
from torchlc.parameters import Quantity
from torchlc.stages.noise import Law
from torchlc.stages.showing import NIGHT, Shown
from torchlc.tensors.normal_tail import HALF_LOG_2PI, log_ndtr


@dataclass(frozen=True)
class Mixture(Law):
    """(1 - p) N(0, 1) + p N(0, width): ``share`` p and ``width``, (..., 1) each."""

    share: Tensor
    width: Tensor
    name: str = "outliers"

    def log_density(self, u):
        wide = _log_normal(u / self.width) - torch.log(self.width)
        return self._mixed(_log_normal(u), wide)

    def log_below(self, u):
        return self._mixed(log_ndtr(u), log_ndtr(u / self.width))

    def log_mixed(self, u, sigma):
        log_sigma = torch.log(sigma)
        wide = _log_normal(u / self.width) - log_sigma - torch.log(self.width)
        return self._mixed(_log_normal(u) - log_sigma, wide)

    def _mixed(self, good: Tensor, bad: Tensor) -> Tensor:
        return torch.logaddexp(torch.log1p(-self.share) + good, torch.log(self.share) + bad)

    @property
    def widest(self):
        return self.width

    def weight(self, u):
        """By the probability that a row is one of the bad."""
        odds = torch.log(self.share) - torch.log1p(-self.share) - torch.log(self.width)
        member = torch.sigmoid(odds + 0.5 * u**2 * (1 - 1 / self.width**2))
        return 1 - member + member / self.width**2

    def deviates(self, normal, random):
        struck = torch.as_tensor(random.random(len(normal))) < self.share
        return torch.where(struck, normal * self.width, normal)

    def blurred(self, left, sigma, known):
        """Each of the two normals is blurred to one."""
        width = torch.cat([torch.ones_like(self.width), self.width])
        share = torch.log(torch.cat([1 - self.share, self.share]))
        variance = known[:, None] + (sigma[:, None] * width) ** 2
        log_parts = share - 0.5 * left[:, None] ** 2 / variance - 0.5 * torch.log(variance) - HALF_LOG_2PI
        log_row = torch.logsumexp(log_parts, -1)
        member = torch.exp(log_parts - log_row[:, None])
        gain = (member / variance).sum(-1)
        # variance of the mixture: that within its parts, and that of their means about their own mean
        between = (member / variance**2).sum(-1) - gain**2
        return log_row, gain * left, gain - left**2 * between


def _log_normal(u: Tensor) -> Tensor:
    return -0.5 * u * u - HALF_LOG_2PI


class Outliers(NoiseKind):
    """A fraction p of the rows errs ``width`` times as much: (1 - p) N(0, s) + p N(0, width s) for every row.

    Neglects that bad rows come in runs and mostly err to one side.
    """

    name = "outliers"
    title = "a share of bad rows, with far larger errors"
    shown = Shown(NIGHT, "mag", {"fraction": 0.05, "width": 8.0})
    reshapes = True
    quantities = (
        Quantity(
            "fraction", "", 0.0, 0.5, "share of the rows that are bad",
            off=0.0, typical=0.03, prior="halfnormal", sigma=0.05,
        ),
        Quantity("width", "", 2.0, 100.0, "their error over the quoted one", typical=8.0, prior="loguniform"),
    )  # fmt: skip

    def noise(self, noise, p, context):
        # where the slope of the mixture's log, 1 / fraction a row that is all but impossible, has a finite sum over rows
        above_zero = 1e8 * torch.finfo(p["fraction"].dtype).tiny
        return noise.with_law(Mixture(p["fraction"] + above_zero, p["width"]))

    def trials(self, facts):
        return [
            {"fraction": share, "width": width}
            for share in (0.01, 0.03, 0.1, 0.2)
            for width in (3.0, 6.0, 15.0, 40.0)
        ]

    def closer(self, best, facts):
        return []
