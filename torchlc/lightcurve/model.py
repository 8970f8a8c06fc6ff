"""The light curve as a module: geometry and effects around the facet sum of eqs. 8-11, from theta to
magnitudes.

``LightCurve`` separates what depends on geometry (computed once while no geometric parameter is free) from
what depends on materials (one exponential per lit-and-seen pair of facet and epoch). Letters: B batch, L
lights, Q instants, T rows, F facets, C components.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial, reduce
from typing import TypeVar

import torch
from torch import Tensor, nn

from torchlc.geometry.orbit import State
from torchlc.lightcurve.assembly import Assembly, assemble
from torchlc.pairs.facet_pairs import pair_table
from torchlc.parameters import ParameterSet
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.shapes import tracking_pose
from torchlc.shapes.part import like
from torchlc.stages.effect import (
    GEOMETRY_STAGES,
    Brightness,
    Columns,
    Effect,
    Instants,
    Light,
    Nodes,
    Noise,
    Patch,
    Reflect,
    Request,
    Scatter,
    Sky,
    Surface,
    View,
)
from torchlc.tensors.autodiff_state import apart, readable, transformed
from torchlc.tensors.vectors import unit

MODULE_ATTRIBUTES = frozenset((*dir(nn.ModuleDict()), *dir(nn.ParameterDict())))
RECENT_TABLES = 48
"""Compact tables of past geometries that a model keeps."""
NODES = 9
CLOCK_TURN_DEG = 3.0
MOST_TRACED_PAIRS = 1_000_000
"""Facet-row pairs of a mesh beyond which a clock offset is interpolated; 3 deg between nodes keep the cubic
within 2e-4."""
MOST_GRIDDED = 64
"""Facets and instants together up to which a batch of geometries is worked out on one grid of all pairs, and
beyond which only the pairs that are lit and seen are."""
LATE = frozenset(("pointing", "light", "surface"))
"""Stages of which none turns the body or takes it elsewhere."""
MOST_SLOTS = 12
"""Pairs a row beyond which a lobe is tabulated over its exponent instead of summed at every call. For a cylinder of
384 facets under a Sun with a disc, the tabulation costs as much as the table of pairs that it replaces, or as 130
calls that sum them."""
TABULATED_MAG = 1.5e-3
STEPPED_MAG = 5e-4
CLOCK_MAG = 2e-4
"""What a lobe tabulated over its exponent, light interpolated over an exposure time, and tables interpolated over a
clock offset are out by at most; see :class:`Evaluation`."""
GRID_AT_ONCE = 2**20
"""Pairs of facet and instant of all geometries that are worked out at once."""
DARKEST = 1e-36
"""Phi of the object's light below which there is none: one photon a square metre in some million years (the Sun sends
4e21 in a second), 63 mag. What is left of a lobe far from its glint, 1e-260 say, is no brightness but the tail of a
formula."""
VALUES_AT_ONCE = 2**17
"""Numbers that a batched call holds in one buffer, 1 MiB: a larger batch is cut, so that what one step writes
is in the cache when the next reads it, and memory does not grow with the batch."""


@dataclass(frozen=True)
class Evaluation:
    """How a model works out its light, settled by scene, recording and effects: the same for every theta, alone or
    in a batch, with or without gradients.

    ``way``: "kept" tables of a fixed geometry; tables worked out "anew" for every theta; "stepped", light
    interpolated over the one parameter that moves the geometry, or "clocked", tables over the offset of the clock.
    ``tabulated`` names the materials whose lobes are interpolated over their exponent. ``error_mag`` is the largest
    error of these interpolations, mag, 0 where there is none.
    """

    way: str
    tabulated: tuple[str, ...]
    error_mag: float


@dataclass(frozen=True)
class Tables:
    """What the material stage needs: a surface per component and material, and effects that scatter further
    light. ``columns`` says which rows and instants the tables hold side by side; None: the rows."""

    surfaces: tuple[Surface, ...]
    scatter: tuple[tuple[Effect, Scatter], ...]
    sky: Sky
    columns: Columns | None = None


Record = TypeVar("Record", State, Nodes)
Key = tuple[str, str, bool, str | None]
"""Component, material, whether its light is the Sun's, and what scales it: what a surface is of."""


