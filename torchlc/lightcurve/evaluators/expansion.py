"""Tables of a free geometry as polynomials about a reference geometry.

Sums of lobes and of diffuse light change smoothly with a geometry: near a glint the logarithm of a lobe is a parabola in any
angle. So their logarithms, at every exponent of the tables and in every row, are expanded to second order in the d numbers
that move the geometry, from exact tables at 1 + 2 d + d (d - 1) / 2 geometries. A call then adds up some rows of these
tables, whatever effects are on: shadows, the Sun's disc and exposures are in them. What is not smooth stays out: the Earth's
shadow is worked out from expanded positions; a facet that rises or sets, or a shadow's edge that reaches a corner, is what
is left, and is measured.

Letters: d numbers of the geometry, S stencil, M monomials, C columns, G exponents.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import combinations

import torch
from torch import Tensor

from torchlc.lightcurve.evaluators.contract import Evaluator, condensed, put
from torchlc.lightcurve.evaluators.exact import ExactGeometry
from torchlc.lightcurve.tables import Key, Record, Tables
from torchlc.stages.light import Brightness, Sky, Surface
from torchlc.tensors.autodiff_state import apart, transformed

STEP = 2.0
"""Standard deviations between the geometries of the stencil: the cubic term that is left out is then at most as large
within 2.3 of them as it is 2 from the middle."""
MOST_MAG = 2e-3
"""Largest error that an expansion may have, with that of the exact light."""
LEAST_REACH = 1.5
"""Standard deviations within which it has to keep that, to be of use."""
HELD_OUT = 24
"""Geometries at which the error is measured, spread evenly over the reach. At 300 draws of each posterior of the tests, which
lie nearer, light was at most 0.45 times as far off, or by no more than the exact light itself."""
MOST_NUMBERS = 12
"""Numbers of the geometry, for which 91 exact tables are made."""
NEGLIGIBLE = 2e-5
"""Term of a logarithm, at the end of the reach, below which it is left out."""
DARK = -600.0
"""Logarithm that tables of lobes hold where there is no light."""
FAINT = 1e-6
"""Share of the brightest row below which a row's error is not counted."""


class UnsuitableError(ValueError):
    """Why a geometry cannot be expanded, in words."""


