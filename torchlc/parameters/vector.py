"""Parameters: what each number means, its prior, and the map between natural values and the unconstrained
space of Adam.

A :class:`ParameterSet` turns the scene's numbers (fixed or free) into one flat vector theta (..., P) of
natural values and back, knows the prior density of theta, and maps theta to unconstrained coordinates z (...,
P) by ``torch.distributions`` transforms. The two reflectances of one material are kept on the triangle r_spec
+ r_diff <= 1: the second is mapped to what the first leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.distributions import constraints, transforms

from torchlc.naming import NOBODY, Origin

PRIORS = ("uniform", "loguniform", "isotropic", "normal", "lognormal", "halfnormal", "cauchy")
REFLECTANCE, LOBE_REFLECTANCE, FRESNEL = "reflectance", "reflectance of the lobe", "Fresnel reflectance"
EXPONENT, WIDTH, INDEX, SHARE = "exponent", "width", "refractive index", "share"
ROLES = {
    REFLECTANCE: "of diffuse light, or of all light: a factor of it",
    LOBE_REFLECTANCE: "a factor of the light of the lobe",
    FRESNEL: "reflectance at normal incidence: light of the lobe is linear in it, but it is no factor",
    EXPONENT: "of the cosine whose power the lobe is",
    WIDTH: "of the lobe: roughness, or slope of microfacets",
    INDEX: "of refraction, from which the lobe's reflectance follows",
    SHARE: "of an area that is another material: beyond one half the other is the first",
}
NEAR_POLE = 1e-24
"""Square of a latitude's cosine below which its slope against the sine is no longer followed: at a pole it has
none."""


@dataclass(frozen=True)
class Quantity:
    """A physical parameter, declared once beside its physics.

    ``low`` and ``high`` are its bounds in ``unit``; ``off`` is the value at which it has no effect at all,
    ``typical`` the size worth suspecting; ``prior`` (one of PRIORS) is the default, with ``mean`` and ``sigma``.
    A latitude in degrees whose direction may point anywhere alike declares ``isotropic``. What has a value ``unless_set``
    keeps it where the scene says nothing. Where an offset is divided and its values are alike but for a few, which may lie anywhere
    within the bounds, ``apart`` is the width of the Cauchy distribution of these. ``role`` says what kind of number it is, where that decides how it is
    searched, sampled or judged: one of ROLES.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    off: float | None = None
    typical: float | None = None
    prior: str = "uniform"
    mean: float | None = None
    sigma: float | None = None
    unless_set: float | None = None
    role: str = ""
    apart: float | None = None

    def __post_init__(self) -> None:
        if self.role and self.role not in ROLES:
            raise ValueError(f"{self.name}: role {self.role!r}; expected one of {', '.join(ROLES)}")


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


@dataclass(frozen=True)
class Free:
    """A free parameter: its full name, its prior and the value to start from; ``origin`` says whose it is, ``role`` is its quantity's."""

    name: str
    prior: Prior
    start: float
    unit: str = ""
    meaning: str = ""
    origin: Origin = NOBODY
    role: str = ""


def prior_of(quantity: Quantity) -> Prior:
    """The default prior of a quantity, truncated to its bounds."""
    if quantity.prior == "halfnormal":
        return Prior("halfnormal", quantity.low, quantity.high, quantity.low, quantity.sigma or 1.0)
    centre = quantity.mean if quantity.mean is not None else (quantity.off or 0.0)
    return Prior(quantity.prior, quantity.low, quantity.high, centre, quantity.sigma or 1.0)


