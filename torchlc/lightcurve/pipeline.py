"""What is computed, stage after stage: geometry, tables of pairs, light of the materials, the detector.

Every function takes the numbers of all parameters, resolved, by their full names. How often each stage is worked out, and for
what values, is an evaluator's choice (:mod:`torchlc.lightcurve.evaluators`). Letters: B batch, L lights, Q instants, T rows, F
facets, C components.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial, reduce

import torch
from torch import Tensor

from torchlc.lightcurve.assembly import Assembly
from torchlc.lightcurve.tables import Key, Tables, sky_of, sorted_patches, summed, surface_of
from torchlc.shapes import tracking_pose
from torchlc.shapes.part import like
from torchlc.stages.effect import (
    Brightness,
    Light,
    Nodes,
    Patch,
    Reflect,
    Request,
    Surface,
    View,
)
from torchlc.tensors.autodiff_state import transformed
from torchlc.tensors.vectors import unit

LATE = frozenset(("pointing", "light", "surface"))
"""Stages of which none turns the body or takes it elsewhere."""
DARKEST = 1e-36
"""Phi of the object's light below which there is none: one photon a square metre in some million years (the Sun sends
4e21 in a second), 63 mag. What is left of a lobe far from its glint, 1e-260 say, is no brightness but the tail of a
formula."""


class Pipeline:
    """The stages of one assembly, in order: :meth:`view` (clock to surface), :meth:`make_tables` (pairs and scatter),
    :meth:`shine` (shade, material, detector)."""

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        self._placed: View | None = None

    def view(self, values: Mapping[str, Tensor], batch: int = 1) -> View:
        """Positions, attitude, poses, lights and surfaces at every instant, through the stages clock to
        surface, of values (), or (B,) for a ``batch`` of B."""
        a = self.assembly
        context, row = a.optics, a.instant_row
        view = self.places(values, batch)
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

    def places(self, values: Mapping[str, Tensor], batch: int) -> View:
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

    def make_tables(
        self,
        view: View,
        detail: bool,
        *,
        compact: bool,
        still: Mapping[Key, Surface | None] | None = None,
    ) -> Tables:
        """Angles and weights of every pair of facet and instant, reduced as far as the materials' models
        allow. ``still`` holds surfaces that are known."""
        a = self.assembly
        columns = a.columns if compact else a.apart
        middle = view if a.instants is None else view.at(a.instants.middle)
        scatter = tuple(
            (effect, effect.scatter(middle if effect.at_middle else view, a.optics))
            for effect in a.stage("scatter")
        )
        still = {} if still is None else still
        found = [
            still[key] if key in still else surface_of(key, one, patches, compact, columns)
            for key, one, patches in sorted_patches(view, detail)
        ]
        surfaces = tuple(surface for surface in found if surface is not None)
        return Tables(surfaces, scatter, sky_of(view, columns, a.instants, fixed=compact), columns)

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


def _per_instant(values: Mapping[str, Tensor], nodes: Nodes, batch: int) -> Mapping[str, Tensor]:
    """Values () or (B,) for every instant of a batch, (Q B,)."""
    times = nodes.offset.shape[0] // batch
    if times < 2 or batch == 1:
        return values
    return {name: value.repeat(times) if value.ndim else value for name, value in values.items()}
