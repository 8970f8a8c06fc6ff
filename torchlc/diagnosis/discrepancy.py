"""What the library does not hold, as hypotheses: a smooth function of one coordinate, the whole time or on one side of an
instant; something that repeats with a period of its own; an event. Each adds light, or takes a share of it.

About a minimum the residuals are linear in everything uncertain, and so they are in a curve of a coordinate: a Gaussian
process of cosines, whose evidence is in closed form once its amplitude and length are given; both are summed over a grid. What
the scene's own parameters can take up is theirs: the process is judged by what it adds to the tangent. The best curve of a
kind is then fitted together with the noise, for rows that it explains are no outliers.

Letters: T rows, P coordinates of the posterior, N shapes, m columns of each, L rows of a window.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchlc.diagnosis.coordinates import in_words
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.inference.density import Fitted, Linear
from torchlc.inference.posterior import fit

ODDS = 0.05
"""That something is missing that the library does not hold, against that nothing is: one recording in twenty."""
COSINES = 32
LENGTHS = (0.03, 0.08, 0.25)
"""Of the process, in shares of the coordinate's range; the cosines resolve the shortest."""
AMPLITUDES = (0.5, 2.0, 8.0, 32.0, 128.0)
"""Of the process, in errors of a row."""
INSTANTS = 8
"""Equal parts of the rows between which something may come or go."""
WINDOWS = (16, 32, 64, 128)
"""Rows of an event, a quarter of each apart: few bad rows in a run are none."""
EVENT_COSINES = 8
"""Of the course of an event within its window: it may come quickly and go slowly."""
HARMONICS = 8
CYCLE_LENGTHS = (0.04, 0.12)
"""Of what repeats, in shares of its period; the harmonics resolve the shorter."""
FEWEST_CYCLES, MOST_CYCLES, ROWS_A_CYCLE = 2.0, 200.0, 5
"""Of what repeats, within a recording, as far as that has as many rows a cycle."""
CYCLE_STEP = 1 / HARMONICS
"""Between periods, in cycles of a recording: the highest harmonic turns once over it."""
FAR = 6.0
"""Errors beyond which a row counts as that many while curves are compared: a bad row is one row, and a run of them may be
something else."""
AT_ONCE = 4_000_000
"""Numbers in the columns that are weighed together, 32 MB."""
REFITTED = 4
"""Kinds that are fitted together with the noise, those of most evidence where a row counts as FAR errors at most."""
SKIPPED = ("inverse_flux", "shadow_coordinate", "glint_angle", "incidence")
"""Coordinates that others stand for, or that an effect of the library is a function of."""
EVENT, REPEATING = "time, for a while", "time, again and again"


@dataclass(frozen=True)
class Discrepancy:
    """A change of the light that follows ``coordinate``, beside a hypothesis, whose log evidence was ``log_z``: what it gains of that,
    with prior odds; ``curve`` (T,) and its standard deviation ``band`` (T,), mag; ``rows`` (T,) where it is; ``period`` in
    seconds of what repeats, else 0; ``errors`` (T,) of the rows beside it, in the unit of the residuals. Where a fit ``like`` it is what shows the curve, ``words`` say what that is."""

    beside: Hypothesis
    log_z: float
    coordinate: str
    log_gain: float
    log_odds: float
    curve: Tensor
    band: Tensor
    rows: Tensor
    period: float = 0.0
    like: Fitted | None = None
    words: str = ""
    errors: Tensor | None = None

    def course(self, seconds: Tensor) -> str:
        """What it follows, in words; ``seconds`` (T,) count from the first row."""
        if self.words:
            return self.words
        if self.coordinate == REPEATING:
            return f"comes again every {self.period / 60:.3g} min"
        first, last = (
            float(instant) / 3600 for instant in (seconds[self.rows].min(), seconds[self.rows].max())
        )
        if self.coordinate == EVENT:
            return f"is there from {first:.2f} to {last:.2f} h after the first row"
        text = f"changes with {in_words(self.coordinate)}"
        if bool(self.rows.all()):
            return text
        return f"{text}, {f'from {first:.2f} h' if first > 0 else f'until {last:.2f} h'} after the first row"


