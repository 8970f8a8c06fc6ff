"""What the library does not hold, as hypotheses: a smooth function of one coordinate, or light that is there for a while.

About a minimum the residuals are linear in everything uncertain, and so they are in a curve of a coordinate: a Gaussian
process of cosines, whose evidence is in closed form once its amplitude and length are given; both are summed over a grid. What
the scene's own parameters can take up is theirs: the process is judged by what it adds to the tangent. The best curve of a
coordinate is then fitted together with the noise, for rows that it explains are no outliers.

Letters: T rows, P coordinates of the posterior, m columns, W windows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.inference.posterior import Fitted, Linear, fit
from torchlc.noise.error_law import MAG_PER_LN

ODDS = 0.05
"""That something is missing that the library does not hold, against that nothing is: one recording in twenty."""
COSINES = 12
LENGTHS = (0.08, 0.25)
"""Of the process, in shares of the coordinate's range; twelve cosines resolve the shorter."""
AMPLITUDES = (0.5, 2.0, 8.0, 32.0)
"""Of the process, in errors of a row."""
WINDOWS = (4, 8, 16, 32, 64, 128)
"""Rows of a window that light may be added in; half of each apart."""
EVENT_MAG = (0.1, 0.5)
"""Standard deviations of what an event changes, mag."""
EVENT_COSINES = 4
"""Of the course of an event within its window: it may come quickly and go slowly."""
AT_ONCE = 400
"""Windows that are weighed together: some 20 MB for a thousand rows."""
SKIPPED = ("inverse_flux", "shadow_coordinate", "glint_angle", "incidence")
"""Coordinates that others stand for, or that an effect of the library is a function of."""
EVENT = "time, for a while"


@dataclass(frozen=True)
class Discrepancy:
    """A change of the light that follows ``coordinate``, beside a hypothesis, whose log evidence was ``log_z``: what it gains of that,
    with prior odds;
    ``curve`` (T,) and its standard deviation ``band`` (T,), mag; ``rows`` (T,) where an event is."""

    beside: Hypothesis
    log_z: float
    coordinate: str
    log_gain: float
    log_odds: float
    curve: Tensor
    band: Tensor
    rows: Tensor


def discrepancies(at: Fitted, coordinates: Mapping[str, Tensor], bench: Workbench) -> list[Discrepancy]:
    """Each coordinate's best curve and the best event, beside a fit."""
    if at.noise.processes or not at.posterior.size:
        return []
    chosen = {
        name: value
        for name, value in coordinates.items()
        if not name.startswith(SKIPPED) and float(value.max() - value.min()) > 0
    }
    log_odds = math.log(ODDS / (len(chosen) + 1))
    with torch.no_grad():
        plain = fit(at.hypothesis, Linear(at), at.g[None]).laplace
        found = [_along(at, name, value, plain, log_odds) for name, value in chosen.items()]
        return [*found, _event(at, plain, log_odds)]


def process(value: Tensor, length: float) -> Tensor:
    """Columns (T, m) of a process of unit variance along a coordinate (T,)."""
    share = (value - value.min()) / (value.max() - value.min())
    order = torch.arange(1, COSINES + 1, dtype=value.dtype)
    height = torch.exp(-0.25 * (math.pi * order * length) ** 2)
    return torch.cos(math.pi * share[:, None] * order) * (
        height * math.sqrt(2) / torch.linalg.vector_norm(height)
    )


def gains(u: Tensor, tangent: Tensor, mean: Tensor, columns: Tensor) -> Tensor:
    """ln of the evidence that whitened columns (N, T, m), each times a standard normal number, add to residuals u (T,) whose
    parameters have slopes ``tangent`` (T, P) and stand at ``mean`` (P,) of a standard normal prior: (N,)."""
    size = tangent.shape[1]
    inner = torch.linalg.cholesky(torch.eye(size, dtype=u.dtype) + tangent.T @ tangent)

    def off(rows: Tensor) -> Tensor:  # the inverse of 1 + tangent tangent'
        return rows - tangent @ torch.cholesky_solve(tangent.T @ rows, inner)

    y = u - tangent @ mean
    pull = columns.mT @ off(y[:, None])
    system = columns.mT @ off(columns) + torch.eye(columns.shape[-1], dtype=u.dtype)
    factor = torch.linalg.cholesky(system)
    root = torch.linalg.solve_triangular(factor, pull, upper=False)[..., 0]
    return 0.5 * root.square().sum(-1) - torch.log(torch.diagonal(factor, dim1=-2, dim2=-1)).sum(-1)


