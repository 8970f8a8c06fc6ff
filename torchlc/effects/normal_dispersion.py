"""The facet is wrinkled: its normals scatter about the mean one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, per_epoch
from torchlc.brdf.base import Brdf
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, Quantity
from torchlc.stages.effect import Effect, Reflect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown

NODES = tuple(math.radians(deg) for deg in (5.0, 10.0, 15.0, 20.0))
"""Standard deviations, rad, at which diffuse light is tabulated; a quartic through these and the flat facet lies between."""
TOLD_SHARE = 0.03
"""Of a facet's light face-on that is lacking at its edge where that is told: three times the error of a good row."""
TILTED, DIFFUSE = "tilted ", "diffuse of tilts "
"""Begin the names of what a table holds of facets that glint, and of the diffuse light at each of ``NODES``."""
LEAST_EXPONENT = 1e-9
"""Of a lobe: the least that an optimiser reaches."""
DARK = 1e-30
"""Light of a lobe below which there is none to be kept."""


class NormalDispersion(Effect):
    """Gaussian tilts of ``deg`` about each in-plane axis widen the lobe: 1/n grows by their variance v, light is conserved.

    Inseparable from n but by a prior on one of them. What glints has turned towards the half vector: the share v / (v + 1/n) of
    the lobe is that of facets which lie there. Diffuse light is the mean of facets that lean to four sides. Within 0.02 mag of the mean of tilted
    plates at 15 deg, and within 0.04 at a phase angle of 80 deg. Neglected: a facet whose mean is turned away is dark, and lacks up to 0.4 sqrt(v) of
    what it sends out face-on; the lobes of beckmann and cook-torrance have slopes for angles, 0.08 mag at two standard deviations of 8 deg; the flanks of a ggx lobe stay its own, 0.2 mag too
    faint where tilts widen it most; a phong-mirror lobe does not become round, 0.2 mag in its middle at a phase angle of 80 deg. No
    lumps are left, such as few wrinkles make.
    """

    name = "normal_dispersion"
    title = "surfaces that are not quite flat"
    shown = Shown(NIGHT, PANEL_GLINT, {"deg": 3.0}, "panel")
    stage = "material"
    order = 1
    per = "material"
    unable = "the material has no lobe to widen"
    quantities = (
        Quantity(
            "deg", "deg", 0.0, 20.0, "standard deviation of the facet normals about each axis",
            off=0.0, typical=3.0,
        ),
    )  # fmt: skip

    @classmethod
    def targets(cls, context):
        return [name for name in context.materials if has_lobe(context.models[name])]

    def limits(self, p, context):
        deg = float(p["deg"].max())
        share = 0.4 * math.radians(deg)
        if share < TOLD_SHARE:
            return ()
        return (
            f"normal_dispersion: a surface that is turned away as a whole is dark, though some of it is not for another {2 * deg:.2g} deg; "
            f"what it lacks is up to {100 * share:.2g} % of what it sends out face-on",
        )

    def law(self, model):
        return Tilted(model)

    def material(self, reflect: Reflect, surface, values, p):
        model, deviation = surface.model, torch.deg2rad(p["deg"][..., 0])
        variance = deviation**2

        def scattered(material: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
            narrow = {**material, **_with_lobe(model, material)}
            wide = model.broadened(narrow, variance)
            left = model.lobe_variance(narrow) / model.lobe_variance(wide)
            lobe, diffuse = reflect({**wide, "tilt_deviation": deviation, "tilt_share": 1 - left})
            return per_epoch(left * peak(model, narrow) / peak(model, wide)) * lobe, diffuse

        return scattered


@dataclass(frozen=True)
class Tilted:
    """A ``law`` whose tables also hold what tilted facets reflect; in all else it is the law.

    Entries of the law's table that are summed over pairs are its diffuse light, which is also tabulated for facets that lean to four sides;
    entries of each pair are its lobe, also tabulated for facets that have turned to the half vector.
    """

    law: type[Brdf]

    def __getattr__(self, name: str) -> Any:
        if name == "law":  # asked for by a copy that has no fields yet
            raise AttributeError(name)
        return getattr(self.law, name)

    def tabulate(self, angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        *fields, weight = torch.broadcast_tensors(*vars(angles).values(), weight)
        angles = Incidence(*fields)
        table = self.law.tabulate(angles, weight)
        summed = [name for name, entry in table.items() if entry.ndim < weight.ndim]
        glinting = self.law.tabulate(*turned(angles, weight))
        tilted = {f"{TILTED}{name}": entry for name, entry in glinting.items() if name not in summed}
        for number, deviation in enumerate(NODES):
            sides = self.law.tabulate(to_four_sides(angles, deviation), torch.cat([weight / 4] * 4, -2))
            tilted |= {f"{DIFFUSE}{number} {name}": sides[name] for name in summed}
        return table | tilted

    def condense(self, table: Mapping[str, Tensor]) -> dict[str, Tensor]:
        flat, tilted, diffuse = parted(table)
        lobes = {f"{TILTED}{name}": entry for name, entry in self.law.condense({**flat, **tilted}).items()}
        sums = {
            f"{DIFFUSE}{number} {name}": e for number, node in enumerate(diffuse) for name, e in node.items()
        }
        return self.law.condense(flat) | lobes | sums

    def parts(self, table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        flat, tilted, diffuse = parted(table)
        lobe, light = self.law.parts(flat, values)
        if "tilt_deviation" not in values:
            return lobe, light
        if not tilted:
            raise ValueError("tables of a law that is not Tilted hold no tilted facets")
        first, *shares = map(per_epoch, through_nodes(values["tilt_deviation"]))
        sums = {
            name: first * flat[name]
            + sum(share * node[name] for share, node in zip(shares, diffuse, strict=True))
            for name in diffuse[0]
        }
        glinting, light = self.law.parts({**flat, **tilted, **sums}, values)
        return torch.lerp(lobe, glinting, per_epoch(values["tilt_share"])), light.clamp(min=0)


def parted(
    table: Mapping[str, Tensor],
) -> tuple[dict[str, Tensor], dict[str, Tensor], list[dict[str, Tensor]]]:
    """What a table holds of the mean facet, of the lobe of those that glint, and of the diffuse light at each of ``NODES``."""
    flat = {name: entry for name, entry in table.items() if not name.startswith((TILTED, DIFFUSE))}

    def after(start: str) -> dict[str, Tensor]:
        return {name.removeprefix(start): entry for name, entry in table.items() if name.startswith(start)}

    return flat, after(TILTED), [after(f"{DIFFUSE}{number} ") for number in range(len(NODES))]


def through_nodes(deviation: Tensor) -> list[Tensor]:
    """Shares (...) of the flat facet and of ``NODES`` in a polynomial through all of them, at a standard deviation (...), rad (Lagrange)."""
    nodes = (0.0, *NODES)
    shares = []
    for node in nodes:
        factors = [(deviation - other) / (node - other) for other in nodes if other != node]
        shares.append(math.prod(factors[1:], start=factors[0]))
    return shares


def turned(angles: Incidence, weight: Tensor) -> tuple[Incidence, Tensor]:
    """Angles and weight of facets that have turned to the half vector. How many have is a Gaussian of the glint angle e, exp(-n e^2 / 2) with
    e / sin(e) of them per solid angle, where a lobe's own slopes have cos(e)^n."""
    depth = -angles.log_half
    bend = 1 / (1 + depth / 3 + depth**2 / 15)  # e^2 / 2 over -log(cos(e)), within 0.3 % to 85 deg
    square = 2 * depth * bend
    towards = replace(angles, cos_i=angles.cos_half, cos_r=angles.cos_half)
    towards = replace(towards, log_u=bend * angles.log_u, log_v=bend * angles.log_v)
    return towards, weight * (1 + square / 6 + 7 * square**2 / 360)


def to_four_sides(angles: Incidence, deviation: float) -> Incidence:
    """Angles on facets tilted by sqrt(2) times a standard deviation, rad, towards the Sun's side, away from it and to both others, along the
    pair axis: their mean is that over all tilts to second order, and at an edge 0.35 standard deviations for 0.40."""
    sine = torch.sqrt((1 - angles.cos_i**2).clamp(min=DARK))
    along = (2 * angles.cos_half**2 - 1 - angles.cos_i * angles.cos_r) / sine
    across = torch.sqrt((1 - angles.cos_r**2 - along**2).clamp(min=DARK))
    tilt = math.sqrt(2) * deviation
    upright, aside = math.cos(tilt), math.sin(tilt)
    sides = ((sine, along), (-sine, -along), (0 * sine, across), (0 * sine, -across))
    cos_i = torch.cat([upright * angles.cos_i + aside * sun for sun, _ in sides], -2)
    cos_r = torch.cat([upright * angles.cos_r + aside * observer for _, observer in sides], -2)
    others = (torch.cat([angle] * 4, -2) for angle in (angles.cos_half, angles.log_u, angles.log_v))
    return Incidence(cos_i.clamp(0, 1), cos_r.clamp(0, 1), *others)


def peak(model: type[Brdf], values: Mapping[str, Tensor]) -> Tensor:
    """Light (...) of a lobe of reflectance 1 on its axis."""
    like = next(iter(values.values()))
    # a half vector off the Sun, for a Fresnel factor may be 0 at normal incidence
    axis = Incidence(*(like.new_full((1, 1), number) for number in (1.0, 1.0, 0.9, 0.0, 0.0)))
    white = {name: torch.ones_like(values[name]) for name in _of_role(model, LOBE_REFLECTANCE)}
    lobe, _ = model.parts(model.tabulate(axis, like.new_ones(1, 1)), {**values, **white})
    return lobe[..., 0].clamp(min=DARK)


def _with_lobe(model: type[Brdf], values: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Its exponents, none of which is 0: the variance of no lobe is infinite, and so is its slope."""
    return {name: values[name].clamp(min=LEAST_EXPONENT) for name in _of_role(model, EXPONENT)}


def _of_role(model: type[Brdf], role: str) -> list[str]:
    return [quantity.name for quantity in model.quantities if quantity.role == role]


def has_lobe(model: type[Brdf]) -> bool:
    """Whether a reflection model can be broadened."""
    return model.broadened is not Brdf.broadened
