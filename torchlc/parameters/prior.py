"""The prior of one scalar: its density, its own scale, and the map from the real line onto its bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import constraints, transforms

from torchlc.parameters.quantity import Quantity

PRIORS = ("uniform", "loguniform", "isotropic", "normal", "lognormal", "halfnormal", "cauchy")
NEAR_POLE = 1e-24
"""Square of a latitude's cosine below which its slope against the sine is no longer followed: at a pole it has
none."""


@dataclass(frozen=True)
class Prior:
    """Prior of one scalar: kind, bounds (may be infinite), and for the peaked kinds the centre and width.

    ``centre`` and ``sigma`` are mean and standard deviation (normal), median and standard deviation of the
    logarithm (lognormal), lower end and scale (halfnormal). ``isotropic`` is for a latitude in degrees: flat in
    its sine, which with a flat longitude makes directions uniform on the sphere. Every kind is truncated to
    [low, high] and normalised there.

    A kind has a scale of its own, on which it is flat or normal: ln x, the sine of x, or x itself. ``cauchy`` has half its mass
    within ``sigma`` of ``centre`` and the rest in tails that fall as 1/x^2: numbers that are alike but for a few. Its own scale is the
    normal quantile of its distribution, of width ``sigma`` about ``centre``.
    """

    kind: str
    low: float
    high: float
    centre: float = 0.0
    sigma: float = 1.0

    @property
    def peaked(self) -> bool:
        """True if the prior pulls towards a centre."""
        return self.kind in ("normal", "lognormal", "halfnormal", "cauchy")

    @property
    def logarithmic(self) -> bool:
        return self.kind in ("loguniform", "lognormal")

    @property
    def isotropic(self) -> bool:
        return self.kind == "isotropic"

    @property
    def scale(self) -> float:
        """Width of the prior on its own scale."""
        return self.sigma if self.peaked else self._width()

    @property
    def flat_centre(self) -> float:
        """Centre of a peaked prior on its own scale."""
        return math.log(self.centre) if self.kind == "lognormal" else self.centre

    @property
    def log_constant(self) -> float:
        """Logarithm of what makes the density on the prior's own scale integrate to 1."""
        if not self.peaked:
            return -math.log(self._width())
        a, b = self._cdf_range()
        return -math.log(self.sigma * math.sqrt(2 * math.pi)) - math.log(max(b - a, 1e-300))

    def to_scale(self, x: Tensor) -> Tensor:
        """Values on the prior's own scale, same shape; ln is taken of 1e-300 at least."""
        if self.isotropic:
            return torch.sin(torch.deg2rad(x))
        if self.kind == "cauchy":
            share = 0.5 + torch.atan((x - self.centre) / self.sigma) / math.pi
            return self.centre + self.sigma * torch.special.ndtri(share)
        return torch.log(x.clamp(min=1e-300)) if self.logarithmic else x

    def from_scale(self, y: Tensor) -> Tensor:
        """Inverse of :meth:`to_scale`."""
        if self.isotropic:
            return latitude(y)
        if self.kind == "cauchy":
            share = torch.special.ndtr((y - self.centre) / self.sigma)
            return self.centre + self.sigma * torch.tan(math.pi * (share - 0.5))
        return torch.exp(y) if self.logarithmic else y

    def log_slope(self, y: Tensor) -> Tensor:
        """log |dx/dy| of values y on the prior's own scale, same shape."""
        if self.isotropic:
            square = ((1 - y) * (1 + y)).clamp(min=NEAR_POLE)
            return math.log(180 / math.pi) - 0.5 * torch.log(square)
        if self.kind == "cauchy":
            score = (y - self.centre) / self.sigma
            away = torch.tan(math.pi * (torch.special.ndtr(score) - 0.5))
            return 0.5 * math.log(math.pi / 2) - 0.5 * score * score + torch.log1p(away * away)
        return y if self.logarithmic else torch.zeros_like(y)

    def log_density(self, x: Tensor) -> Tensor:
        """Log density at x, same shape; -inf outside [low, high]."""
        inside = (x >= self.low) & (x <= self.high)
        y = self.to_scale(torch.where(inside, x, self.low if math.isfinite(self.low) else self.centre))
        u = (y - self.flat_centre) / self.sigma if self.peaked else torch.zeros_like(y)
        return torch.where(inside, self.log_constant - self.log_slope(y) - 0.5 * u * u, -math.inf)

    def quantile(self, p: Tensor) -> Tensor:
        """Inverse of the cumulative distribution at p in [0, 1], same shape; its value at uniform p is a draw
        from the prior."""
        if not self.peaked:
            low, high = self.flat_range()
            y = low + (high - low) * p
        else:
            a, b = self._cdf_range()
            q = (a + (b - a) * p).clamp(1e-15, 1 - 1e-15)
            y = self.flat_centre + self.sigma * math.sqrt(2) * torch.erfinv(2 * q - 1)
        return self.from_scale(y)

    def transform(self) -> transforms.Transform:
        """Bijection from the real line onto (low, high); z = 0 is the middle of the prior and z of order 1
        its width."""
        low, high = self.flat_range()
        flat = not self.peaked
        middle = 0.5 * (low + high) if flat else self.flat_centre
        if self.kind == "halfnormal":
            middle = low + 0.7 * self.sigma
        steps: list[transforms.Transform]
        if math.isfinite(low) and math.isfinite(high):
            p = min(max((middle - low) / (high - low), 1e-12), 1 - 1e-12)
            scale = 1.0 if flat else self.sigma / ((high - low) * p * (1 - p))
            steps = [
                transforms.AffineTransform(math.log(p / (1 - p)), scale),
                transforms.SigmoidTransform(),
                transforms.AffineTransform(low, high - low),
            ]
        elif math.isfinite(low):
            gap = max(middle - low, 1e-12)
            steps = [
                transforms.AffineTransform(math.log(gap), min(self.sigma / gap, 3.0)),
                transforms.ExpTransform(),
                transforms.AffineTransform(low, 1.0),
            ]
        elif math.isfinite(high):
            gap = max(high - middle, 1e-12)
            steps = [
                transforms.AffineTransform(math.log(gap), min(self.sigma / gap, 3.0)),
                transforms.ExpTransform(),
                transforms.AffineTransform(high, -1.0),
            ]
        else:
            steps = [transforms.AffineTransform(middle, self.sigma)]
        if self.logarithmic:
            steps.append(transforms.ExpTransform())
        elif self.isotropic:
            steps.append(LatitudeTransform())
        elif self.kind == "cauchy":
            steps.append(CauchyTransform(self))
        return transforms.ComposeTransform(steps)

    def inside(self, x: Tensor) -> Tensor:
        """Values moved off the bounds, by a billionth of the range (of the width, where there is one bound)."""
        low, high = self.low, self.high
        if not (math.isfinite(low) and math.isfinite(high)):
            margin = 1e-9 * self.sigma
            low, high = low + margin, high - margin
        elif self.logarithmic:
            low, high = low * (1 + 1e-9), high * (1 - 1e-9)
        else:
            bounds = x.new_tensor(self.flat_range())
            margin = 1e-9 * (bounds[1] - bounds[0])
            low, high = self.from_scale(torch.stack([bounds[0] + margin, bounds[1] - margin])).tolist()
        return x.clamp(low, high)

    def flat_range(self) -> tuple[float, float]:
        """Bounds on the prior's own scale."""
        if self.isotropic:
            return math.sin(math.radians(self.low)), math.sin(math.radians(self.high))
        if self.kind == "cauchy":
            low, high = self.to_scale(torch.tensor([self.low, self.high], dtype=torch.float64)).tolist()
            return low, high
        if not self.logarithmic:
            return self.low, self.high
        return (
            math.log(self.low) if self.low > 0 else -math.inf,
            math.log(self.high) if math.isfinite(self.high) else math.inf,
        )

    def _width(self) -> float:
        low, high = self.flat_range()
        return high - low

    def _cdf_range(self) -> tuple[float, float]:
        low, high = self.flat_range()

        def cdf(value: float) -> float:
            return 0.5 * (1 + math.erf((value - self.flat_centre) / (self.sigma * math.sqrt(2))))

        return cdf(low), cdf(high)