def _along(at: Fitted, name: str, value: Tensor, plain: float, log_odds: float) -> Discrepancy:
    # of magnitudes that are compared in flux to a power the unit of a row depends on its datum, and the curve must not
    sizes = at.sigma.median() * (at.scale[:, None] if at.likelihood.kind == "mag" else 1.0)
    bases = torch.stack([process(value, length) * a * sizes for length in LENGTHS for a in AMPLITUDES])
    gain = gains(at.delta / at.sigma, at.tangent[: len(at.delta)], at.g, bases / at.sigma[:, None])
    best = int(gain.argmax())
    return _refitted(
        at, name, bases[best], plain, log_odds, float(_mean(gain) - gain[best]), torch.ones_like(value) > 0
    )


def _event(at: Fitted, plain: float, log_odds: float) -> Discrepancy:
    """Light added, or taken by a share, in a course of its own in the window that explains most: scanned with no row taken as
    an outlier."""
    seconds = at.model.assembly.context.seconds
    order = torch.argsort(seconds)
    spans = [
        order[first : first + length]
        for length in WINDOWS
        for first in range(0, max(len(order) - length + 1, 0), max(length // 2, 1))
    ] or [order]
    with torch.no_grad():
        flux = at.model.brightness(at.theta).flux.clamp(min=1e-300)
    mag = at.scale / (at.scale.new_tensor(1.0) if at.likelihood.kind == "mag" else MAG_PER_LN)
    kinds = [
        mag * size * kind for size in EVENT_MAG for kind in (1.0, (flux.median() / flux).clamp(max=100.0))
    ]
    tangent = at.slopes / at.wide[:, None]

    def columns(span: Tensor) -> Tensor:
        return at.delta.new_zeros(len(seconds), EVENT_COSINES).index_copy(0, span, course(seconds[span]))

    gain = []
    for some in (spans[first : first + AT_ONCE] for first in range(0, len(spans), AT_ONCE)):
        shapes = torch.stack([columns(span) for span in some])
        gain.append(
            torch.stack(
                [
                    gains(at.delta / at.wide, tangent, at.g, shapes * (kind / at.wide)[:, None])
                    for kind in kinds
                ]
            )
        )
    gain = torch.cat(gain, 1)
    kind, place = divmod(int(gain.argmax()), len(spans))
    inside = torch.zeros_like(seconds, dtype=torch.bool).index_fill(0, spans[place], True)
    basis = columns(spans[place]) * kinds[kind][:, None]
    return _refitted(
        at, EVENT, basis, plain, log_odds, float(_mean(gain.flatten()) - gain[kind, place]), inside
    )


def course(seconds: Tensor) -> Tensor:
    """Columns (T, EVENT_COSINES) of an event between the first and last of ascending times (T,): a constant, and cosines of
    falling size, together of unit variance."""
    share = (seconds - seconds[0]) / (seconds[-1] - seconds[0]).clamp(min=1e-9)
    order = torch.arange(EVENT_COSINES, dtype=seconds.dtype)
    height = 1 / (1 + order)
    return torch.cos(math.pi * share[:, None] * order) * height / torch.linalg.vector_norm(height)


def _mean(gain: Tensor) -> Tensor:
    return torch.logsumexp(gain, 0) - math.log(len(gain))


def _refitted(
    at: Fitted, name: str, basis: Tensor, plain: float, log_odds: float, spread: float, rows: Tensor
) -> Discrepancy:
    """The basis fitted together with the noise; ``spread`` is ln of the mean evidence of its grid over the best."""
    posterior = Linear(at, basis)
    start = torch.cat([at.g, at.g.new_zeros(basis.shape[1])])
    wide = at.wide
    tangent = torch.cat([at.slopes, -basis], 1) / wide[:, None]
    system = tangent.T @ tangent + torch.eye(tangent.shape[1], dtype=wide.dtype)
    step = torch.linalg.solve(system, tangent.T @ (at.delta / wide) + start)
    other = start - step
    other[at.posterior.noise_columns] = start[at.posterior.noise_columns]
    found = max(
        (fit(at.hypothesis, posterior, one[None]) for one in (start, other)), key=lambda one: one.laplace
    )
    own = slice(posterior.first, posterior.size)
    unit = at.scale
    curve = basis @ found.g[own] / unit
    band = (
        torch.sqrt(torch.einsum("tm,mn,tn->t", basis, found.covariance[own, own], basis).clamp(min=0)) / unit
    )
    return Discrepancy(
        at.hypothesis, at.log_z, name, found.laplace - plain + spread, log_odds, curve, band, rows
    )
