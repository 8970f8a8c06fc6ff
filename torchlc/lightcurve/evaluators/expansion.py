"""Tables of a free geometry as polynomials about a reference geometry.

Sums of lobes and of diffuse light change smoothly with a geometry: near a glint the logarithm of a lobe is a parabola in any
angle. So their logarithms, at every exponent of the tables and in every row, are expanded to second order in the d numbers
that move the geometry, from exact tables at 1 + 2 d + d (d - 1) / 2 geometries; or to the third, where the second does not reach as far as draws
lie. A call then adds up some rows of these
tables, whatever effects are on: shadows, the Sun's disc and exposures are in them. What is not smooth stays out: the Earth's
shadow is worked out from expanded positions; a facet that rises or sets, or a shadow's edge that reaches a corner, is what
is left, and is measured.

Letters: d numbers of the geometry, S stencil, M monomials, C columns, G exponents.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import combinations, combinations_with_replacement

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
"""Geometries at which the error is measured, spread evenly over the reach."""
STEEPEST = 6
"""Of these geometries, the ones towards which the error grows fastest."""
CLOSER = (1.0, 0.8, -1.0)
"""Shares of the reach at which it is measured again about these directions, and in the opposite ones."""
ASIDE = 0.3
"""How far aside of them, as a share of the distance: of random directions one in some hundreds lies nearer the worst of five numbers."""
MARGIN = 1.0
"""Standard deviations by which it has to reach beyond the mean distance of draws, lest a sixth of them cost exact light; else it goes to
the third order."""
MOST_CUBIC = 5
"""Numbers of the geometry up to which it does: 66 exact tables, and 56 monomials."""
MOST_NUMBERS = 12
"""Numbers of the geometry, for which 91 exact tables are made."""
NEGLIGIBLE = 2e-5
"""Term of a logarithm, at the end of the reach, below which it is left out."""
DARK = -600.0
"""Logarithm that tables of lobes hold where there is no light."""
LOBES = "lobes"
"""Ends the name of an entry of a condensed table that holds logarithms of sums by exponent."""
FAINT = 1e-6
"""Share of the brightest row below which a row's error is not counted."""


class UnsuitableError(ValueError):
    """Why a geometry cannot be expanded, in words."""