def latitude(sine: Tensor) -> Tensor:
    """Latitude, deg, of its sine, same shape, with a slope everywhere: 0 at a pole; beyond +-1 it goes on past the
    pole, so that nothing out there lies within bounds."""
    square = (1 - sine) * (1 + sine)
    cosine = torch.sqrt(square.clamp(min=NEAR_POLE))
    beyond = torch.where(sine.abs() > 1, sine - sine.sign(), 0.0)
    return torch.rad2deg(torch.atan2(sine.clamp(-1, 1), cosine) + beyond)


class LatitudeTransform(transforms.Transform):
    """From the sine of a latitude to the latitude, deg."""

    domain = constraints.interval(-1.0, 1.0)
    codomain = constraints.interval(-90.0, 90.0)
    bijective = True
    sign = 1  # pyright: ignore[reportAssignmentType]

    def _call(self, x: Tensor) -> Tensor:
        return latitude(x)

    def _inverse(self, y: Tensor) -> Tensor:
        return torch.sin(torch.deg2rad(y))

    def log_abs_det_jacobian(self, x: Tensor, y: Tensor) -> Tensor:
        return Prior("isotropic", -90.0, 90.0).log_slope(x)


class CauchyTransform(transforms.Transform):
    """From a Cauchy prior's own scale to natural values."""

    domain = constraints.real
    codomain = constraints.real
    bijective = True
    sign = 1  # pyright: ignore[reportAssignmentType]

    def __init__(self, prior: Prior) -> None:
        super().__init__()
        self.prior = prior

    def _call(self, x: Tensor) -> Tensor:
        return self.prior.from_scale(x)

    def _inverse(self, y: Tensor) -> Tensor:
        return self.prior.to_scale(y)

    def log_abs_det_jacobian(self, x: Tensor, y: Tensor) -> Tensor:
        return self.prior.log_slope(x)


def prior_of(quantity: Quantity) -> Prior:
    """The default prior of a quantity, truncated to its bounds."""
    if quantity.prior == "halfnormal":
        return Prior("halfnormal", quantity.low, quantity.high, quantity.low, quantity.sigma or 1.0)
    centre = quantity.mean if quantity.mean is not None else (quantity.off or 0.0)
    return Prior(quantity.prior, quantity.low, quantity.high, centre, quantity.sigma or 1.0)
