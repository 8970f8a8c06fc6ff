"""Light that goes by way of one facet to another before it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence
from torchlc.brdf.base import Brdf
from torchlc.pairs.cavity import Cavity, albedo_table, cavities, exchanged, returned, sources_and_sinks
from torchlc.pairs.double_reflection import BLANK, FIRST, SECOND, Posed, Ways, facing_sides
from torchlc.pairs.slots import joined, slotted
from torchlc.parameters import Quantity
from torchlc.stages.effect import Context, Effect, Scatter
from torchlc.stages.light import Surface, View
from torchlc.stages.showing import PASS, WHITE, Shown
from torchlc.tensors.autodiff_state import traced

ROWS_AT_ONCE = 200
"""Whose pairs of facets are held together."""


class Interreflection(Effect):
    """Sunlight that is reflected twice by sides of two parts, each with its lobe and its diffuse light. Also diffuse
    light that is reflected any number of times within a part whose facets face each other.

    Up to 2 % of a box-wing's light; more than the direct light where a dihedral returns the Sun; 0.1 mag in a shallow
    white dish, 0.6 mag in one as deep as it is wide. A mesh or dish is divided into at most 96 patches (a dish 192),
    whose exchange is summed to all orders: it agrees with path tracing within 1.5 %. Neglected: third bounces between
    parts (0.02 mag in a right angle of white squares of albedo 0.5, 0.05 mag at 0.8); what lobes reflect within one part; the Sun's disc; motion within
    an exposure; where third parts are in the way, how lobes and diffuse light differ in it. How other parts or
    the part itself hide facets of a dish or mesh has no gradient.
    """

    name = "interreflection"
    title = "light that goes from part to part"
    shown = Shown(PASS, "phase_angle_deg", {"gain": 1.0}, materials=WHITE)
    stage = "scatter"
    at_middle = True
    unable = "no two parts have facets that face each other, and none has facets that face its own"
    quantities = (
        Quantity(
            "gain", "", 0.0, 2.0, "light of second bounces; 1 is what the geometry says", off=0.0, typical=1.0,
            prior="normal", mean=1.0, sigma=0.5,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if facing_sides(context) or cavities(context) else self.unable

    def jumps(self, context):
        return "shadows on second bounces"

    def scatter(self, view, context):
        rows = view.to_observer.shape[1]
        size = rows if traced() else ROWS_AT_ONCE
        sides = facing_sides(context)
        pieces: dict[tuple[str, str, str, bool], list[Ways]] = {}
        for start in range(0, rows, size):
            cut = slice(start, min(start + size, rows))
            posed = Posed.of(view, context, cut)
            by_key: dict[tuple[str, str, str, bool], list[Ways]] = {}
            for first, second in sides:
                for ways, dull in posed.ways(first, second):
                    key = (context.parts[second.part].name, first.material, second.material, dull)
                    by_key.setdefault(key, []).append(ways)
            for key, ways in by_key.items():
                pieces.setdefault(key, []).append(_side_by_side(ways, cut.stop - cut.start))
        bounces = []
        for (component, first_material, second_material, dull), cuts in pieces.items():
            columns = joined(cuts, BLANK)
            if not len(columns[-1]):
                continue
            models = context.models[first_material], context.models[second_material]
            tables = tuple(
                _table(model, columns[part]) for model, part in zip(models, (FIRST, SECOND), strict=True)
            )
            products = columns[SECOND.stop :]
            if dull and all("diffuse" in table for table in tables):
                tables, products = _gathered(*tables), (*(product[:1] for product in products[:3]), 1.0)
            first, second = (
                Surface(component, name, model, table, view.range_m[0], sunlit=False)
                for name, model, table in zip((first_material, second_material), models, tables, strict=True)
            )
            bounces.append((component, first, second, products))

        inside = [_inside(cavity, view, context, size) for cavity in cavities(context)]

        def light(reflect, p) -> Mapping[str, Tensor]:
            total: dict[str, Tensor] = {}
            for component, first, second, (lobe_diffuse, diffuse_lobe, lobes, diffuse) in bounces:
                (lobe_1, diffuse_1), (lobe_2, diffuse_2) = reflect(first), reflect(second)
                twice = lobe_1 * (lobe_diffuse * diffuse_2 + lobes * lobe_2)
                twice = twice + diffuse_1 * (diffuse_lobe * lobe_2 + diffuse * diffuse_2)
                twice = p["gain"] * twice.sum(-2)
                total[component] = total[component] + twice if component in total else twice
            for component, surfaces, of_patch, (share, source, sink, area) in inside:
                albedos = [reflect(surface)[1].mean(-1) for surface in surfaces]
                albedo = torch.stack(torch.broadcast_tensors(*albedos), -2)[..., of_patch, :]
                often = p["gain"] * returned(share, source, sink, area, albedo)
                total[component] = total[component] + often if component in total else often
            return total

        values = sum(products[0].numel() for *_, products in bounces)
        return Scatter(light, values + sum(exchange[1][..., 0].numel() for *_, exchange in inside))


def _inside(
    cavity: Cavity, view: View, context: Context, size: int
) -> tuple[str, list[Surface], Tensor, tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Of a part whose facets face each other: its name, a surface of each of its materials whose diffuse light is
    the albedo, which of these each patch has, and what :func:`returned` asks for besides."""
    rows, facets = view.to_observer.shape[1], view.facets[cavity.part]
    starts = range(0, rows, size)
    pieces = [sources_and_sinks(cavity, view, context, slice(s, min(s + size, rows))) for s in starts]
    source, sink = (torch.cat(column) for column in zip(*pieces, strict=True))
    names = list(dict.fromkeys(cavity.materials))
    aside = facets.area.new_full((1,), 0.5 * math.pi)  # the phase angle: light comes from all sides
    component = context.parts[cavity.part].name
    surfaces = [
        Surface(
            component,
            name,
            context.models[name],
            albedo_table(context.models[name], facets),
            aside,
            sunlit=False,
        )
        for name in names
    ]
    of_patch = torch.as_tensor([names.index(name) for name in cavity.materials], device=source.device)
    share, area = exchanged(cavity, facets, context)
    return component, surfaces, of_patch, (share, source, sink, area)


def _side_by_side(pairs: list[Ways], rows: int) -> Ways:
    """Ways of several pairs of sides, (slots, T) each; under a trace every way keeps its slot."""
    columns = zip(*pairs, strict=True)
    if traced():
        return tuple(
            torch.cat([slots.unflatten(0, (rows, -1)).mT for slots in column]) for column in columns
        )[1:]
    row, *values = (torch.cat(column) for column in columns)
    return slotted(row, values, rows, BLANK)


def _table(model: type[Brdf], columns: Ways) -> dict[str, Tensor]:
    """A material's table of ways (P, T) each by itself: a leading axis P, and one pair a row."""
    *angles, spread, weight = (column[:, None] for column in columns)
    table = model.tabulate(Incidence(*angles), weight)
    sharp = model.additive or not (traced() or bool(spread.any()))
    return table if sharp else {**table, "spread": spread}


def _gathered(
    first: dict[str, Tensor], second: dict[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Tables of one way in place of all, for diffuse light alone: it is a product of two materials'
    reflectances."""
    both = (first["diffuse"] * second["diffuse"]).sum(0, keepdim=True)
    of_first, of_second = ({name: table[:1] for name, table in tables.items()} for tables in (first, second))
    return {**of_first, "diffuse": both}, {**of_second, "diffuse": torch.ones_like(both)}