class Expansion(Evaluator):
    """Second order about theta (P,), or third, for values within ``reach`` standard deviations, of covariance ``scale`` (P, P); beyond
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
        self._kept: dict[bool, tuple[Tables, Tables]] = {}
        self._made: dict[bool, list[Tables]] = {}
        """Exact tables of the stencil, for the third order to begin with."""
        self._measured: dict[bytes, Tensor] = {}
        """Exact light of geometries at which an order was measured, for the other."""
        self.may_go_on = count <= MOST_CUBIC
        with apart():
            self._to_order(2)
            if self.reach < math.sqrt(count) + MARGIN and self.may_go_on:
                self.may_go_on = False
                self._to_order(3)
        self.may_go_on = False
        self._made.clear()
        self._measured.clear()
        if self.reach < LEAST_REACH:
            raise UnsuitableError(
                f"light {self.reach:.2g} standard deviations away is {float(self.row_errors.max()):.2g} mag off"
            )

    def _to_order(self, order: int) -> None:
        """Be of an order as far as that reaches."""
        count = len(self.columns)
        self.powers = [
            powers
            for degree in range(order + 1)
            for powers in combinations_with_replacement(range(count), degree)
        ]
        """Axes (several times for higher powers) whose coordinates each monomial is the product of."""
        stencil = _stencil(count, order).to(self.theta)
        self.stencil = STEP * stencil
        self.solved = torch.linalg.pinv(self._products(self.stencil))
        self.reach = math.sqrt(count) + 3.0
        self._kept.clear()
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

    def _products(self, u: Tensor) -> Tensor:
        """The monomials (..., M) at coordinates (..., d)."""
        return torch.stack([u[..., list(powers)].prod(-1) for powers in self.powers], -1)

    def _coefficients(self, values: Tensor) -> Tensor:
        """Coefficients (M, ...) of the monomials from values (S, ...) of the stencil."""
        return torch.tensordot(self.solved, values, 1)

    def monomials(self, theta: Tensor) -> Tensor:
        """The monomials (..., M) at theta (..., P)."""
        return self._products(self.coordinates(theta))

    # ------------------------------------------------------------------ tables

    def tables(self, detail: bool) -> tuple[Tables, Tables]:
        """Tables of coefficients, and the tables of the reference that they are of."""
        if detail not in self._kept:
            with apart():
                known = self._made.pop(detail, [])
                further = self.theta_at(self.stencil[len(known) :])
                made = known + [self._exact_tables(theta, detail) for theta in further]
            if self.may_go_on:
                self._made[detail] = made
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
            self._record([getattr(tables.sky, name) for tables in made]) for name in ("state", "nodes")
        )
        return replace(made[0], surfaces=surfaces, sky=replace(sky, state=state, nodes=nodes))

    def _surface(self, surfaces: list[Surface | None]) -> Surface:
        known = next(surface for surface in surfaces if surface is not None)
        table = {}
        for name, like in known.table.items():
            of_lobes = name.endswith(LOBES)
            blank = torch.full_like(like, DARK) if of_lobes else torch.zeros_like(like)
            if of_lobes:
                blank.unflatten(0, (-1, 2))[:, 1] = 0.0
            values = torch.stack([blank if surface is None else surface.table[name] for surface in surfaces])
            table |= self._lobes(name, values) if of_lobes else self._sums(name, values)
        phase = torch.stack([(known if surface is None else surface).phase_angle for surface in surfaces])
        return replace(known, table=table, phase_angle=self._coefficients(phase))

    def _lobes(self, name: str, values: Tensor) -> dict[str, Tensor]:
        """Coefficients of the logarithms of lobe sums (S, 2 G, 2 C), with which monomials they are of, by exponent, monomial and row: (2 G M, 2 C); those that
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
        flat = coefficients[order].transpose(0, 1).flatten(0, 1).contiguous()
        return {name: flat, name.removesuffix(LOBES) + "order": order}

    def _degree(self) -> Tensor:
        return self.theta.new_tensor([len(powers) for powers in self.powers])

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
        towards = towards / torch.linalg.vector_norm(towards, dim=-1, keepdim=True)
        share = (torch.arange(HELD_OUT, dtype=torch.float64)[:, None] + 1) / HELD_OUT
        u, errors = self._errors(self.reach * share.to(towards) * towards, materials)
        if not len(u):
            raise UnsuitableError("the scale of the geometry is wider than its bounds")
        # what is left out grows as the cube of the distance: where it grows fastest it is looked at closer, and the other way
        radius = torch.linalg.vector_norm(u, dim=-1)
        steepest = torch.argsort(errors.amax(-1) / radius**3, descending=True)[:STEEPEST]
        ways = (u / radius[:, None])[steepest].repeat(len(CLOSER), 1)
        aside = torch.randn(ways.shape, generator=generator, dtype=torch.float64).to(u) * ASIDE / math.sqrt(d)
        ways = (ways + aside) / torch.linalg.vector_norm(ways + aside, dim=-1, keepdim=True)
        reach = self._reached(radius, errors.amax(-1))
        at = ways.new_tensor(CLOSER).repeat_interleave(len(steepest))[:, None]
        more, further = self._errors(reach * at * ways, materials[: len(ways)])
        u, self.row_errors = torch.cat([u, more]), torch.cat([errors, further])
        radius, error = torch.linalg.vector_norm(u, dim=-1), self.row_errors.amax(-1)
        self.reach = self._reached(radius, error)
        # where the reach ends because of it the error is all that it may be
        ends = bool((error > MOST_MAG - self.exact.error_mag).any())
        self.own_error_mag = MOST_MAG - self.exact.error_mag if ends else float(error.max())

    def _reached(self, radius: Tensor, error: Tensor) -> float:
        """How far errors (N,), which grow as the cube of distances (N,) from the reference, are small enough."""
        allowed = MOST_MAG - self.exact.error_mag
        enough = radius * (allowed / error.clamp(min=allowed)) ** (1 / 3)
        return min([self.reach, *enough[error > allowed].tolist()])

    def _errors(self, u: Tensor, materials: Tensor) -> tuple[Tensor, Tensor]:
        """Those of coordinates (H, d) that the bounds allow, (N, d), and how far light is off there, (N, T) mag, with ``materials`` (H, P) in
        standard deviations."""
        low, high = (
            self.theta.new_tensor([getattr(free.prior, end) for free in self.parameters.free])
            for end in ("low", "high")
        )
        others = torch.maximum(torch.minimum(self.theta + self.spread * materials, high), low)
        points = self.theta_at(u, others)
        # shares of one unit of light that are more than all of it together are those of theta
        allowed = torch.isfinite(self.parameters.log_prior(points))[:, None]
        points = torch.where(allowed, points, self.theta_at(u))
        sound = ((points >= low) & (points <= high)).all(-1)
        if not bool(sound.any()):
            return u[:0], u.new_zeros(0, self.assembly.T)
        points = points[sound]
        place = points.cpu().numpy().tobytes()
        if place not in self._measured:
            self._measured[place] = self.exact.brightness(points, False).flux
        near, expected = self._near(points, False).flux, self._measured[place]
        counted = (expected > FAINT * expected.amax()) & (near > 0)
        ratio = torch.where(counted, near, 1.0) / torch.where(counted, expected, 1.0)
        return u[sound], 2.5 * torch.log10(ratio).abs()


def _stencil(count: int, order: int) -> Tensor:
    """Geometries (S, d), in steps: the middle, a step either way along each axis, a step along two axes at once; of the third order also all
    ways to go along two, along three, and half a step along one."""
    eye = torch.eye(count, dtype=torch.float64)
    pairs = list(combinations(eye, 2))
    points = [torch.zeros_like(eye[0]), *eye, *-eye, *(a + b for a, b in pairs)]
    if order > 2:
        points += [sign * a - b for a, b in pairs for sign in (1, -1)] + [b - a for a, b in pairs]
        points += [a + b + c for a, b, c in combinations(eye, 3)] + [0.5 * a for a in eye]
    return torch.stack(points)


def _polynomial(coefficients: Tensor, monomials: Tensor) -> Tensor:
    """Sum over M of coefficients (M, ...) times monomials (B, M): (B, ...)."""
    return torch.tensordot(monomials, coefficients, 1)


def _evaluated(table: Mapping[str, Tensor], monomials: Tensor) -> dict[str, Tensor]:
    """A surface's table (of coefficients) at monomials (..., M)."""
    evaluated: dict[str, Tensor] = {}
    for name, coefficients in table.items():
        smooth = table.get(f"{name} in logarithms")
        if name.endswith(LOBES):
            of = name.removesuffix(LOBES)
            evaluated |= {name: coefficients, f"{of}monomials": monomials[..., table[f"{of}order"]]}
        elif smooth is not None:
            value = _polynomial(coefficients, monomials)
            evaluated[name] = torch.where(smooth, torch.exp(torch.where(smooth, value, 0.0)), value)
    return evaluated
