"""What is computed, stage after stage: geometry, tables of pairs, light of the materials, the detector.

Every function takes the numbers of all parameters, resolved, by their full names. How often each stage is worked out, and for
what values, is an evaluator's choice (:mod:`torchlc.lightcurve.evaluators`). Letters: B batch, L lights, Q instants, T rows, F
facets, C components.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchlc.brdf.base import Brdf
from torchlc.geometry.orbit import State
from torchlc.geometry.rotation.matrices import rotation_towards
from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.tables import (
    Key,
    Tables,
    sky_of,
    sorted_patches,
    summed,
    surface_of,
    surfaces_on_grid,
)
from torchlc.pairs.discs import DiscPairs, DiscSurface
from torchlc.pairs.still import CoveredSurface, StillPairs
from torchlc.shapes import Facets, tracking_pose
from torchlc.shapes.part import like
from torchlc.stages.effect import Reflect
from torchlc.stages.instants import Nodes, Request
from torchlc.stages.light import Brightness, Light, Patch, Surface, View
from torchlc.tensors.autodiff_state import readable, transformed
from torchlc.tensors.vectors import turned_back, unit

WHERE = frozenset(("clock", "orbit"))
TURNED = frozenset(("spin", "attitude"))
SIZED = frozenset(("size",))
"""Stages that say where object and observer are, how the body is turned, and how large it is."""
Made = TypeVar("Made")
DARKEST = 1e-36
"""Phi of the object's light below which there is none: one photon a square metre in some million years (the Sun sends
4e21 in a second), 63 mag. What is left of a lobe far from its glint, 1e-260 say, is no brightness but the tail of a
formula."""


class Pipeline:
    """The stages of one assembly, in order: :meth:`view` (clock to surface), :meth:`make_tables` (pairs and scatter),
    :meth:`shine` (shade, material, detector)."""

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self._made: dict[str, Any] = {}

    def view(self, values: Mapping[str, Tensor], batch: int = 1, *, whole_discs: bool = False) -> View:
        """Positions, attitude, poses, lights and surfaces at every instant, through the stages clock to
        surface, of values (), or (B,) for a ``batch`` of B."""
        a = self.assembly
        context, row = a.optics, a.instant_row
        view = replace(self.places(values, batch), whole_discs=whole_discs)
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
                faces=faces,
                normal=facets.normal[index],
                u=facets.u[index],
                area=facets.area[..., index],
                pose=poses[number],
                part=number,
                select=index,
                surface=None if face is None else part.surface(face, values),
            )
            for number, (part, facets) in enumerate(zip(a.shape.parts, view.facets, strict=True))
            for material, face, faces, index in a.patches[number]
        )
        lights = view.lights
        for effect in a.stage("light"):
            lights = effect.light(lights, view, a.own(effect, each, row), context)
        view = replace(view, lights=lights)
        for effect in a.stage("surface"):
            patches = effect.surface(patches, view, a.own(effect, values, row), context)
        return replace(view, patches=patches)

    def places(self, values: Mapping[str, Tensor], batch: int) -> View:
        """Clock to attitude. What no free parameter has a part in is kept: places, attitude, and the facets of given sizes."""
        nodes, state = self._kept("state", WHERE, lambda: self._where(values, batch))
        each = _per_instant(values, nodes, batch)
        turned = self._kept("turned", WHERE | TURNED, lambda: self._turned(each, state))
        rotation, to_sun, to_observer, range_m, poses = turned
        facets = self._kept("facets", SIZED, lambda: self._facets(values))
        return View(
            nodes,
            state,
            rotation,
            to_sun,
            to_observer,
            range_m,
            poses,
            facets,
            lights=(Light(to_sun[None], torch.ones_like(to_sun[None, ..., 0])),),
            batch=batch,
        )

    def _kept(self, what: str, stages: frozenset[str], make: Callable[[], Made]) -> Made:
        """What some stages make: worked out once where no free parameter moves any of them."""
        if what in self._made:
            return self._made[what]
        made = make()
        a = self.assembly
        moved = a.learns_geometry or not stages.isdisjoint(a.moving.values())
        spread = "clock" in stages and any(effect.nodes > 1 for effect in a.stage("clock"))
        if not moved and not spread and not transformed():
            self._made[what] = made
        return made

    def _where(self, values: Mapping[str, Tensor], batch: int) -> tuple[Nodes, State]:
        a = self.assembly
        context, row = a.optics, a.instant_row
        several = any(effect.nodes > 1 for effect in a.stage("clock"))
        zero = torch.zeros(batch if several else 1, a.N, dtype=a.dtype, device=a.device)
        nodes = Nodes(zero, torch.ones_like(zero[:, :1]))
        for effect in a.stage("clock"):
            nodes = effect.clock(nodes, a.own(effect, _per_instant(values, nodes, batch), row), context)
        values = _per_instant(values, nodes, batch)
        request = Request(nodes.offset, nodes.offset, zero[0, :1])
        for effect in a.stage("orbit"):
            request = effect.orbit(request, a.own(effect, values, row), context)
        state = context.track.at(request.observer_offset, request.object_offset, request.ahead)
        if request.east is not None and request.north is not None:
            turn = rotation_towards(
                unit(state.observer), *torch.broadcast_tensors(request.east, request.north)
            )
            state = replace(state, observer=torch.einsum("...ij,...j->...i", turn, state.observer))
        return nodes, state

    def _turned(
        self, values: Mapping[str, Tensor], state: State
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, tuple[Tensor | None, ...]]:
        """Rotation, directions to Sun and observer in the body frame, range (m), and poses of the parts that track the
        Sun."""
        a = self.assembly
        context, row = a.optics, a.instant_row
        turned = a.attitude_values(values)
        for effect in a.stage("spin"):
            turned = effect.spin(turned, a.own(effect, values, row), context)
        rotation = a.attitude.rotation(state, turned)
        for effect in a.stage("attitude"):
            rotation = effect.attitude(rotation, state, a.own(effect, values, row), context)
        range_km = torch.linalg.vector_norm(state.observer, dim=-1)
        to_sun = turned_back(rotation, unit(state.sun))
        to_observer = turned_back(rotation, state.observer / range_km[..., None])
        poses: dict[tuple[bytes, bytes] | None, Tensor] = {}  # parts that stand alike have one
        keys = []
        for part in a.shape.parts:
            axis, front = part.tracks_axis, part.front
            key = None if axis is None else (axis.tobytes(), front.tobytes())
            if axis is not None and key not in poses:
                poses[key] = tracking_pose(like(axis, to_sun), like(front, to_sun), to_sun)
            keys.append(key)
        return rotation, to_sun, to_observer, 1e3 * range_km, tuple(map(poses.get, keys))

    def _facets(self, values: Mapping[str, Tensor]) -> tuple[Facets, ...]:
        sizes = self.assembly.size_values(values)
        return tuple(part.facets(sizes) for part in self.assembly.shape.parts)

    def areas(self, values: Mapping[str, Tensor]) -> tuple[Tensor, ...]:
        """Areas (F,) or (B, F) of the facets of each part, m2."""
        sizes = self.assembly.size_values(values)
        return tuple(part.areas(sizes) for part in self.assembly.shape.parts)

    def make_tables(
        self,
        view: View,
        detail: bool,
        *,
        compact: bool,
        still: Mapping[Key, Surface | StillPairs | None] | None = None,
    ) -> Tables:
        """Angles and weights of every pair of facet and instant, reduced as far as the materials' models
        allow. ``still`` holds surfaces that are known, and pairs of which all but what is lit and seen is."""
        a = self.assembly
        columns = a.columns if compact else a.apart
        middle = view if a.instants is None else view.at(a.instants.middle)
        scatter = tuple(
            (effect, effect.scatter(middle if effect.at_middle else view, a.optics))
            for effect in a.stage("scatter")
        )
        still = {} if still is None else still
        made: list[Surface | None] = []
        for key, part_view, patches in sorted_patches(view, detail):
            if key in still:
                known = still[key]
                made.append(known.at(part_view, patches) if isinstance(known, StillPairs) else known)
            elif compact:
                made.append(surface_of(key, part_view, patches, True, columns))
            else:
                made += surfaces_on_grid(key, part_view, patches, columns)
        surfaces = tuple(surface for surface in made if surface is not None)
        return Tables(surfaces, scatter, sky_of(view, columns, a.instants, fixed=compact), columns)

    def shine(self, tables: Tables, values: Mapping[str, Tensor], shares: bool = False) -> Brightness:
        """Facet sum (eqs. 8-10) of prepared tables for values of any batch shape, then the detector stage."""
        a = self.assembly
        columns = tables.columns
        row = None if columns is None else columns.row
        sunlight = self._sunlight(tables, values, row)
        by_column: dict[str, Tensor] = {}
        by_component: dict[str, Tensor] = {}

        def add(sums: dict[str, Tensor], component: str, light: Tensor) -> None:
            old = sums.get(component)
            sums[component] = light if old is None else old + light

        for surface, light in zip(tables.surfaces, self._lights(tables.surfaces, values, row), strict=True):
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
                        else summed(sunlight * columns.weight, row, a.T)
                    )
                    add(by_component, component, light if mean is None else light * mean)
                else:
                    light = (
                        light
                        if len(columns.row) == len(columns.of)
                        else summed(light, columns.of, len(columns.row))
                    )
                    add(by_column, component, light if sunlight is None else light * sunlight)
        for component, light in by_column.items():
            add(by_component, component, light if row is None else summed(light, row, a.T))
        if not by_component:
            any_value = next(iter(values.values()), a.sun_magnitude)
            by_component = {"": torch.zeros(*any_value.shape, a.T, dtype=a.dtype, device=a.device)}
        total = reduce(torch.add, by_component.values())
        lit = total > DARKEST
        total = torch.where(lit, total, 0.0)
        fractions = None
        if shares or a.needs_shares:
            zeros = torch.zeros_like(total)
            stacked = torch.stack([by_component.get(name, zeros) + zeros for name in a.components], -2)
            fractions = torch.where(
                lit[..., None, :], stacked / torch.where(lit, total, 1.0)[..., None, :], 0.0
            )
        brightness = Brightness(total, fractions, a.components)
        for effect in a.stage("detector"):
            brightness = effect.detector(brightness, a.own(effect, values), a.context)
        return brightness

    def _sunlight(self, tables: Tables, values: Mapping[str, Tensor], row: Tensor | None) -> Tensor | None:
        """Share of the Sun that the object sees, (..., T) or at the tables' columns; None where nothing takes any."""
        a = self.assembly
        sunlight: Tensor | None = None
        for effect in a.stage("shade"):
            factor = effect.shade(tables.sky, a.own(effect, values, row), a.context)
            if factor.ndim:
                sunlight = factor if sunlight is None else sunlight * factor
        return sunlight

    def _lights(
        self, surfaces: Sequence[Surface], values: Mapping[str, Tensor], row: Tensor | None
    ) -> list[Tensor]:
        """Light (..., C) of surfaces in their own light, those that discs shine on as finely as each pair asks for."""
        lights: list[Tensor] = []
        middles: list[tuple[int, DiscSurface, Tensor, Tensor]] = []
        batched = any(value.ndim for value in values.values())
        for surface in surfaces:
            if isinstance(surface, CoveredSurface):
                slots = len(surface.phase_angle) // surface.cover.shape[-1]
                specular, diffuse = self.reflect(surface, values, None if row is None else row.repeat(slots))
                lights.append(surface.summed(specular + diffuse, batched))
                continue
            specular, diffuse = self.reflect(surface, values, row)
            if not isinstance(surface, DiscSurface):
                lights.append(specular + diffuse)
                continue
            # one value of theta is a batch of one, as its geometry is
            specular, each = (
                light.reshape(-1, *surface.discs.shape) for light in (specular, specular + diffuse)
            )
            middles.append((len(lights), surface, specular, each))
            lights.append(self._of_row(surface.discs, each, values))
        if not middles:
            return lights
        sunlit = [light for light, surface in zip(lights, surfaces, strict=True) if surface.sunlit]
        brightest = torch.atleast_2d(reduce(torch.add, sunlit))
        for index, surface, specular, each in middles:
            weights = surface.discs.weights(specular, brightest, self._narrowest(surface, values))
            lights[index] = self._of_row(surface.discs, self._spread(surface, weights, each, values), values)
        return lights

    @staticmethod
    def _of_row(pairs: DiscPairs, light: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Light (..., C) of rows from that of pairs (B or 1, K, C) as if all area were turned their way."""
        total = (pairs.share * light).sum(-2)
        return total if any(value.ndim for value in values.values()) else total[0]

    def _spread(
        self,
        surface: DiscSurface,
        weights: Sequence[tuple[int, Tensor]],
        each: Tensor,
        values: Mapping[str, Tensor],
    ) -> Tensor:
        """Light (B or 1, K, C) of pairs over a disc by the rules that they need (:meth:`DiscPairs.weights`), ``each`` in its
        middle. Where a transform hides which pairs need a rule, all are worked out by it."""
        pairs = surface.discs
        for number, (rule, weight) in enumerate(weights):
            if not readable(weight):
                light = reduce(torch.add, self.reflect(surface.over(rule, None), values, None))
                each = torch.lerp(each, light.reshape(1, *pairs.shape), weight)
                continue
            wanted = weight > 0
            if number + 1 < len(weights):
                wanted = wanted & (weights[number + 1][1] < 1)
            which = torch.nonzero(wanted.expand(each.shape), as_tuple=True)
            if not len(which[0]):
                continue
            member = which[0] if len(each) > 1 else torch.zeros_like(which[0])
            members = _OfMembers(values, member)
            light = reduce(torch.add, self.reflect(surface.over(rule, which), members, None))[..., 0]
            share = weight.expand(each.shape)[which]
            each = each.index_put(which, torch.lerp(each[which], light, share))
        return each

    def _narrowest(self, surface: Surface, values: Mapping[str, Tensor]) -> Tensor | None:
        """Variance (B or 1, 1, 1), rad^2, of the narrowest lobe that a surface is asked for with the effects of its material,
        before they widen it; None where that is not known."""
        a = self.assembly
        numbers = a.material_values(surface.material, surface.model, values)
        asked: list[Tensor] = []

        def reflect(material: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
            asked.append(surface.model.lobe_variance(material))
            nothing = torch.zeros_like(asked[-1])[..., None]
            return nothing, nothing

        last: Reflect = reflect
        for effect in a.stage("material"):
            if effect.target in (None, surface.material):
                last = effect.material(last, surface, numbers, a.own(effect, values))
        last(numbers)
        declared = surface.model.additive or surface.model.lobe_variance is not Brdf.lobe_variance
        if not asked or not declared:
            return None
        return reduce(torch.minimum, asked).reshape(-1, 1, 1)

    def reflect(
        self, surface: Surface, values: Mapping[str, Tensor], row: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Lobe and diffuse flux (..., T) of one surface, through the effects of its material; (..., C) of columns
        that belong to the rows ``row`` (C,)."""
        a = self.assembly
        numbers = a.material_values(surface.material, surface.model, values)
        reflect: Reflect = partial(surface.model.parts, surface.table)
        for effect in a.stage("material"):
            if effect.target in (None, surface.material):
                reflect = effect.material(reflect, surface, numbers, a.own(effect, values, row))
        return reflect(numbers)


class _OfMembers(Mapping[str, Tensor]):
    """Numbers () or (B,) for some members (M,) of a batch, picked where they are asked for."""

    def __init__(self, values: Mapping[str, Tensor], member: Tensor) -> None:
        self.values_of_all, self.member = values, member

    def __getitem__(self, name: str) -> Tensor:
        value = self.values_of_all[name]
        return value[self.member] if value.ndim else value

    def __iter__(self) -> Iterator[str]:
        return iter(self.values_of_all)

    def __len__(self) -> int:
        return len(self.values_of_all)


def _per_instant(values: Mapping[str, Tensor], nodes: Nodes, batch: int) -> Mapping[str, Tensor]:
    """Values () or (B,) for every instant of a batch, (Q B,)."""
    times = nodes.offset.shape[0] // batch
    if times < 2 or batch == 1:
        return values
    return {name: value.repeat(times) if value.ndim else value for name, value in values.items()}