class LightCurve(nn.Module):
    """Model of one recording. ``model()`` is the light curve at the module's own parameters, ``model(theta)``
    at natural values theta (..., P): magnitudes (..., T), or the irradiance ratio Phi for a recording of
    relative flux.

    ``sibling``, a model of the same scene and recording, lends its tables where its geometry is the same. The
    free parameters are ``nn.Parameter`` leaves in unconstrained coordinates, grouped as
    ``free.<owner>.<name>`` with "." and "%" in names as %2E and %25; ``names`` lists them in the order of theta and ``theta()`` gives their natural
    values. What effects and laws learn beside these, such as networks, is in ``learners``. Neglects everything that is not among ``effects``.
    """

    def __init__(
        self,
        scene: Scene,
        recording: Recording,
        *,
        effects: Sequence[str] | None = None,
        assembly: Assembly | None = None,
        sibling: LightCurve | None = None,
    ) -> None:
        super().__init__()
        self.assembly = assembly if assembly is not None else assemble(scene, recording, effects)
        self.free = nn.ModuleDict()
        z = self.parameter_set.to_unconstrained(self.parameter_set.start())
        self._keys: list[tuple[str, str]] = []
        for index, parameter in enumerate(self.parameter_set.free):
            short = parameter.origin.short
            label = parameter.name.removesuffix(f".{short}") if parameter.origin.owner else "calibration"
            owner, short = module_key(label), module_key(short)
            if owner not in self.free:
                self.free[owner] = nn.ParameterDict()
            self.free[owner][short] = nn.Parameter(z[index].clone())  # pyright: ignore[reportIndexIssue]
            self._keys.append((owner, short))
        learners = {module_key(name): module for name, module in self.assembly.learners.items()}
        self.learners = nn.ModuleDict(learners).to(self.assembly.dtype)
        shared = sibling is not None and sibling.tables_key == self.tables_key
        self._tables: dict[bool, Tables] = sibling._tables if shared and sibling is not None else {}
        self._nodes: dict[bool, tuple[list[Tables], float]] = (
            sibling._nodes if shared and sibling is not None else {}
        )
        self._recent: dict[tuple[bool, bytes], Tables] = {}
        self._still: dict[bool, dict[Key, Surface | None]] = {}
        self._placed: View | None = None
        self._steps: dict[tuple[bool, int], Tables] = {}

    # ------------------------------------------------------------------ parameters

    @property
    def scene(self) -> Scene:
        return self.assembly.scene

    @property
    def recording(self) -> Recording:
        return self.assembly.recording

    @property
    def parameter_set(self) -> ParameterSet:
        return self.assembly.parameters

    @property
    def names(self) -> list[str]:
        """Full names of the free parameters, in the order of theta."""
        return self.parameter_set.names

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.assembly.effects

    def unconstrained(self) -> Tensor:
        """The module's own parameters as one vector z, (P,)."""
        leaves = [self.free[owner][short] for owner, short in self._keys]  # pyright: ignore[reportIndexIssue]
        return torch.stack(leaves) if leaves else self.parameter_set.start()

    def theta(self) -> Tensor:
        """The module's own parameters as natural values, (P,)."""
        return self.parameter_set.to_natural(self.unconstrained())

    @torch.no_grad()
    def set_theta(self, theta: Tensor) -> None:
        """Make natural values theta (P,) the module's own; what lies beyond a bound is set just inside it."""
        for (owner, short), value in zip(self._keys, self.parameter_set.to_unconstrained(theta), strict=True):
            self.free[owner][short].copy_(value)  # pyright: ignore[reportIndexIssue]

    def values(self, theta: Tensor | None = None) -> dict[str, Tensor]:
        """Every number of the model by its full name, free and fixed."""
        return self.parameter_set.values(self.theta() if theta is None else theta)

    @property
    def tables_key(self) -> tuple[str, ...]:
        """What the tables of a fixed geometry depend on; models of one assembly with equal keys may share
        them."""
        shaping = [
            e for e in self.effects if e.stage in {*GEOMETRY_STAGES, "scatter"} or e.name == "lobe_tail"
        ]
        return (
            *(str(told) for told in (self.geometry_free, bool(self.names), self.assembly.settled)),
            *(f"{e.entry} {e.nodes}" for e in shaping),
        )

    @property
    def geometry_free(self) -> bool:
        """True if a free parameter moves the geometry, so that its tables cannot be kept."""
        return self.assembly.geometry_free

    # ------------------------------------------------------------------ the curve

    def forward(self, theta: Tensor | None = None) -> Tensor:
        """Magnitudes (..., T), or relative flux for a recording of kind ``flux``, of natural values theta
        (..., P)."""
        brightness = self.brightness(theta)
        return self.magnitude(brightness, theta) if self.recording.kind == "mag" else brightness.flux

    def magnitude(self, brightness: Brightness, theta: Tensor | None = None) -> Tensor:
        """Eq. 11: band_sun_magnitude - 2.5 log10 Phi + zero_point, (..., T); +inf where the flux is 0 or
        less."""
        lit = brightness.flux > 0
        magnitude = -2.5 * torch.log10(torch.where(lit, brightness.flux, 1.0))
        return self.assembly.sun_magnitude + torch.where(lit, magnitude, math.inf) + self.zero_point(theta)

    def zero_point(self, theta: Tensor | None = None) -> Tensor:
        """Zero point, mag, (..., 1) or (..., T)."""
        return self.assembly.rows(self.values(theta), "zero_point")

    def brightness(self, theta: Tensor | None = None, *, shares: bool = False) -> Brightness:
        """Total flux Phi (..., T), and component shares (..., C, T) if asked for, of natural values theta
        (..., P)."""
        theta = self.theta() if theta is None else theta
        found = self._brightness(theta, shares)
        if shares and not self.assembly.needs_shares and (self._tabulated(True) or self._tabulated(False)):
            # a component's lobes are another table than those of all of its material together
            return replace(found, flux=self._brightness(theta, False).flux)
        return found

    def _brightness(self, theta: Tensor, shares: bool) -> Brightness:
        if not self.geometry_free:
            return self._chunked(theta, self.tables(shares or self.assembly.needs_shares), shares)
        flat = theta[None] if theta.ndim == 1 else theta.flatten(0, -2)
        found = self._together(flat, shares)
        if found is None and theta.ndim == 1:
            return self._single(theta, shares)
        if found is None:
            size = max(1, VALUES_AT_ONCE // max(1, self.assembly.pairs))

            def one(row: Tensor) -> tuple[Tensor, ...]:
                result = self._single(row, shares)
                return (result.flux,) if result.shares is None else (result.flux, result.shares)

            flux, *kept = torch.vmap(one, chunk_size=size)(flat)
            found = Brightness(flux, kept[0] if kept else None, self.assembly.components)
        flux = found.flux.reshape(*theta.shape[:-1], -1)
        kept = (
            None if found.shares is None else found.shares.reshape(*theta.shape[:-1], *found.shares.shape[1:])
        )
        return replace(found, flux=flux, shares=kept)

    def _together(self, flat: Tensor, shares: bool) -> Brightness | None:
        """Rows of theta (B, P) of a free geometry worked out together; None where each is worked out by itself."""
        if self.assembly.learns_geometry:
            return None
        if self._only_clock:
            return self._interpolated(flat, shares)
        if self._stepping is not None:
            return self._stepped(flat, self._stepping, shares)
        if transformed():
            return None
        if self._gridded:
            return self._moved(flat, shares)
        return None if torch.is_grad_enabled() else self._grouped(flat, shares)

    # ------------------------------------------------------------------ how it is evaluated

    @cached_property
    def evaluation(self) -> Evaluation:
        """How light is worked out, and what that neglects; makes the tables that are kept."""
        way, error_mag = "kept", 0.0
        if self.geometry_free:
            way = "clocked" if self._only_clock else "anew" if self._stepping is None else "stepped"
            error_mag = {"clocked": CLOCK_MAG, "stepped": STEPPED_MAG}.get(way, 0.0)
        tabulated = self._tabulated(self.assembly.needs_shares)
        return Evaluation(way, tabulated, error_mag + (TABULATED_MAG if tabulated else 0.0))

    def _tabulated(self, detail: bool) -> tuple[str, ...]:
        """Materials whose lobes are interpolated over their exponent."""
        if not any(map(self._condensable, self.assembly.models)):
            surfaces = ()
        elif not self.geometry_free:
            surfaces = self.tables(detail).surfaces
        elif self._stepping is not None:
            surfaces = self._step(self._stepping.steps, self._stepping, detail).surfaces
        else:
            surfaces = self._still_surfaces(detail).values() if self._gridded else ()
        names = (surface.material for surface in surfaces if surface is not None and "lobes" in surface.table)
        return tuple(dict.fromkeys(names))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was assumed or left out, a sentence each: of scene, recording and effects, and of how light is
        worked out."""
        said = [*self.assembly.warnings]
        movers = [name for name, stage in self.assembly.moving.items() if stage not in ("light", "surface")]
        for effect in self.effects if movers else ():
            jumping = effect.jumps(self.assembly.context)
            if jumping is not None:
                said.append(
                    f"{effect.name}: {jumping} move in jumps: gradients by {', '.join(movers)}, and fits, which follow "
                    "them, leave out how they move; draws of the posterior do not"
                )
        if self._only_clock:
            reach = NODES // 2 * self._clock_step
            said.append(
                f"time_offset: light is interpolated between offsets of up to {reach:.3g} s either way; beyond, it is "
                f"that at {reach:.3g} s"
            )
        return tuple(said)

    @cached_property
    def _gridded(self) -> bool:
        """True if geometries of a batch are worked out together: few facets, of given sizes, and nothing
        that needs the geometry apart from the facets' angles."""
        a = self.assembly
        sized = any(self.parameter_set.free[k].origin.role == "components" for k in a.geometry_columns)
        return (
            self.geometry_free
            and a.pairs <= MOST_GRIDDED * a.T
            and not sized
            and not a.stage("scatter")
            and not self._only_clock
            and self._stepping is None
            and not a.learns_geometry
        )

    def _moved(self, flat: Tensor, shares: bool) -> Brightness:
        """Rows of theta (B, P), the geometry of each worked out once, or as often as gradients ask for it."""
        detail = shares or self.assembly.needs_shares
        pieces = []
        for rows in flat.split(max(1, GRID_AT_ONCE // self.assembly.pairs)):
            distinct, member = rows, None
            if not torch.is_grad_enabled():
                distinct, member = self._geometries(rows)
            made = self.parameter_set.values(distinct)
            tables = self.make_tables(self.view(made, len(distinct)), detail, compact=False)
            if member is not None and len(distinct) > 1:
                tables = _members(tables, member, self._still_surfaces(detail).values())
            pieces.append(self._shone(tables, rows, shares))
        kept = [one.shares for one in pieces if one.shares is not None]
        flux = torch.cat([one.flux for one in pieces])
        return Brightness(flux, torch.cat(kept) if kept else None, self.assembly.components)

    def _geometries(self, rows: Tensor) -> tuple[Tensor, Tensor | None]:
        """Rows of theta (D, P) with different geometries, and which of them each of ``rows`` (B, P) shares, (B,);
        None if D is B."""
        moving = rows[:, self.assembly.geometry_columns]
        distinct, member = torch.unique(moving, dim=0, return_inverse=True)
        if len(distinct) == len(rows):
            return rows, None
        place = torch.arange(len(rows), device=rows.device)
        return rows[member.new_empty(len(distinct)).index_copy(0, member, place)], member

    def _grouped(self, flat: Tensor, shares: bool) -> Brightness | None:
        """Rows of theta (B, P) that share their geometric parameters share one compact table; None where
        almost none do and a few fit into one vectorised call. Recent tables are kept: an optimiser comes back
        to the point it stepped from."""
        distinct, member = self._geometries(flat)
        many = self.assembly.pairs > VALUES_AT_ONCE
        if len(distinct) > 0.6 * len(flat) and not self.parts_meet and not many:
            return None
        if member is None:
            member = torch.arange(len(flat), device=flat.device)
        detail = shares or self.assembly.needs_shares
        flux = flat.new_empty(len(flat), self.assembly.T)
        kept = flat.new_empty(len(flat), len(self.assembly.components), self.assembly.T) if shares else None
        for index, one in enumerate(distinct):
            rows = torch.nonzero(member == index)[:, 0]
            key = (detail, one[self.assembly.geometry_columns].numpy().tobytes())
            if key not in self._recent:
                values = self.parameter_set.values(one)
                self._recent[key] = self.make_tables(self.view(values), detail, compact=True)
                if len(self._recent) > RECENT_TABLES:
                    self._recent.pop(next(iter(self._recent)))
            piece = self._chunked(flat[rows], self._recent[key], shares)
            flux[rows] = piece.flux
            if kept is not None and piece.shares is not None:
                kept[rows] = piece.shares
        return Brightness(flux, kept, self.assembly.components)

    def forget(self) -> None:
        """Drops the tables of recent geometries, which an optimiser at work comes back to."""
        self._recent.clear()

    def batch_size(self, tables: Tables | None = None) -> int:
        """Values of theta that are worked out at once where the geometry is fixed: VALUES_AT_ONCE over the
        numbers that one of them needs."""
        return max(1, VALUES_AT_ONCE // self.values_a_call(tables))

    def values_a_call(self, tables: Tables | None = None) -> int:
        """Numbers that light at one value of theta needs where the geometry is fixed: its rows or the pairs of
        its largest surface."""
        tables = tables if tables is not None else self.tables(self.assembly.needs_shares)
        sizes = [
            table.numel()
            for surface in tables.surfaces
            for name, table in surface.table.items()
            if name != "lobes"
        ]
        return max([self.assembly.T, *sizes, *(scatter.values for _, scatter in tables.scatter)])

    @property
    def parts_meet(self) -> bool:
        """True if parts shadow or light each other, which every new geometry has to have worked out anew."""
        return any(effect.name == "self_shadowing" or effect.stage == "scatter" for effect in self.effects)

    @property
    def unaffordable(self) -> bool:
        """True if fits would work out the whole of a large mesh anew for every value of a parameter."""
        return self.geometry_free and self.assembly.traced_pairs > MOST_TRACED_PAIRS and not self._only_clock

    @cached_property
    def _only_clock(self) -> bool:
        """True for a mesh without lobes that only a clock's offset moves: its tables are smooth in the
        offset."""
        a = self.assembly
        plain = all(model.additive for model in a.models.values()) and not a.stage("scatter")
        clock = self._movers() == {("effects", "time_offset")}
        return clock and plain and a.traced_pairs > MOST_TRACED_PAIRS

    @property
    def _clock_name(self) -> str:
        return next(e for e in self.assembly.stage("clock") if e.name == "time_offset").full_name("s")

    def _movers(self) -> set[tuple[str, str]]:
        """Roles and owners of the free parameters that move the geometry."""
        moving = (self.parameter_set.free[column].origin for column in self.assembly.geometry_columns)
        return {(origin.role, origin.owner) for origin in moving}

    def _interpolated(self, flat: Tensor, shares: bool) -> Brightness:
        """Rows of theta (B, P) whose clock offsets differ, from tables at NODES offsets CLOCK_TURN_DEG of a
        turn apart, by cubics through four of them; offsets beyond the outermost are taken there. Positions are
        those at the very offset."""
        nodes, step = self._clock_nodes(shares or self.assembly.needs_shares)
        half = NODES // 2
        columns = nodes[0].columns
        row = torch.arange(self.assembly.T) if columns is None else columns.row
        values = self.parameter_set.values(flat)
        place = self.assembly.rows(values, self._clock_name, row) / step
        place = place.expand(len(flat), len(row)).clamp(-half, half) + half
        first_node = (place.detach().floor().long() - 1).clamp(0, NODES - 4)
        weights = _cubic(place - first_node)
        column = torch.arange(len(row))
        view = self._places(values, len(flat))
        phase_angle = _phase_angle(view, columns)
        surfaces = []
        for number, surface in enumerate(nodes[0].surfaces):
            table = {}
            for name in surface.table:
                stack = torch.stack([node.surfaces[number].table[name] for node in nodes])
                table[name] = sum(
                    (weights[k] * stack[first_node + k, column] for k in range(4)),
                    start=torch.zeros_like(place),
                )
            surfaces.append(replace(surface, table=table, phase_angle=phase_angle))
        sky = _sky(view, columns, self.assembly.instants, fixed=False)
        return self._shone(Tables(tuple(surfaces), (), sky, columns), flat, shares)

    @cached_property
    def _clock_step(self) -> float:
        """Seconds in which the body makes CLOCK_TURN_DEG of a turn, at the median row."""
        with apart():
            values = self.assembly.attitude_values(self.parameter_set.values(self.parameter_set.start()))
            state = [self.assembly.track.at(zero, zero, 0.0) for zero in (0.0, 1.0)]
            first, second = (self.assembly.attitude.rotation(one, values) for one in state)
            turn = torch.linalg.matrix_norm(first - second).median() / math.sqrt(2)
            return float(math.radians(CLOCK_TURN_DEG) / turn.clamp(min=1e-12))

    def _clock_nodes(self, detail: bool) -> tuple[list[Tables], float]:
        """Tables at NODES offsets of the clock about none, and the step between them, s."""
        if detail not in self._nodes:
            with apart():
                values = self.parameter_set.values(self.parameter_set.start())
                clock = self._clock_name
                clocks = [name for name in values if name == clock or name.startswith(f"{clock}[")]
                made = []
                for k in range(-(NODES // 2), NODES // 2 + 1):
                    offset = k * self._clock_step
                    moved = {**values, **{name: torch.full_like(values[name], offset) for name in clocks}}
                    made.append(self.make_tables(self.view(moved), detail, compact=True))
                self._nodes[detail] = made, self._clock_step
        return self._nodes[detail]

    @cached_property
    def _stepping(self) -> Effect | None:
        """The effect whose parameter alone moves the geometry, if light can be interpolated over it."""
        moving = self.assembly.geometry_columns
        found = [
            effect
            for effect in self.effects
            if effect.steps
            and effect.quantities
            and [self.names[one] for one in moving] == [effect.full_name(effect.quantities[0].name)]
        ]
        return found[0] if found else None

    def _stepped(self, flat: Tensor, effect: Effect, shares: bool) -> Brightness:
        """Rows of theta (B, P) by cubics through the light at four of ``effect.steps`` + 1 values of its
        parameter, each of which has its tables once for all. Where a transform hides which four, all are worked
        out."""
        steps, column = effect.steps, self.assembly.geometry_columns[0]
        detail = shares or self.assembly.needs_shares
        place = flat[:, column] / effect.quantities[0].high * steps
        first = (place.detach().floor().long() - 1).clamp(0, steps - 3)
        weights = _cubic(place - first)
        flux, light = torch.zeros_like(place[:, None]), torch.zeros_like(place[:, None, None])
        known = readable(first)
        wanted = torch.unique(first[:, None] + torch.arange(4)).tolist() if known else range(steps + 1)
        for step in wanted:
            node = step - first
            inside = (node >= 0) & (node < 4)
            weight = torch.where(inside, weights.gather(0, node.clamp(0, 3)[None])[0], 0.0)[:, None]
            if known:
                rows = torch.nonzero(inside)[:, 0]
                piece = self._chunked(flat[rows], self._step(step, effect, detail), shares)
                piece = _put(piece, rows, len(flat))
            else:
                piece = self._shone(self._step(step, effect, detail), flat, shares)
            part = weight * piece.flux
            flux = flux + part
            if shares and piece.shares is not None:
                light = light + part[:, None] * piece.shares
        kept = light / torch.where(flux > 0, flux, 1.0)[:, None] if shares else None
        return Brightness(flux, kept, self.assembly.components)

    def _step(self, step: int, effect: Effect, detail: bool) -> Tables:
        """Tables at one of the values of the effect's parameter."""
        if (detail, step) not in self._steps:
            with apart():
                values = self.parameter_set.values(self.parameter_set.start())
                quantity = effect.quantities[0]
                name = effect.full_name(quantity.name)
                values[name] = torch.full_like(values[name], quantity.high * step / effect.steps)
                made = self.make_tables(self.view(values), detail, compact=True)
                self._steps[detail, step] = replace(made, surfaces=tuple(map(self._condensed, made.surfaces)))
        return self._steps[detail, step]

    def _single(self, theta: Tensor, shares: bool) -> Brightness:
        values = self.parameter_set.values(theta)
        tables = self.make_tables(self.view(values), shares or self.assembly.needs_shares, compact=False)
        return self.shine(tables, values, shares)

    def _chunked(self, theta: Tensor, tables: Tables, shares: bool) -> Brightness:
        """A batch beyond ``batch_size`` is cut along its leading axis."""
        flat = theta.flatten(0, -2) if theta.ndim > 1 else theta
        size = self.batch_size(tables)
        if theta.ndim == 1 or len(flat) <= size:
            return self._shone(tables, theta, shares)
        pieces = [self._shone(tables, piece, shares) for piece in flat.split(size)]
        flux = torch.cat([piece.flux for piece in pieces]).reshape(*theta.shape[:-1], -1)
        kept = None
        if shares:
            stacked = torch.cat([piece.shares for piece in pieces if piece.shares is not None])
            kept = stacked.reshape(*theta.shape[:-1], *stacked.shape[1:])
        return Brightness(flux, kept, self.assembly.components)

    def _shone(self, tables: Tables, theta: Tensor, shares: bool) -> Brightness:
        """Light of every row of theta (..., P), whether or not it depends on it."""
        found = self.shine(tables, self.parameter_set.values(theta), shares)
        flux = found.flux.expand(*theta.shape[:-1], -1)
        kept = None if found.shares is None else found.shares.expand(*theta.shape[:-1], -1, -1)
        return replace(found, flux=flux, shares=kept)

    # ------------------------------------------------------------------ geometry

    def view(self, values: Mapping[str, Tensor], batch: int = 1) -> View:
        """Positions, attitude, poses, lights and surfaces at every instant, through the stages clock to
        surface, of values (), or (B,) for a ``batch`` of B."""
        a = self.assembly
        context, row = a.optics, a.instant_row
        view = self._places(values, batch)
        each = _per_instant(values, view.nodes, batch)
        poses = view.poses
        for effect in a.stage("pointing"):
            poses = effect.pointing(poses, a.own(effect, each, row), context)
        view = replace(view, poses=poses)
        patches = tuple(
            Patch(
                component=part.name,
                material=material,
                model=a.models[material],
                faces=[part.faces[i] for i in index.tolist()],
                normal=one.normal[index],
                u=one.u[index],
                area=one.area[index],
                pose=poses[number],
                part=number,
                select=index,
                surface=None if face is None else part.surface(face, values),
            )
            for number, (part, one) in enumerate(zip(a.shape.parts, view.facets, strict=True))
            for material, face, index in a.patches[number]
        )
        lights = view.lights
        for effect in a.stage("light"):
            lights = effect.light(lights, view, a.own(effect, each, row), context)
        view = replace(view, lights=lights)
        for effect in a.stage("surface"):
            patches = effect.surface(patches, view, a.own(effect, values, row), context)
        return replace(view, patches=patches)

    def _places(self, values: Mapping[str, Tensor], batch: int) -> View:
        """Clock to attitude; kept where no free parameter has a part in it."""
        a = self.assembly
        several = any(effect.nodes > 1 for effect in a.stage("clock"))
        late = LATE.issuperset(a.moving.values()) and not several and not a.learns_geometry
        if late and self._placed is not None:
            return replace(self._placed, batch=batch)
        context, row = a.optics, a.instant_row
        zero = torch.zeros(batch if several else 1, a.N, dtype=a.dtype, device=a.device)
        nodes = Nodes(zero, torch.ones_like(zero[:, :1]))
        for effect in a.stage("clock"):
            nodes = effect.clock(nodes, a.own(effect, _per_instant(values, nodes, batch), row), context)
        values = _per_instant(values, nodes, batch)
        request = Request(nodes.offset, nodes.offset, zero[0, :1])
        for effect in a.stage("orbit"):
            request = effect.orbit(request, a.own(effect, values, row), context)
        state = context.track.at(request.observer_offset, request.object_offset, request.ahead)
        turned = a.attitude_values(values)
        for effect in a.stage("spin"):
            turned = effect.spin(turned, a.own(effect, values, row), context)
        rotation = a.attitude.rotation(state, turned)
        for effect in a.stage("attitude"):
            rotation = effect.attitude(rotation, state, a.own(effect, values, row), context)
        range_km = torch.linalg.vector_norm(state.observer, dim=-1)
        to_sun = torch.einsum("...ij,...i->...j", rotation, unit(state.sun))
        to_observer = torch.einsum("...ij,...i->...j", rotation, state.observer / range_km[..., None])
        poses: dict[tuple[bytes, bytes] | None, Tensor] = {}  # parts that stand alike have one
        keys = []
        for part in a.shape.parts:
            axis, front = part.tracks_axis, part.front
            key = None if axis is None else (axis.tobytes(), front.tobytes())
            if axis is not None and key not in poses:
                poses[key] = tracking_pose(like(axis, to_sun), like(front, to_sun), to_sun)
            keys.append(key)
        sizes = a.size_values(values)
        view = View(
            nodes,
            state,
            rotation,
            to_sun,
            to_observer,
            1e3 * range_km,
            tuple(map(poses.get, keys)),
            tuple(part.facets(sizes) for part in a.shape.parts),
            lights=(Light(to_sun[None], torch.ones_like(to_sun[None, ..., 0])),),
            batch=batch,
        )
        if late and not transformed():
            self._placed = view
        return view

    def tables(self, detail: bool = False) -> Tables:
        """The tables of a model whose geometry is fixed, made on first use; with ``detail`` wings stay
        apart."""
        if detail not in self._tables:
            with apart():
                values = self.parameter_set.values(self.parameter_set.start())
                made = self.make_tables(self.view(values), detail, compact=True)
                self._tables[detail] = replace(made, surfaces=tuple(map(self._condensed, made.surfaces)))
        return self._tables[detail]

    def _condensed(self, surface: Surface) -> Surface:
        """A surface of many pairs a row with its lobe sums tabulated over the exponent, where nothing
        reshapes the lobe and there is something to fit."""
        table = surface.table
        pairs = table["log_half"].shape[0] if "log_half" in table else 0
        if pairs <= MOST_SLOTS or not self._condensable(surface.material):
            return surface
        return replace(surface, table=surface.model.condense(table))  # pyright: ignore[reportAttributeAccessIssue]

    def _condensable(self, material: str) -> bool:
        """Whether there is something to fit, and the material's lobe has one exponent, its own shape and a table."""
        shared = self.assembly.has_number(material, "n")
        reshaped = any(effect.name == "lobe_tail" for effect in self.effects)
        return (
            bool(self.names)
            and shared
            and not reshaped
            and hasattr(self.assembly.models[material], "condense")
        )

    def make_tables(self, view: View, detail: bool, *, compact: bool) -> Tables:
        """Angles and weights of every pair of facet and instant, reduced as far as the materials' models
        allow."""
        a = self.assembly
        columns = a.columns if compact else a.apart
        middle = view if a.instants is None else view.at(a.instants.middle)
        scatter = tuple(
            (effect, effect.scatter(middle if effect.at_middle else view, a.optics))
            for effect in a.stage("scatter")
        )
        still = {} if compact or not self._gridded else self._still_surfaces(detail)
        found = [
            still[key] if key in still else _surface(key, one, patches, compact, columns)
            for key, one, patches in _sorted_patches(view, detail)
        ]
        surfaces = tuple(surface for surface in found if surface is not None)
        return Tables(surfaces, scatter, _sky(view, columns, a.instants, fixed=compact), columns)

    def _still_surfaces(self, detail: bool) -> dict[Key, Surface | None]:
        """Surfaces of a free geometry that no free parameter moves, made on first use: those that two values
        of theta have in common."""
        if detail not in self._still:
            with apart():
                theta = self.parameter_set.start()
                alone = self.view(self.parameter_set.values(theta))
                both = self.view(self.parameter_set.values(theta.expand(2, -1)), 2)
                moving = {key for key, one, patches in _sorted_patches(both, detail) if _moves(one, patches)}
                made = {
                    key: _surface(key, one, patches, True, self.assembly.apart)
                    for key, one, patches in _sorted_patches(alone, detail)
                    if key not in moving
                }
            self._still[detail] = {key: one and self._condensed(one) for key, one in made.items()}
        return self._still[detail]

    # ------------------------------------------------------------------ materials and detector

    def shine(self, tables: Tables, values: Mapping[str, Tensor], shares: bool = False) -> Brightness:
        """Facet sum (eqs. 8-10) of prepared tables for values of any batch shape, then the detector stage."""
        a = self.assembly
        columns = tables.columns
        row = None if columns is None else columns.row
        sunlight: Tensor | None = None
        for effect in a.stage("shade"):
            factor = effect.shade(tables.sky, a.own(effect, values, row), a.context)
            if factor.ndim:
                sunlight = factor if sunlight is None else sunlight * factor
        by_column: dict[str, Tensor] = {}
        by_component: dict[str, Tensor] = {}

        def add(sums: dict[str, Tensor], component: str, light: Tensor) -> None:
            old = sums.get(component)
            sums[component] = light if old is None else old + light

        for surface in tables.surfaces:
            specular, diffuse = self.reflect(surface, values, row)
            light = specular + diffuse
            if surface.scale is not None:
                light = light * a.rows(values, surface.scale, row)
            if surface.sunlit and sunlight is not None:
                light = light * sunlight
            add(by_column, surface.component, light)
        for effect, scatter in tables.scatter:
            rows = None if effect.at_middle else a.instant_row

            def reflector(surface: Surface, rows: Tensor | None = rows) -> tuple[Tensor, Tensor]:
                return self.reflect(surface, {name: value[..., None] for name, value in values.items()}, rows)

            for component, light in scatter.light(reflector, a.own(effect, values, rows)).items():
                if effect.at_middle or columns is None:
                    mean = (
                        sunlight
                        if columns is None or sunlight is None
                        else _summed(sunlight * columns.weight, row, a.T)
                    )
                    add(by_component, component, light if mean is None else light * mean)
                else:
                    light = (
                        light
                        if len(columns.row) == len(columns.of)
                        else _summed(light, columns.of, len(columns.row))
                    )
                    add(by_column, component, light if sunlight is None else light * sunlight)
        for component, light in by_column.items():
            add(by_component, component, light if row is None else _summed(light, row, a.T))
        if not by_component:
            any_value = next(iter(values.values()), a.sun_magnitude)
            by_component = {"": torch.zeros(*any_value.shape, a.T, dtype=a.dtype, device=a.device)}
        total = reduce(torch.add, by_component.values())
        lit = total > DARKEST
        total = torch.where(lit, total, 0.0)
        found = None
        if shares or a.needs_shares:
            zeros = torch.zeros_like(total)
            stacked = torch.stack([by_component.get(name, zeros) + zeros for name in a.components], -2)
            found = torch.where(lit[..., None, :], stacked / torch.where(lit, total, 1.0)[..., None, :], 0.0)
        brightness = Brightness(total, found, a.components)
        for effect in a.stage("detector"):
            brightness = effect.detector(brightness, a.own(effect, values), a.context)
        return brightness

    def reflect(
        self, surface: Surface, values: Mapping[str, Tensor], row: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Lobe and diffuse flux (..., T) of one surface, through the effects of its material; (..., C) of columns
        that belong to the rows ``row`` (C,)."""
        a = self.assembly
        own = a.material_values(surface.material, surface.model, values)
        reflect: Reflect = partial(surface.model.parts, surface.table)
        for effect in a.stage("material"):
            if effect.target in (None, surface.material):
                reflect = effect.material(reflect, surface, own, a.own(effect, values, row))
        return reflect(own)

    def noise(self, theta: Tensor) -> Noise:
        """What the noise effects add to the quoted errors at natural values theta (..., P)."""
        noise = Noise()
        effects = self.assembly.stage("noise")
        values = self.values(theta) if effects else {}
        for effect in effects:
            noise = effect.noise(noise, self.assembly.own(effect, values), self.assembly.context)
        return noise

    def extra_repr(self) -> str:
        effects = ", ".join(dict.fromkeys(effect.name for effect in self.effects)) or "none"
        return f"{self.scene.name!r}, {self.assembly.T} rows, effects: {effects}; free: {', '.join(self.names) or 'nothing'}"


def module_key(text: str) -> str:
    """A name as torch allows it for a child of a module, "." and "%" as codes, so that no two become one; one that a
    module has for itself begins with a code."""
    escaped = text.replace("%", "%25").replace(".", "%2E")
    return f"%{ord(escaped[0]):02X}{escaped[1:]}" if escaped in MODULE_ATTRIBUTES else escaped


def _per_instant(values: Mapping[str, Tensor], nodes: Nodes, batch: int) -> Mapping[str, Tensor]:
    """Values () or (B,) for every instant of a batch, (Q B,)."""
    times = nodes.offset.shape[0] // batch
    if times < 2 or batch == 1:
        return values
    return {name: value.repeat(times) if value.ndim else value for name, value in values.items()}


def _sorted_patches(view: View, detail: bool) -> list[tuple[Key, View, list[Patch]]]:
    """Patches of one material under lights of one kind, with a view of these alone; by component if in
    ``detail``."""
    groups: dict[tuple[str, str], list[Patch]] = {}
    for patch in view.patches:
        groups.setdefault((patch.component if detail else "", patch.material), []).append(patch)
    kinds: dict[tuple[bool, str | None], list[Light]] = {}
    for light in view.lights:
        kinds.setdefault((light.primary, light.scale), []).append(light)
    return [
        ((*group, *kind), replace(view, lights=tuple(lights)), patches)
        for group, patches in groups.items()
        for kind, lights in kinds.items()
    ]


def _moves(view: View, patches: Sequence[Patch]) -> bool:
    """Whether patches, or the light on them, differ between the two values of a batch."""
    seen = [view.to_observer, view.range_m, *(light.direction[0] for light in view.lights)]
    own = [one for patch in patches for one in (patch.pose, patch.visible, patch.seen) if one is not None]
    return any(len(one) > 1 for one in (*seen, *own)) or any(patch.area.ndim > 1 for patch in patches)


def _summed(light: Tensor, row: Tensor | None, rows: int) -> Tensor:
    """Light of columns (..., C) that belong to rows ``row`` (C,), by row (..., T)."""
    if row is None:
        return light
    light = light.expand(*light.shape[:-1], len(row))
    return light.new_zeros(*light.shape[:-1], rows).index_add(-1, row, light)


def _surface(
    key: Key, view: View, patches: Sequence[Patch], compact: bool, columns: Columns | None
) -> Surface | None:
    """Patches of one material with their table; None if they are never lit and seen."""
    table = pair_table(view, patches, compact, columns)
    if table is None:
        return None
    component, material, sunlit, scale = key
    return Surface(component, material, patches[0].model, table, _phase_angle(view, columns), sunlit, scale)


def _phase_angle(view: View, columns: Columns | None) -> Tensor:
    """Phase angle (T,) at mid-exposure, rad, or (B, T) where it differs within a batch; (..., C) of ``columns``."""
    phase = view.apart(torch.linalg.vector_norm(view.to_sun + view.to_observer, dim=-1) / 2)
    middle = phase[phase.shape[0] // 2]
    middle = middle[0] if len(middle) == 1 else middle
    return 2 * torch.acos((middle if columns is None else middle[..., columns.instant]).clamp(max=1 - 1e-15))


def _put(piece: Brightness, rows: Tensor, batch: int) -> Brightness:
    """Light of some rows of theta among those of all (B, ...), 0 elsewhere."""
    flux = piece.flux.new_zeros(batch, *piece.flux.shape[1:]).index_copy(0, rows, piece.flux)
    if piece.shares is None:
        return replace(piece, flux=flux)
    shares = piece.shares.new_zeros(batch, *piece.shares.shape[1:]).index_copy(0, rows, piece.shares)
    return replace(piece, flux=flux, shares=shares)


def _sky(view: View, columns: Columns | None, instants: Instants | None, *, fixed: bool) -> Sky:
    """What the shade stage sees of a view, at the instants that stand for ``columns``."""
    if columns is not None and instants is not None and len(columns.row) < len(columns.of):
        view, instants = view.at(columns.instant), instants.at(columns.instant)
    return Sky(_by_value(view, view.state), _by_value(view, view.nodes), fixed, instants)


def _by_value(view: View, record: Record) -> Record:
    """Places or instants (Q, ...) of a batch with an axis B before the others."""
    if view.batch == 1:
        return record
    apart = {
        field.name: view.apart(value).transpose(0, 1)
        for field in fields(record)
        if (value := getattr(record, field.name)) is not None
    }
    return replace(record, **apart)


def _members(tables: Tables, member: Tensor, still: Iterable[Surface | None]) -> Tables:
    """Tables of some geometries for rows of theta (B,), each of which has the one that ``member`` (B,) says."""
    kept = {id(surface) for surface in still}
    surfaces = (
        surface
        if id(surface) in kept
        else replace(
            surface,
            table={k: v[member] if len(v) > 1 else v for k, v in surface.table.items()},
            phase_angle=surface.phase_angle[member] if surface.phase_angle.ndim > 1 else surface.phase_angle,
        )
        for surface in tables.surfaces
    )
    state, nodes = (
        replace(
            record,
            **{
                field.name: value[member]
                for field in fields(record)
                if (value := getattr(record, field.name)) is not None and len(value) > 1
            },
        )
        for record in (tables.sky.state, tables.sky.nodes)
    )
    return replace(tables, surfaces=tuple(surfaces), sky=replace(tables.sky, state=state, nodes=nodes))


def _cubic(x: Tensor) -> Tensor:
    """Weights (4, ...) of values at 0, 1, 2 and 3 in the cubic through them at x (...)."""
    return torch.stack(
        [
            -(x - 1) * (x - 2) * (x - 3) / 6,
            x * (x - 2) * (x - 3) / 2,
            -x * (x - 1) * (x - 3) / 2,
            x * (x - 1) * (x - 2) / 6,
        ]
    )


def degrees_between(a: Tensor, b: Tensor) -> Tensor:
    """Angle between unit vectors (..., 3), degrees, accurate at any size."""
    apart, together = torch.linalg.vector_norm(a - b, dim=-1), torch.linalg.vector_norm(a + b, dim=-1)
    return torch.rad2deg(2 * torch.atan2(apart, together))
