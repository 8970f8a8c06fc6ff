"""Places of the grid made better by least squares, with the light of facets and the reflectances profiled.

Each pass has its phase and its frequency, so nothing is said here of turns between passes, nor of whether the period
changes. Letters: S starts, N passes, T rows, P coordinates, L lobes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.inference.rotation.facet_light import ROUND, FacetLight
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.pole_grid import GridState, frame_of
from torchlc.tensors.least_squares import Minimum, minimise
from torchlc.tensors.non_negative import non_negative
from torchlc.tensors.vectors import unit

START_N = 40.0
"""A lobe 9 deg wide: narrower ones have no slope where no glint is."""
LEAST_N, MOST_N = 2.0, 2000.0
"""Wider is as diffuse light; narrower falls between the facets of a turn that is sampled."""
FAINT = math.log(100.0)
"""ln of the ratio to the datum beyond which a dark model counts no more."""
STAGES = ((0.25, 0.5), (0.25, 0.25), (0.5, 0.25))
"""Parts of the iterations, and the share of the starts that is kept after each: what is far above others after a quarter of
them does not end below."""
LEAST_KEPT = 6
"""Starts, whatever share is kept."""
MOST_TILT = math.radians(30.0)
"""Beyond, it is another axis of the body that the spin is about."""
PHASE_FLOOR = 2e-3
"""Error of a phase, turns, that the light of facets has of itself."""


@dataclass(frozen=True)
class Local:
    """A least squares solution: unit ``pole`` (3,), ``frequencies`` (N,), 1/s, and ``phases`` (N,), turns, at the passes'
    middles, ``tilt`` (3,) rad, exponents (L,), reflectances (K,); ``chi2`` with the floor of errors; ``covariance``
    (2 N, 2 N) of frequencies and phases; ``own_error`` of a phase, turns, that the light compared with has of itself."""

    pole: Tensor
    frequencies: Tensor
    phases: Tensor
    tilt: Tensor
    exponents: Tensor
    weights: Tensor
    chi2: float
    covariance: Tensor
    own_error: float = PHASE_FLOOR

    @property
    def frequency(self) -> float:
        """Mean over the passes."""
        return float(self.frequencies.mean())


def free_tilts(body: FacetLight) -> list[int]:
    """Components of the tilt that a body shows: not that along z, which is a phase, nor that about an axis round which
    the body looks the same; of a body that is round about z one of two, since the other is a phase."""
    axes = torch.eye(3, dtype=torch.float64)
    shown = [component for component in (0, 1) if body.symmetry(axes[component]) < ROUND]
    return shown[:1] if body.symmetry(axes[2]) == ROUND else shown


class Refiner:
    """Least squares of many starts; ``floor`` is the relative error that the light of facets has. ``tilted``: the components of
    the tilt that are free, none, or those of :func:`free_tilts`."""

    def __init__(self, rows: Rows, body: FacetLight, floor: float, *, tilted: Sequence[int] = ()) -> None:
        self.rows, self.body, self.tilted = rows, body, list(tilted)
        self.lobes = sum(body.lobed)
        self.sigma = torch.sqrt(rows.error**2 + floor**2)
        self.span = rows.span.clamp(min=1e-3 * float(rows.span.max().clamp(min=1e-3)))
        self.positive = rows.flux > 0
        self.log_flux = torch.log(torch.where(self.positive, rows.flux, 1.0))

    def refined(
        self, starts: Sequence[GridState], tilts: Sequence[Tensor], iterations: int = 25
    ) -> list[Local]:
        """Solutions of the starts that went down most, the best first."""
        rows = self.rows
        poles = torch.stack([state.pole for state in starts])
        begin = torch.stack(
            [
                torch.cat(
                    [
                        torch.zeros(2 + rows.passes, dtype=torch.float64),
                        torch.tensor(state.phases, dtype=torch.float64),
                        torch.full((self.lobes,), math.log(START_N), dtype=torch.float64),
                        tilt[self.tilted],
                    ]
                )
                for state, tilt in zip(starts, tilts, strict=True)
            ]
        )
        base = torch.tensor([state.frequencies for state in starts], dtype=torch.float64)
        left = list(range(len(starts)))
        best: dict[int, Minimum] = {}
        for part, kept in STAGES:
            for k in left:

                def residual(y: Tensor, k: int = k) -> Tensor:
                    return torch.cat([self._residual(y, poles[k], base[k])[0], self._changes(y, base[k])], -1)

                low, high = self._bounds(begin[k])
                start = best[k].y if k in best else begin[k : k + 1]
                count = max(1, round(iterations * part))
                best[k] = minimise(residual, start, low, high, iterations=count, tolerance=1e-4)
            left = sorted(left, key=lambda k: float(best[k].cost[0]))[
                : max(LEAST_KEPT, round(len(starts) * kept))
            ]
        return sorted(
            (
                self._local(best[k].y[0], poles[k], base[k], float(best[k].cost[0]), best[k].jacobian[0])
                for k in left
            ),
            key=lambda solution: solution.chi2,
        )

    def _bounds(self, begin: Tensor) -> tuple[Tensor, Tensor]:
        low, high = torch.full_like(begin, -math.inf), torch.full_like(begin, math.inf)
        phases = 2 + 2 * self.rows.passes
        low[:2], high[:2] = -2.0, 2.0
        low[2 : 2 + self.rows.passes], high[2 : 2 + self.rows.passes] = -3.0, 3.0
        low[phases : phases + self.lobes] = math.log(LEAST_N)
        high[phases : phases + self.lobes] = math.log(MOST_N)
        low[phases + self.lobes :], high[phases + self.lobes :] = -MOST_TILT, MOST_TILT
        return low, high

    def _split(self, y: Tensor, pole: Tensor, frequency: Tensor) -> tuple[Tensor, ...]:
        """Pole (B, 3), frequencies (B, N), phases (B, N), exponents (B, L), tilt (B, 3) of coordinates (B, P)."""
        frame = frame_of(pole)
        moved = unit(pole + y[:, :1] * frame[0] + y[:, 1:2] * frame[1])
        middle = 2 + self.rows.passes
        phases = middle + self.rows.passes
        tilt = torch.zeros_like(y[:, :3])
        tilt[:, self.tilted] = y[:, phases + self.lobes :]
        exponent = torch.exp(y[:, phases : phases + self.lobes])
        return moved, frequency + y[:, 2:middle] / self.span, y[:, middle:phases], exponent, tilt

    def _changes(self, y: Tensor, frequency: Tensor) -> Tensor:
        """Differences (B, N - 1) of the frequencies from that of the longest pass, over their standard deviations."""
        frequencies = frequency + y[:, 2 : 2 + self.rows.passes] / self.span
        longest = self.rows.longest
        others = [passed for passed in range(self.rows.passes) if passed != longest]
        sd = (self.rows.drift * frequency[longest]).clamp(min=1e-12)
        return (frequencies[:, others] - frequencies[:, longest, None]) / sd[others]

    def _residual(self, y: Tensor, pole: Tensor, frequency: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals (B, T) in units of their errors, and reflectances (B, K)."""
        return self.compared(self._light(*self._split(y, pole, frequency)))

    def _light(
        self, pole: Tensor, frequency: Tensor, phases: Tensor, exponent: Tensor, tilt: Tensor
    ) -> Tensor:
        """Columns of light (B, T, K)."""
        rows = self.rows
        elapsed = rows.seconds - rows.middle[rows.number]
        angle = 2 * math.pi * (phases[:, rows.number] + frequency[:, rows.number] * elapsed)
        frame = frame_of(pole)
        turn = rotation_of(tilt).mT if self.tilted else None
        cos, sin = torch.cos(angle), torch.sin(angle)

        def in_body(way: Tensor) -> Tensor:
            x, y, z = torch.einsum("bij,tj->bti", frame, way).unbind(-1)
            seen = torch.stack([cos * x + sin * y, cos * y - sin * x, z], -1)
            return seen if turn is None else torch.einsum("bij,btj->bti", turn, seen)

        return self.body.light(in_body(rows.to_sun), in_body(rows.to_observer), exponent[:, None])

    def compared(self, light: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals (B, T) and reflectances (B, K) of columns of light (B, T, K)."""
        rows = self.rows
        weight = 1 / (self.sigma * rows.flux.abs())
        weights = torch.zeros_like(light[:, 0])
        model = torch.zeros_like(light[..., 0])
        for turn in range(2):  # the second about the first, so that it is one of magnitudes
            about = (
                weight if turn == 0 else weight * (rows.flux.abs() / torch.maximum(model, rows.flux.abs()))
            )
            columns = light * about[..., None]
            target = (rows.flux * about)[..., None].expand(*columns.shape[:-1], 1)
            weights = non_negative(columns.mT @ columns, (columns.mT @ target)[..., 0])
            model = (light @ weights[..., None])[..., 0]
        if rows.scaled:
            for passed in range(rows.passes):
                here = rows.of(passed)
                part, data = model[:, here] * weight[here], rows.flux[here] * weight[here]
                gain = (part * data).sum(-1) / part.square().sum(-1).clamp(min=1e-30)
                model = model.index_copy(1, here, model[:, here] * gain[:, None])
        bright = model > rows.flux.abs() * math.exp(-FAINT)
        ratio = torch.log(torch.where(bright & self.positive, model, 1.0)) - self.log_flux
        below = (model / rows.flux.abs().clamp(min=1e-300)) * math.exp(FAINT) - 1 - FAINT
        return torch.where(bright & self.positive, ratio, below.clamp(max=FAINT)) / self.sigma, weights

    def _local(self, y: Tensor, pole: Tensor, frequency: Tensor, cost: float, jacobian: Tensor) -> Local:
        with torch.no_grad():
            moved, turning, phases, exponent, tilt = self._split(y[None], pole, frequency)
            _, weights = self._residual(y[None], pole, frequency)
        normal = jacobian.T @ jacobian
        scale = torch.sqrt(torch.diagonal(normal).clamp(min=1e-12))
        inverse = torch.linalg.pinv(normal / scale[:, None] / scale, hermitian=True) / scale[:, None] / scale
        count = self.rows.passes
        kept = slice(2, 2 + 2 * count)
        unit_of = torch.cat([1 / self.span, torch.ones_like(self.span)])
        covariance = inverse[kept, kept] * unit_of[:, None] * unit_of
        return Local(moved[0], turning[0], phases[0], tilt[0], exponent[0], weights[0], cost, covariance)
