"""A move of the ensemble between explanations: another shape of the lobes, and the reflectances that go with it.

Brightness is linear in the reflectances once everything else is settled. So what is left of them, given the
rest, is nearly a normal distribution cut off at the bounds, which a regression finds. The move proposes other
exponents, widths or zero points, draws the reflectances anew from the regression that belongs to these, and
is accepted by Metropolis and Hastings' rule; a glossy body beside dull panels and its reverse, an optimum
each, exchange draws in one step. Where light is not quite linear in a reflectance (the lobe of Phong, a large
noise in magnitudes) the proposal is less apt, never wrong.

Letters: W walkers, P parameters, K reflectances, T rows.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchlc.inference.likelihood import Likelihood
from torchlc.inference.reflectances import about, linear_columns, linear_light
from torchlc.inference.whitening import noise_columns
from torchlc.noise.error_law import MAG_PER_LN
from torchlc.tensors.normal_tail import hazard, log_ndtr

WIDER = 1.2
"""The regression's covariance is widened by this, so that the proposal has no thinner tails than the posterior."""
FLAT_VARIANCE = 1 / 12
"""Of a reflectance about which nothing is known."""
LEAST_PIVOT, RIDGE = 1e-13, 1e-10
"""Shares of a diagonal element: a pivot below the first is rounding (2e-16 times some tens of additions), and the second is then
added, which leaves pivots a thousand times above it."""
FAR_LOG_P = -15.0
"""log of a normal probability, 5 standard deviations out, below which a quantile is polished."""
REWEIGHTED = 1
"""Times that the regression is done again about its own result. A second time costs a quarter more, and leaves the
autocorrelation time of the paper's Object 1 where it is, at 19 to 20 steps."""
KEPT = 6
"""Times the regressions of one move that are kept, the newest: walkers stay where they are for some moves."""
KINDS = {
    "one from its prior": 0.3,
    "one by a step": 0.4,
    "all from their priors": 0.1,
    "two of a kind exchanged": 0.2,
}
"""Kinds of proposals, and how often each is made: small steps most, which are accepted most; whole draws from the priors seldom."""