class Expansion(Evaluator):
    """Second order about theta (P,), for values within ``reach`` standard deviations, of covariance ``scale`` (P, P); beyond
    them light is exact. ``own_error_mag`` is the largest difference from the exact light at HELD_OUT geometries within the
    reach, between those of the stencil, with materials about those of theta as ``scale`` has them, in rows of at least FAINT of the brightest;
    ``error_mag`` has that of the exact light too.

    Raises UnsuitableError where it would be of no use.
    """

    way = "expanded"

    def __init__(self, exact: Evaluator, theta: Tensor, scale: Tensor) -> None:
        super().__init__(exact.pipeline)
        self.exact = exact
        self.theta = theta.detach().clone()
        self._check()
        self.columns = torch.as_tensor(self.assembly.geometry_columns, device=theta.device)
        low = theta.new_tensor([self.parameters.free[k].prior.low for k in self.assembly.geometry_columns])
        at = self.theta[self.columns]
        block = scale.detach()[self.columns[:, None], self.columns]
        spread = torch.sqrt(torch.diagonal(block))
        if not bool((torch.isfinite(spread) & (spread > 0)).all()):
            raise UnsuitableError("a number that moves the geometry has no scale: it stands at a bound")
        self.positive = (low >= 0) & (at > 3 * spread)
        """Numbers that are expanded in their logarithm, as areas are products of sizes."""
        slope = torch.where(self.positive, 1 / torch.where(self.positive, at, 1.0), 1.0)
        factor, failed = torch.linalg.cholesky_ex(block * slope[:, None] * slope)
        if int(failed):
            raise UnsuitableError("the scale of the geometry is no covariance")
        self.spread = (
            torch.nan_to_num(torch.diagonal(scale.detach()), nan=0.0, posinf=0.0).clamp(min=0).sqrt()
        )
        self.factor = factor
        self.centre = self._unscaled(at)
        count = len(at)
        self.pairs = list(combinations(range(count), 2))
        self.reach = math.sqrt(count) + 3.0
        self._kept: dict[bool, tuple[Tables, Tables]] = {}
        with apart():
            self._measure()

    def _check(self) -> None:
        a = self.assembly
        if not a.geometry_columns:
            raise UnsuitableError("no free number moves the geometry")
        if a.learns_geometry:
            raise UnsuitableError("an effect learns the geometry")
        if isinstance(self.exact, ExactGeometry) and self.exact.areas_alone:
            raise UnsuitableError("free numbers scale areas alone, which costs no more without it")
        if len(a.geometry_columns) > MOST_NUMBERS:
            raise UnsuitableError(f"more than {MOST_NUMBERS} numbers move the geometry")
        if a.stage("scatter"):
            raise UnsuitableError("light that parts scatter at one another is no table")
        rough = [name for name, law in a.models.items() if not law.additive and not self.condensable(name)]
        if rough:
            raise UnsuitableError(f"the lobe of {rough[0]} has no table over its exponent")
        jumping = [effect.name for effect in a.effects if effect.jumps(a.context) is not None]
        if jumping:
            raise UnsuitableError(f"{jumping[0]} moves in jumps")

    # ------------------------------------------------------------------ coordinates

    def _unscaled(self, numbers: Tensor) -> Tensor:
        safe = torch.where(self.positive, numbers, 1.0).clamp(min=1e-300)
        return torch.where(self.positive, torch.log(safe), numbers)

    def coordinates(self, theta: Tensor) -> Tensor:
        """Standard deviations (..., d) from the reference, along axes that do not covary."""
        offset = self._unscaled(theta[..., self.columns]) - self.centre
        return torch.linalg.solve_triangular(self.factor, offset[..., None], upper=False)[..., 0]

    def theta_at(self, u: Tensor, theta: Tensor | None = None) -> Tensor:
        """theta (..., P) with the geometry at coordinates u (..., d)."""
        numbers = self.centre + u @ self.factor.mT
        numbers = torch.where(self.positive, torch.exp(torch.where(self.positive, numbers, 0.0)), numbers)
        theta = self.theta if theta is None else theta
        return theta.expand(*u.shape[:-1], -1).clone().index_copy(-1, self.columns, numbers)

    def served(self, theta: Tensor) -> Tensor:
        """Which theta (..., P) are within the reach, (...)."""
        u = self.coordinates(theta.detach())
        return torch.nan_to_num(u.square().sum(-1), nan=math.inf) <= self.reach**2

    # ------------------------------------------------------------------ polynomials

    def _stencil(self) -> Tensor:
        """Coordinates (S, d): the middle, a step either way, a step along two axes at once."""
        d = len(self.columns)
        eye = STEP * torch.eye(d, dtype=self.theta.dtype, device=self.theta.device)
        both = [eye[i] + eye[j] for i, j in self.pairs]
        return torch.stack([torch.zeros_like(self.centre), *eye, *-eye, *both])

    def _coefficients(self, values: Tensor) -> Tensor:
        """Coefficients (M, ...) of monomials 1, u_i, u_i^2, u_i u_j from values (S, ...) of the stencil."""
        d = len(self.columns)
        middle, ahead, behind, both = (
            values[:1],
            values[1 : d + 1],
            values[d + 1 : 2 * d + 1],
            values[2 * d + 1 :],
        )
        cross = [
            (both[k] - ahead[i] - ahead[j] + middle[0])[None] / STEP**2 for k, (i, j) in enumerate(self.pairs)
        ]
        first, second = (ahead - behind) / (2 * STEP), (ahead - 2 * middle + behind) / (2 * STEP**2)
        return torch.cat([middle, first, second, *cross])

    def monomials(self, theta: Tensor) -> Tensor:
        """The monomials (..., M) at theta (..., P)."""
        u = self.coordinates(theta)
        cross = [(u[..., i] * u[..., j])[..., None] for i, j in self.pairs]
        return torch.cat([torch.ones_like(u[..., :1]), u, u * u, *cross], -1)

    # ------------------------------------------------------------------ tables

    def tables(self, detail: bool) -> tuple[Tables, Tables]:
        """Tables of coefficients, and the tables of the reference that they are of."""
        if detail not in self._kept:
            with apart():
                made = [self._exact_tables(theta, detail) for theta in self.theta_at(self._stencil())]
            self._kept[detail] = self._expanded(made), made[0]
        return self._kept[detail]

    def _exact_tables(self, theta: Tensor, detail: bool) -> Tables:
        made = self.pipeline.make_tables(self.pipeline.view(self.values(theta)), detail, compact=True)
        return replace(made, surfaces=tuple(condensed(surface) for surface in made.surfaces))

    def _expanded(self, made: list[Tables]) -> Tables:
        several: dict[Key, list[Surface | None]] = {}
        for number, tables in enumerate(made):
            for surface in tables.surfaces:
                key = surface.component, surface.material, surface.sunlit, surface.scale
                several.setdefault(key, [None] * len(made))[number] = surface
        surfaces = tuple(self._surface(surfaces) for surfaces in several.values())
        sky = made[0].sky
        state, nodes = (
            self._record([getattr(entry.sky, name) for entry in made]) for name in ("state", "nodes")
        )
        return replace(made[0], surfaces=surfaces, sky=replace(sky, state=state, nodes=nodes))

    def _surface(self, surfaces: list[Surface | None]) -> Surface:
        known = next(surface for surface in surfaces if surface is not None)
        table = {}
        for name, like in known.table.items():
            blank = torch.full_like(like, DARK) if name == "lobes" else torch.zeros_like(like)
            if name == "lobes":
                blank.unflatten(0, (-1, 2))[:, 1] = 0.0
            values = torch.stack([blank if surface is None else surface.table[name] for surface in surfaces])
            table |= self._lobes(values) if name == "lobes" else self._sums(name, values)
        phase = torch.stack([(known if surface is None else surface).phase_angle for surface in surfaces])
        return replace(known, table=table, phase_angle=self._coefficients(phase))

    def _lobes(self, values: Tensor) -> dict[str, Tensor]:
        """Coefficients of the logarithms of lobe sums (S, 2 G, 2 C) by exponent, monomial and row: (2 G M, 2 C); those that
        are dark at some geometry of the stencil stay what they are at the reference."""
        nodes = values.unflatten(1, (-1, 2))
        dark = (nodes[:, :, 0] <= DARK).any(0)[:, None]
        coefficients = self._coefficients(nodes)
        coefficients[1:] = torch.where(dark, 0.0, coefficients[1:])
        coefficients = coefficients.flatten(1, 2)
        largest = coefficients.abs().flatten(1).amax(1)
        kept = largest * self.reach ** self._degree().clamp(min=1) > NEGLIGIBLE
        kept[0] = True
        order = torch.nonzero(kept)[:, 0]
        return {"lobes": coefficients[order].transpose(0, 1).flatten(0, 1).contiguous(), "order": order}

    def _degree(self) -> Tensor:
        d = len(self.columns)
        return self.theta.new_tensor([0] + [1] * d + [2] * (d + len(self.pairs)))

    def _sums(self, name: str, values: Tensor) -> dict[str, Tensor]:
        """Coefficients (M, ...) of sums (S, ...), of their logarithms where these are smooth."""
        smooth = (values > 1e-2 * values.amax(0)).all(0)
        logs = torch.log(torch.where(smooth, values, 1.0))
        return {
            name: self._coefficients(torch.where(smooth, logs, values)),
            f"{name} in logarithms": smooth,
        }

    def _record(self, records: list[Record]) -> Record:
        """Places or instants with coefficients in place of what differs over the stencil, (M, 1, ...)."""
        changed = {}
        for field in fields(records[0]):
            several = [getattr(record, field.name) for record in records]
            first = several[0]
            if first is not None and any(not torch.equal(first, other) for other in several[1:]):
                changed[field.name] = self._coefficients(torch.stack(several))
        return replace(records[0], **changed) if changed else records[0]

    def tables_at(self, theta: Tensor, detail: bool) -> Tables:
        """Tables at theta (..., P), whether within the reach or not."""
        tables, reference = self.tables(detail)
        monomials = self.monomials(theta)
        surfaces = tuple(
            replace(
                surface,
                table=_evaluated(surface.table, monomials),
                phase_angle=_polynomial(surface.phase_angle, monomials),
            )
            for surface in tables.surfaces
        )
        sky = Sky(
            self._moved(tables.sky.state, reference.sky.state, monomials),
            self._moved(tables.sky.nodes, reference.sky.nodes, monomials),
            False,
            tables.sky.instants,
        )
        return replace(tables, surfaces=surfaces, sky=sky)

    def _moved(self, record: Record, reference: Record, monomials: Tensor) -> Record:
        moved = {
            field.name: _polynomial(getattr(record, field.name), monomials)
            for field in fields(record)
            if getattr(record, field.name) is not getattr(reference, field.name)
        }
        return replace(record, **moved) if moved else record

    # ------------------------------------------------------------------ light

    def kept_surfaces(self, detail: bool) -> list[Surface | None]:
        return list(self.tables(detail)[1].surfaces)

    def light(self, theta: Tensor, shares: bool) -> Brightness:
        flat = theta[None] if theta.ndim == 1 else theta.flatten(0, -2)
        inside = self.served(flat)
        if transformed():
            near, far = self._near(flat, shares), self.exact.brightness(flat, shares)
            kept = None
            if near.shares is not None and far.shares is not None:
                kept = torch.where(inside[:, None, None], near.shares, far.shares)
            flux = torch.where(inside[:, None], near.flux, far.flux)
            return self.joined([Brightness(flux, kept, near.components)], theta)
        rows, others = torch.nonzero(inside)[:, 0], torch.nonzero(~inside)[:, 0]
        if not len(others):
            return self.joined([self._near(flat, shares)], theta)
        far = put(self.exact.brightness(flat[others], shares), others, len(flat))
        if not len(rows):
            return self.joined([far], theta)
        near = put(self._near(flat[rows], shares), rows, len(flat))
        kept = near.shares + far.shares if near.shares is not None and far.shares is not None else None
        return self.joined([Brightness(near.flux + far.flux, kept, near.components)], theta)

    def _near(self, flat: Tensor, shares: bool) -> Brightness:
        return self.shone(self.tables_at(flat, shares or self.assembly.needs_shares), flat, shares)

    @property
    def error_mag(self) -> float:
        """Tables over the exponents of lobes are in what was measured."""
        return self.own_error_mag + self.exact.error_mag

    def _measure(self) -> None:
        """Sets ``own_error_mag``, and ``reach`` to where ``error_mag`` is at most MOST_MAG."""
        generator = torch.Generator().manual_seed(0)
        d = len(self.columns)
        towards, materials = (
            torch.randn(HELD_OUT, size, generator=generator, dtype=torch.float64).to(self.theta)
            for size in (d, len(self.theta))
        )
        length = torch.linalg.vector_norm(towards, dim=-1, keepdim=True)
        share = (torch.arange(HELD_OUT, dtype=torch.float64)[:, None] + 1) / HELD_OUT
        u = self.reach * share.to(towards) * towards / length
        radius = self.reach * share[:, 0]
        low, high = (
            self.theta.new_tensor([getattr(parameter.prior, end) for parameter in self.parameters.free])
            for end in ("low", "high")
        )
        others = torch.maximum(torch.minimum(self.theta + self.spread * materials, high), low)
        points = self.theta_at(u, others)
        # shares of one unit of light that are more than all of it together are those of theta
        allowed = torch.isfinite(self.parameters.log_prior(points))[:, None]
        points = torch.where(allowed, points, self.theta_at(u))
        sound = ((points >= low) & (points <= high)).all(-1)
        points, radius = points[sound], radius[sound]
        if not len(points):
            raise UnsuitableError("the scale of the geometry is wider than its bounds")
        flux, expected = self._near(points, False).flux, self.exact.brightness(points, False).flux
        counted = (expected > FAINT * expected.amax()) & (flux > 0)
        ratio = torch.where(counted, flux, 1.0) / torch.where(counted, expected, 1.0)
        self.row_errors = 2.5 * torch.log10(ratio).abs()
        error = self.row_errors.amax(-1)
        good = error <= MOST_MAG - self.exact.error_mag
        if not bool(good.all()):
            self.reach = float(radius[~good].min())
        kept = radius < self.reach if not bool(good.all()) else good
        if self.reach < LEAST_REACH or not bool(kept.any()):
            raise UnsuitableError(
                f"light {self.reach:.2g} standard deviations away is {float(error.max()):.2g} mag off"
            )
        self.own_error_mag = float(error[kept].max())


def _polynomial(coefficients: Tensor, monomials: Tensor) -> Tensor:
    """Sum over M of coefficients (M, ...) times monomials (B, M): (B, ...)."""
    return torch.tensordot(monomials, coefficients, 1)


def _evaluated(table: Mapping[str, Tensor], monomials: Tensor) -> dict[str, Tensor]:
    """A surface's table (of coefficients) at monomials (..., M)."""
    evaluated: dict[str, Tensor] = {}
    for name, coefficients in table.items():
        smooth = table.get(f"{name} in logarithms")
        if name == "lobes":
            evaluated |= {"lobes": coefficients, "monomials": monomials[..., table["order"]]}
        elif smooth is not None:
            value = _polynomial(coefficients, monomials)
            evaluated[name] = torch.where(smooth, torch.exp(torch.where(smooth, value, 0.0)), value)
    return evaluated