@dataclass(frozen=True)
class Shapes:
    """Shapes of one kind, at rows ``index`` (N, L): columns (N, L, m) whose squares sum to 1 in the mean; ``periods`` (N,) in
    seconds, of what repeats."""

    index: Tensor
    columns: Tensor
    periods: Tensor | None = None

    def inside(self, shape: int, rows: int) -> tuple[Tensor, Tensor]:
        """Columns (T, m) of one shape, and where it is (T,)."""
        empty = self.columns.new_zeros(rows, self.columns.shape[-1])
        where = torch.zeros(rows, dtype=torch.bool).index_fill(0, self.index[shape], True)
        return empty.index_copy(0, self.index[shape], self.columns[shape]), where


@dataclass(frozen=True)
class Found:
    """The best of many shapes: ``gain`` in log evidence over all of them, and over it alone; its columns (T, m) in the unit of
    the residuals."""

    gain: float
    alone: float
    columns: Tensor
    rows: Tensor
    period: float


def discrepancies(at: Fitted, coordinates: Mapping[str, Tensor], bench: Workbench) -> list[Discrepancy]:
    """The best curve beside a fit of each of the most likely kinds: along each coordinate, all the time and on one side of an
    instant; again and again; for a while."""
    if at.noise.processes or not at.posterior.size:
        return []
    if not math.isfinite(
        float((at.wide / at.scale).median())
    ):  # without light in the model a curve beside it has no magnitude
        return []
    seconds = at.model.assembly.context.seconds
    chosen = {
        name: value
        for name, value in coordinates.items()
        if not name.startswith(SKIPPED) and float(value.max() - value.min()) > 0
    }
    with torch.no_grad():
        plain = fit(at.hypothesis, Linear(at), at.g[None]).laplace
        scan = Scan(at)
        scanned = [(name, scan.best([along(value)])) for name, value in chosen.items()]
        scanned += [(name, scan.best(one_side(value, seconds))) for name, value in chosen.items()]
        scanned += [(REPEATING, scan.repeating(seconds)), (EVENT, scan.best(windows(seconds)))]
        kinds = [(name, best) for name, best in scanned if best is not None]
        if not kinds:  # all rows are of one moment
            return []
        log_odds = math.log(ODDS / len(kinds))
        kinds.sort(key=lambda kind: -kind[1].gain)
        return [_refitted(at, scan.sigma, name, best, plain, log_odds) for name, best in kinds[:REFITTED]]


# ------------------------------------------------------------------ shapes


def process(value: Tensor, length: float) -> Tensor:
    """Columns (T, m) of a process of unit variance along a coordinate (T,)."""
    share = (value - value.min()) / (value.max() - value.min())
    order = torch.arange(1, COSINES + 1, dtype=value.dtype)
    height = torch.exp(-0.25 * (math.pi * order * length) ** 2)
    return torch.cos(math.pi * share[:, None] * order) * (
        height * math.sqrt(2) / torch.linalg.vector_norm(height)
    )


def along(value: Tensor) -> Shapes:
    """Along a coordinate (T,), all the time."""
    columns = torch.stack([process(value, length) for length in LENGTHS])
    return Shapes(torch.arange(len(value)).expand(len(LENGTHS), -1), columns)


def one_side(value: Tensor, seconds: Tensor) -> Iterator[Shapes]:
    """Along a coordinate (T,), before or after an instant."""
    columns = torch.stack([process(value, length) for length in LENGTHS])
    rank = torch.argsort(torch.argsort(seconds))
    edges = torch.linspace(0, len(seconds), INSTANTS + 1)[1:-1].round().long()
    for edge in torch.unique(edges[(edges > 0) & (edges < len(seconds))]):
        for side in (rank < edge, rank >= edge):
            index = torch.nonzero(side)[:, 0]
            yield Shapes(index.expand(len(LENGTHS), -1), columns[:, index])