class Redraw:
    """Proposal for ``emcee.moves.MHMove``: straight coordinates (W, P) to new ones, and log q(old) / q(new) (W,).

    The errors of the regression, and the gains of relative flux, are those at natural values ``theta`` (P,).
    """

    def __init__(self, likelihood: Likelihood, theta: Tensor) -> None:
        self.likelihood = likelihood
        model = likelihood.model
        short = model.parameter_set.quantities
        self.noise = noise_columns(likelihood)
        held = {*model.assembly.geometry_columns, *self.noise}
        self.linear = [i for i in linear_columns(model) if i not in held]
        self.others = [i for i in range(len(short)) if i not in held and i not in self.linear]
        self.alike = [(i, j) for i in self.others for j in self.others if i < j and short[i] == short[j]]
        self.first = {second: first for first, second in model.parameter_set.pairs}
        bounds = [parameter.prior.flat_range() for parameter in model.parameter_set.free]
        self.low, self.high = torch.tensor(bounds, dtype=theta.dtype).unbind(-1)
        with torch.no_grad():
            residuals = likelihood.residuals(theta)
            sigma = residuals.sigma.expand(residuals.delta.shape)
            if likelihood.fitted_errors:
                sigma = likelihood.fitted_levels(residuals.delta)[likelihood.curve]
            sigma = model.noise(theta).sigma(sigma, residuals.scale)
        self._known: dict[bytes, tuple[Tensor, Tensor]] = {}
        self.sigma, self.gain = torch.where(likelihood.limit, math.inf, sigma), residuals.gain

    def __call__(self, coords: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        old = torch.as_tensor(coords)
        with torch.no_grad():
            new, factor = self.change(old, random)
        return self.with_reflectances(old, new, factor, random)

    def with_reflectances(
        self, old: Tensor, new: Tensor, factor: Tensor, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """A proposal (W, P), and log q(old) / q(new) (W,) of all of it: the reflectances of ``new`` (W, P) drawn anew
        from the regression that belongs to its other columns, which were proposed by ``factor`` (W,)."""
        walkers = len(old)
        with torch.no_grad():
            within = (new >= self.low) & (new <= self.high)
            factor = torch.where(within[:, self.others].all(-1), factor, -math.inf)
            new[:, self.others] = torch.minimum(torch.maximum(new, self.low), self.high)[:, self.others]
            centre, spread = self.regressions(old, new)
            uniform = torch.as_tensor(random.random_sample((walkers, len(self.linear))))
            _, back = self.truncated(old, centre[:walkers], spread[:walkers])
            new, forth = self.truncated(new, centre[walkers:], spread[walkers:], uniform)
        factor = factor + back - forth
        sound = torch.isfinite(factor) & torch.isfinite(new).all(-1)  # else far out in a tail: no move
        return torch.where(sound[:, None], new, old).numpy(), torch.where(sound, factor, -math.inf).numpy()

    def change(self, old: Tensor, random: np.random.RandomState) -> tuple[Tensor, Tensor]:
        """Other values of what is not a reflectance (W, P), and log q(old) / q(new) of that alone (W,)."""
        new, factor = old.clone(), torch.zeros(len(old), dtype=old.dtype)
        if not self.others:
            return new, factor
        kind = random.choice(list(KINDS), p=list(KINDS.values()))
        rows = torch.arange(len(old))
        picked = torch.as_tensor(random.choice(self.others, len(old)))
        uniform = torch.as_tensor(random.random_sample((len(old), len(self.others))))
        normal = torch.as_tensor(random.standard_normal(len(old)))
        size = torch.as_tensor(10.0 ** random.uniform(-3.0, 0.0, len(old)))
        free = self.likelihood.model.parameter_set.free
        if kind in ("one from its prior", "all from their priors"):
            for index, column in enumerate(self.others):
                chosen = (picked == column) | (kind == "all from their priors")
                prior = free[column].prior
                draw = prior.quantile(uniform[:, index])
                there = prior.to_scale(draw)
                before = prior.log_density(prior.from_scale(old[:, column])) + prior.log_slope(old[:, column])
                gain = before - prior.log_density(draw) - prior.log_slope(there)
                new[:, column] = torch.where(chosen, there, old[:, column])
                factor = factor + torch.where(chosen, gain, 0.0)
        elif kind == "one by a step":
            widths = torch.tensor([parameter.prior.scale for parameter in free], dtype=old.dtype)
            new[rows, picked] += widths[picked] * size * normal
        elif self.alike:
            i, j = torch.as_tensor(self.alike)[
                torch.as_tensor(random.randint(len(self.alike), size=len(old)))
            ].T
            new[rows, i], new[rows, j] = old[rows, j], old[rows, i]
        return new, factor

    def regressions(self, old: Tensor, new: Tensor) -> tuple[Tensor, Tensor]:
        """`regression` of old (W, P) and of new coordinates (W, P), one after the other; that of a walker which
        has none but other reflectances, or noise, since one of the last moves is known from there."""
        whole = torch.cat([old, new])
        given = whole.clone()
        given[:, [*self.linear, *self.noise]] = 0.0
        keys = [row.tobytes() for row in given.numpy()]
        missing = {key: i for i, key in enumerate(keys) if key not in self._known}
        if missing:
            regressed = self.regression(whole[list(missing.values())])
            self._known |= dict(
                zip(missing, zip(*(tensor.unbind() for tensor in regressed), strict=True), strict=True)
            )
        centre, spread = (
            torch.stack(pieces) for pieces in zip(*(self._known[key] for key in keys), strict=True)
        )
        for key in list(self._known)[: -KEPT * len(keys)]:
            del self._known[key]
        return centre, spread

    def regression(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Mean (W, K) and lower Cholesky factor (W, K, K) of the reflectances' covariance, given the other
        columns of x (W, P).
        """
        likelihood, model = self.likelihood, self.likelihood.model
        dark, design = linear_light(model, x, self.linear)
        if likelihood.kind == "flux":
            assert self.gain is not None  # flux has one
            gain = self.gain[likelihood.curve]
            observed, sigma = likelihood.observed / gain, self.sigma / gain.abs()
            mean, factor = self._solution(dark, design, observed, sigma)
        else:
            observed = likelihood.observed_flux * 10 ** (
                0.4 * model.zero_point(model.parameter_set.from_straight(x)[0])
            )
            sigma = self.sigma / MAG_PER_LN
            mean, factor = self._solution(dark, design, observed, observed * sigma)
            for _ in range(REWEIGHTED):
                target, near = about(dark, design, mean, observed, likelihood.power)
                mean, factor = self._solution(dark, design, target, near * sigma)
        return mean, torch.linalg.cholesky_ex(WIDER * torch.cholesky_inverse(factor))[0]

    def _solution(
        self, dark: Tensor, design: Tensor, observed: Tensor, sigma: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Weighted least squares for flux = dark + design @ reflectances, with the flat prior's variance: mean
        (W, K) and lower Cholesky factor (W, K, K) of the precision.
        """
        design = design / sigma[..., None]
        middle = torch.tensor([0.25 if i in self.first else 0.5 for i in self.linear], dtype=dark.dtype)
        precision = design.mT @ design + torch.eye(len(middle), dtype=dark.dtype) / FLAT_VARIANCE
        target = design.mT @ ((observed - dark) / sigma)[..., None] + middle[:, None] / FLAT_VARIANCE
        factor, failed = torch.linalg.cholesky_ex(precision)
        diagonal = precision.diagonal(dim1=-2, dim2=-1)
        pivots = factor.diagonal(dim1=-2, dim2=-1).square()
        lost = (failed > 0) | ~(pivots > LEAST_PIVOT * diagonal).all(-1)
        if (
            lost.any()
        ):  # one row outweighs all others beyond the digits of a number; what is drawn from may be wider
            ridged = precision + torch.diag_embed(RIDGE * diagonal)
            factor = torch.where(lost[:, None, None], torch.linalg.cholesky_ex(ridged)[0], factor)
        return torch.cholesky_solve(target, factor)[..., 0], factor

    def truncated(
        self, x: Tensor, mean: Tensor, spread: Tensor, uniform: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """x (W, P) with its reflectances drawn one after the other, each within the bounds that those before
        leave it, and the log density of the draw (W,); without ``uniform`` (W, K) that of x as it is.
        """
        x = x.clone()
        deviate = torch.zeros_like(mean)
        density = torch.zeros(len(x), dtype=x.dtype)
        for index, column in enumerate(self.linear):
            sd = spread[:, index, index]
            centre = mean[:, index] + (spread[:, index, :index] * deviate[:, :index]).sum(-1)
            low, high = self._bounds(column, x)
            cut = CutNormal((low - centre) / sd, (high - centre) / sd)
            if uniform is not None:
                value = centre + sd * cut.quantile(uniform[:, index])
                x[:, column] = torch.minimum(torch.maximum(value, low), high)
            deviate[:, index] = (x[:, column] - centre) / sd
            inside = (x[:, column] >= low) & (x[:, column] <= high) & (high > low)
            density = density + torch.where(inside, cut.log_density(deviate[:, index]) - sd.log(), -math.inf)
        return x, density

    def _bounds(self, column: int, x: Tensor) -> tuple[Tensor, Tensor]:
        low, high = self.low[column].expand(len(x)), self.high[column].expand(len(x))
        if column in self.first:
            rest = 1.0 - x[:, self.first[column]]
            return low * rest, torch.minimum(high, rest) * rest
        return low, high


class CutNormal:
    """The standard normal distribution cut off at a and b, batched, without loss in its tails: an interval in
    the upper tail is looked at in the mirror.
    """

    def __init__(self, a: Tensor, b: Tensor) -> None:
        self.mirrored = a + b > 0
        self.low, self.high = torch.where(self.mirrored, -b, a), torch.where(self.mirrored, -a, b)
        self.log_low, self.log_high = log_ndtr(torch.stack([self.low, self.high])).unbind()

    def log_density(self, x: Tensor) -> Tensor:
        """At x inside [a, b]."""
        mass = self.log_high + torch.log(-torch.expm1((self.log_low - self.log_high).clamp(max=-1e-300)))
        return -0.5 * x**2 - 0.5 * math.log(2 * math.pi) - mass

    def quantile(self, p: Tensor) -> Tensor:
        """Where a share p in [0, 1) of the distribution lies below; on the logarithm of the distribution,
        by Newton's method, beyond 5 standard deviations.
        """
        share = torch.where(self.mirrored, 1.0 - p, p)
        inner = share + (1.0 - share) * torch.exp(self.log_low - self.log_high)
        log_p = self.log_high + torch.log(inner.clamp(min=1e-300))
        x = torch.special.ndtri(torch.exp(log_p.clamp(min=-600.0)))
        far = log_p < FAR_LOG_P
        if bool(far.any()):
            x = torch.where(log_p < -600.0, -torch.sqrt(-2.0 * log_p), x)
            for _ in range(4):
                x = torch.where(far, x - (log_ndtr(x) - log_p) / hazard(x), x)
        x = torch.minimum(torch.maximum(x, self.low), self.high)
        return torch.where(self.mirrored, -x, x)