class ParameterSet:
    """The free parameters in order, the fixed ones beside them.

    ``simplex`` lists pairs (first, second) of names whose sum may not exceed 1; a pair with one member fixed
    narrows the other.
    """

    def __init__(
        self,
        free: Sequence[Free],
        fixed: Mapping[str, float],
        simplex: Iterable[tuple[str, str]] = (),
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> None:
        self.fixed = dict(fixed)
        self.dtype, self.device = dtype, torch.device(device)
        entries = {parameter.name: parameter for parameter in free}
        self.pairs: list[tuple[int, int]] = []
        order = [parameter.name for parameter in free]
        for first, second in simplex:
            for name, other in ((first, second), (second, first)):
                if name in entries and other in self.fixed:
                    entries[name] = _narrowed(entries[name], 1.0 - self.fixed[other])
            if first in entries and second in entries:
                entries[first] = _narrowed(entries[first], 1.0 - max(entries[second].prior.low, 0.0))
                entries[second] = _narrowed(entries[second], 1.0 - max(entries[first].prior.low, 0.0))
                self.pairs.append((order.index(first), order.index(second)))
        self.free = [entries[name] for name in order]
        self.names = order
        self.quantities = [parameter.origin.quantity for parameter in self.free]
        self.roles = [parameter.role for parameter in self.free]
        self._transforms = [parameter.prior.transform() for parameter in self.free]
        self._second = {second: first for first, second in self.pairs}
        self._triangle = {(a, b): self._log_triangle(a, b) for a, b in self.pairs}
        self._fixed = {name: torch.tensor(value, dtype=dtype, device=device) for name, value in fixed.items()}
        priors = [entry.prior for entry in self.free]
        self._bounds = self._row([one.low for one in priors]), self._row([one.high for one in priors])
        self._logarithmic = torch.tensor([one.logarithmic for one in priors], dtype=torch.bool, device=device)
        self._bent = [index for index, one in enumerate(priors) if one.isotropic or one.kind == "cauchy"]
        self._centre = self._row([one.flat_centre if one.peaked else 0.0 for one in priors])
        straight = [one.peaked and one.kind != "cauchy" for one in priors]
        precision = [1 / one.sigma**2 if plain else 0.0 for one, plain in zip(priors, straight, strict=True)]
        self._precision = self._row(precision)
        self._constant = self._row([one.log_constant for one in priors])

    def _row(self, numbers: Sequence[float]) -> Tensor:
        return torch.tensor(numbers, dtype=self.dtype, device=self.device)

    def __len__(self) -> int:
        return len(self.free)

    def start(self) -> Tensor:
        """Natural starting values, (P,)."""
        return torch.tensor([p.start for p in self.free], dtype=self.dtype, device=self.device)

    def values(self, theta: Tensor) -> dict[str, Tensor]:
        """Every number by its full name: free ones (...) from theta (..., P), fixed ones as scalars."""
        found = {name: value.to(theta) for name, value in self._fixed.items()}
        found.update(zip(self.names, self._columns(theta), strict=True))
        return found

    def _columns(self, theta: Tensor) -> tuple[Tensor, ...]:
        """The free parameters (...) of theta (..., P); ValueError if P is another."""
        columns = theta.unbind(-1) if theta.ndim else ()
        if len(columns) != len(self.free):
            raise ValueError(
                f"theta of shape {tuple(theta.shape)}: its last axis has to hold the {len(self.free)} free "
                f"parameters {', '.join(self.names)}"
            )
        return columns

    def to_natural(self, z: Tensor) -> Tensor:
        """Natural values theta (..., P) of unconstrained coordinates z (..., P)."""
        columns: list[Tensor] = []
        for index, (entry, column) in enumerate(zip(self.free, z.unbind(-1), strict=True)):
            value: Tensor = self._transforms[index](column)  # pyright: ignore[reportAssignmentType]
            if index in self._second:
                room = torch.clamp(1.0 - columns[self._second[index]], max=entry.prior.high) - entry.prior.low
                value = entry.prior.low + (value - entry.prior.low) * room / (
                    entry.prior.high - entry.prior.low
                )
            columns.append(value)
        return torch.stack(columns, -1) if columns else z.clone()

    def to_unconstrained(self, theta: Tensor) -> Tensor:
        """Inverse of :meth:`to_natural`; values on a bound are taken a billionth of the range inside."""
        columns: list[Tensor] = []
        natural = self._columns(theta)
        for index, (entry, column) in enumerate(zip(self.free, natural, strict=True)):
            value = column
            if index in self._second:
                value = self._unsqueeze(entry.prior, value, natural[self._second[index]])
            value = entry.prior.inside(value)
            columns.append(self._transforms[index].inv(value))  # pyright: ignore[reportArgumentType]
        return torch.stack(columns, -1) if columns else theta.clone()

    def log_prior(self, theta: Tensor) -> Tensor:
        """Log prior density (...) of natural theta (..., P); -inf outside the bounds or the triangle;
        normalised on each pair's triangle where both are uniform, else up to the constant that the triangle
        cuts off."""
        low, high = self._bounds
        inside = (theta >= low) & (theta <= high)
        safe = torch.where(inside, theta, self.start())
        y = torch.where(self._logarithmic, torch.log(torch.where(self._logarithmic, safe, 1.0)), safe)
        density = self._constant - 0.5 * self._precision * (y - self._centre) ** 2
        density = density - torch.where(self._logarithmic, y, 0.0)
        total = torch.where(inside, density, -math.inf).sum(-1)
        for index in self._bent:
            prior = self.free[index].prior
            y = prior.to_scale(safe[..., index])
            total = total - prior.log_slope(y)
            if prior.peaked:
                total = total - 0.5 * ((y - prior.flat_centre) / prior.sigma) ** 2
        for first, second in self.pairs:
            total = total + self._triangle[first, second]
            total = torch.where(theta[..., first] + theta[..., second] <= 1.0, total, -math.inf)
        return total

    def flat_bounds(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds (P,) of the flat coordinates y; infinite where there is none."""
        low, high = [], []
        for index, entry in enumerate(self.free):
            a, b = (0.0, 1.0) if index in self._second else entry.prior.flat_range()
            low.append(a)
            high.append(b)
        return self.start().new_tensor(low), self.start().new_tensor(high)

    def to_flat(self, theta: Tensor) -> Tensor:
        """Coordinates y (..., P) in which flat priors are flat and all bounds are a box: each on its prior's own
        scale, and the second reflectance of a pair as its share of what the first leaves."""
        columns = []
        natural = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.free, natural, strict=True)):
            prior = entry.prior
            if index in self._second:
                room = torch.clamp(1.0 - natural[self._second[index]], max=prior.high) - prior.low
                columns.append(((value - prior.low) / room.clamp(min=1e-12)).clamp(0.0, 1.0))
            else:
                columns.append(prior.to_scale(value))
        return torch.stack(columns, -1) if columns else theta.clone()

    def from_flat(self, y: Tensor) -> Tensor:
        """Inverse of :meth:`to_flat`."""
        columns: list[Tensor] = []
        for index, (entry, value) in enumerate(zip(self.free, y.unbind(-1), strict=True)):
            prior = entry.prior
            if index in self._second:
                room = torch.clamp(1.0 - columns[self._second[index]], max=prior.high) - prior.low
                columns.append(prior.low + room * value)
            else:
                columns.append(prior.from_scale(value))
        return torch.stack(columns, -1) if columns else y.clone()

    def to_straight(self, theta: Tensor) -> Tensor:
        """Coordinates x (..., P) in which light is nearly linear and posteriors are straight: each on its
        prior's own scale, and r_diff (1 - r_spec), the share that leaves diffusely, for the second of a pair.
        """
        columns = []
        natural = theta.unbind(-1)
        for index, (entry, value) in enumerate(zip(self.free, natural, strict=True)):
            if index in self._second:
                columns.append(value * (1.0 - natural[self._second[index]]))
            else:
                columns.append(entry.prior.to_scale(value))
        return torch.stack(columns, -1) if columns else theta.clone()

    def from_straight(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Natural values theta (..., P) and log |d theta / d x| (...); theta may lie outside the priors."""
        columns: list[Tensor] = []
        log_det = torch.zeros(x.shape[:-1], dtype=x.dtype, device=x.device)
        for index, (entry, value) in enumerate(zip(self.free, x.unbind(-1), strict=True)):
            if index in self._second:
                room = (1.0 - columns[self._second[index]]).clamp(min=1e-12)
                columns.append(value / room)
                log_det = log_det - torch.log(room)
            else:
                columns.append(entry.prior.from_scale(value))
                log_det = log_det + entry.prior.log_slope(value)
        return (torch.stack(columns, -1) if columns else x.clone()), log_det

    def prior_residuals(self, theta: Tensor) -> Tensor:
        """Peaked priors as rows of a least-squares problem: (..., number of peaked priors), zero at each
        prior's centre."""
        rows = []
        for entry, value in zip(self.free, theta.unbind(-1), strict=True):
            prior = entry.prior
            if prior.kind == "lognormal":
                rows.append((torch.log(value.clamp(min=1e-300)) - math.log(prior.centre)) / prior.sigma)
            elif prior.peaked:
                value = prior.to_scale(value) if prior.kind == "cauchy" else value
                rows.append((value - prior.centre) / prior.sigma)
        return torch.stack(rows, -1) if rows else theta.new_zeros(*theta.shape[:-1], 0)

    def sample_prior(self, count: int, generator: torch.Generator | None = None) -> Tensor:
        """Independent draws (count, P) from the prior, pairs rejected until inside their triangle."""
        if not self.free:
            return torch.zeros(count, 0, dtype=self.dtype, device=self.device)

        def draw(number: int) -> Tensor:
            u = torch.rand(number, len(self.free), generator=generator, dtype=self.dtype, device=self.device)
            return torch.stack(
                [e.prior.quantile(c) for e, c in zip(self.free, u.unbind(-1), strict=True)], -1
            )

        theta = draw(count)
        for first, second in self.pairs:
            outside = theta[:, first] + theta[:, second] > 1.0
            while bool(outside.any()):
                again = draw(int(outside.sum()))
                theta[outside, first], theta[outside, second] = again[:, first], again[:, second]
                outside = theta[:, first] + theta[:, second] > 1.0
        return theta

    def _unsqueeze(self, prior: Prior, value: Tensor, first: Tensor) -> Tensor:
        room = torch.clamp(1.0 - first, max=prior.high) - prior.low
        return prior.low + (value - prior.low) * (prior.high - prior.low) / room.clamp(min=1e-12)

    def _log_triangle(self, first: int, second: int) -> float:
        """Minus the log of the share of the pair's rectangle that lies under the line sum = 1 (0 unless both
        are uniform)."""
        a, b = self.free[first].prior, self.free[second].prior
        if a.kind != "uniform" or b.kind != "uniform":
            return 0.0
        x = torch.linspace(a.low, a.high, 4001, dtype=torch.float64)
        room = (torch.clamp(1.0 - x, max=b.high) - b.low).clamp(min=0.0)
        return -math.log(float(torch.trapezoid(room, x)) / ((a.high - a.low) * (b.high - b.low)))


def _narrowed(entry: Free, high: float) -> Free:
    prior = entry.prior
    if high >= prior.high:
        return entry
    room = max(high, prior.low + 1e-9)
    return replace(entry, prior=replace(prior, high=room), start=min(entry.start, room))