def cycles(seconds: Tensor, count: Tensor) -> Shapes:
    """What repeats, ``count`` (N,) times within the recording: harmonics of falling size."""
    order = torch.arange(1, HARMONICS + 1, dtype=seconds.dtype)
    share = (seconds - seconds.min()) / (seconds.max() - seconds.min()).clamp(min=1e-9)
    angle = 2 * math.pi * count[:, None, None] * share[:, None] * order
    waves = torch.cat([torch.cos(angle), torch.sin(angle)], -1)
    heights = [torch.exp(-0.5 * (2 * math.pi * order * length) ** 2) for length in CYCLE_LENGTHS]
    columns = torch.cat([waves * (h / torch.linalg.vector_norm(h)).repeat(2) for h in heights])
    periods = (seconds.max() - seconds.min()) / count
    return Shapes(
        torch.arange(len(seconds)).expand(len(columns), -1), columns, periods.repeat(len(CYCLE_LENGTHS))
    )


def windows(seconds: Tensor) -> Iterator[Shapes]:
    """Events: each length of window at all its places."""
    order = torch.argsort(seconds)
    for length in (length for length in WINDOWS if length <= len(order)):
        index = order.unfold(0, length, max(length // 4, 1))
        yield Shapes(index, course(seconds[index]))


def course(seconds: Tensor) -> Tensor:
    """Columns (..., L, EVENT_COSINES) of an event between the first and last of ascending times (..., L): a constant, and
    cosines of falling size, together of unit variance."""
    first, last = seconds[..., :1], seconds[..., -1:]
    share = (seconds - first) / (last - first).clamp(min=1e-9)
    order = torch.arange(EVENT_COSINES, dtype=seconds.dtype)
    height = 1 / (1 + order)
    return torch.cos(math.pi * share[..., None] * order) * height / torch.linalg.vector_norm(height)


# ------------------------------------------------------------------ their evidence


class Projection:
    """Whitened residuals u (T,) whose parameters, with a standard normal prior, have slopes ``tangent`` (T, P) and stand at
    ``mean`` (P,)."""

    def __init__(self, u: Tensor, tangent: Tensor, mean: Tensor) -> None:
        self.tangent = tangent
        self.inner = torch.linalg.cholesky(torch.eye(tangent.shape[1], dtype=u.dtype) + tangent.T @ tangent)
        y = u - tangent @ mean
        self.left = y - tangent @ torch.cholesky_solve(tangent.T @ y[:, None], self.inner)[:, 0]

    def gains(self, columns: Tensor, amplitudes: Tensor, index: Tensor | None = None) -> Tensor:
        """ln of the evidence that whitened columns (N, L, m), times an amplitude (A,) and a standard normal number each, add at
        rows ``index`` (N, L), or at all: (A, N)."""
        left, tangent = (
            (self.left, self.tangent) if index is None else (self.left[index], self.tangent[index])
        )
        across = tangent.mT @ columns
        gram = columns.mT @ columns - across.mT @ torch.cholesky_solve(across, self.inner)
        size, turn = torch.linalg.eigh(gram)
        pull = (turn.mT @ (columns.mT @ left[..., None]))[..., 0]
        spread = amplitudes[:, None, None] ** 2 * size.clamp(min=0)
        return 0.5 * ((amplitudes[:, None, None] * pull).square() / (1 + spread) - torch.log1p(spread)).sum(
            -1
        )


class Scan:
    """The best of many shapes beside a fit, each as a share of the light and as light of its own, at every amplitude."""

    def __init__(self, at: Fitted) -> None:
        off = (at.delta / at.wide).abs()
        self.sigma = at.wide * (off / FAR).clamp(min=1.0)
        self.projection = Projection(at.delta / self.sigma, at.slopes / self.sigma[:, None], at.g)
        flux = at.model.brightness(at.theta).flux.clamp(min=1e-300)
        error_mag = (at.wide / at.scale).median()
        # of magnitudes that are compared in flux to a power the unit of a row depends on its datum, and the curve must not
        self.units = [
            at.scale * error_mag * kind
            for kind in (torch.ones_like(flux), (flux.median() / flux).clamp(max=100.0))
        ]
        self.amplitudes = at.delta.new_tensor(AMPLITUDES)

    def best(self, kinds: Iterator[Shapes] | list[Shapes]) -> Found | None:
        """Of all shapes, by their evidence."""
        every: list[Tensor] = []
        top: tuple[float, Shapes, int, Tensor] | None = None
        for shapes in kinds:
            count = max(AT_ONCE // shapes.columns[0].numel(), 1)
            for first in range(0, len(shapes.columns), count):
                some = slice(first, first + count)
                index = shapes.index[some]
                for unit in self.units:
                    white = shapes.columns[some] * (unit / self.sigma)[index][..., None]
                    gain = self.projection.gains(white, self.amplitudes, index)
                    every.append(gain.flatten())
                    size, shape = divmod(int(gain.argmax()), gain.shape[1])
                    if top is None or float(gain[size, shape]) > top[0]:
                        basis = unit * self.amplitudes[size]
                        top = (float(gain[size, shape]), shapes, first + shape, basis)
        if top is None:
            return None
        alone, shapes, shape, unit = top
        gain = torch.cat(every)
        columns, rows = shapes.inside(shape, len(unit))
        period = 0.0 if shapes.periods is None else float(shapes.periods[shape])
        mean = float(torch.logsumexp(gain, 0)) - math.log(len(gain))
        return Found(mean, alone, columns * unit[:, None], rows, period)

    def repeating(self, seconds: Tensor) -> Found | None:
        """Over all periods, then more finely about the best."""
        span = float(seconds.max() - seconds.min())
        most = min(MOST_CYCLES, len(seconds) / ROWS_A_CYCLE)
        if most <= FEWEST_CYCLES or span <= 0:
            return None
        count = torch.arange(FEWEST_CYCLES, most, CYCLE_STEP, dtype=seconds.dtype)
        coarse = self.best(cycles(seconds, some) for some in count.split(64))
        assert coarse is not None  # there is a period at least
        near = span / coarse.period + CYCLE_STEP * torch.linspace(-1, 1, 17, dtype=seconds.dtype)
        finer = self.best([cycles(seconds, near)])
        assert finer is not None
        # the places between are as many more
        return replace(finer, gain=max(coarse.gain, finer.alone + coarse.gain - coarse.alone))


def _refitted(
    at: Fitted, bounded: Tensor, name: str, best: Found, plain: float, log_odds: float
) -> Discrepancy:
    """The best shape fitted together with the noise, from where the scene's own model stands and from where errors are ``bounded``
    (T,), as in a scan."""
    basis = best.columns
    posterior = Linear(at, basis)
    start = torch.cat([at.g, at.g.new_zeros(basis.shape[1])])
    tangent = torch.cat([at.slopes, -basis], 1) / bounded[:, None]
    system = tangent.T @ tangent + torch.eye(tangent.shape[1], dtype=bounded.dtype)
    step = torch.linalg.solve(system, tangent.T @ (at.delta / bounded) + start)
    other = start - step
    other[at.posterior.noise_columns] = start[at.posterior.noise_columns]
    fitted = max(
        (fit(at.hypothesis, posterior, begin[None]) for begin in (start, other)),
        key=lambda candidate: candidate.laplace,
    )
    amplitudes = slice(posterior.first, posterior.size)
    unit = at.scale
    curve = basis @ fitted.g[amplitudes] / unit
    band = (
        torch.sqrt(
            torch.einsum("tm,mn,tn->t", basis, fitted.covariance[amplitudes, amplitudes], basis).clamp(min=0)
        )
        / unit
    )
    gain = fitted.laplace - plain + best.gain - best.alone
    found = Discrepancy(at.hypothesis, at.log_z, name, gain, log_odds, curve, band, best.rows, best.period)
    return replace(found, errors=fitted.wide)
