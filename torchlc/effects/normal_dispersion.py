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

TILT = math.radians(6.0)
"""Of the facets that give the curvature of the diffuse part: the standard deviation from which on it matters."""
PREFIX = "tilted "
"""Begins the names of what a table holds of tilted facets."""
LEAST_EXPONENT = 1e-9
"""Of a lobe: the least that an optimiser reaches."""
DARK = 1e-30
"""Light of a lobe below which there is none to be kept."""


class NormalDispersion(Effect):
    """Gaussian tilts of ``deg`` about each in-plane axis widen the lobe: 1/n grows by their variance v, light is conserved.

    Inseparable from n but by a prior on one of them. What glints has turned towards the half vector: the share v / (v + 1/n) of
    the lobe is that of facets which lie there. Diffuse light follows its mean over tilts to second order, mu0 mu as
    mu0 mu exp(-3 v) + cos(phase) (1 - exp(-3 v)) / 3. Within 0.02 mag of the mean of tilted plates for diffuse light up to 15 deg, and within
    0.05 mag for the lobes of Ashikhmin-Shirley, Beckmann, Cook-Torrance and phong-half to 1.5 standard deviations. Neglected: the
    flanks of a ggx lobe stay its own, 0.2 mag too faint where tilts widen it most; a phong-mirror lobe does not become round, 0.2 mag in
    its middle at a phase angle of 80 deg. Facets whose mean one is not lit and seen add nothing.
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

    def law(self, model):
        return Tilted(model)

    def material(self, reflect: Reflect, surface, values, p):
        model, variance = surface.model, torch.deg2rad(p["deg"][..., 0]) ** 2

        def scattered(material: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
            wide, some = model.broadened(material, variance), {**material, **_with_lobe(model, material)}
            left = model.lobe_variance(some) / model.lobe_variance(model.broadened(some, variance))
            lobe, diffuse = reflect({**wide, "tilt_variance": variance, "tilt_share": 1 - left})
            return per_epoch(left * peak(model, material) / peak(model, wide)) * lobe, diffuse

        return scattered


@dataclass(frozen=True)
class Tilted:
    """A ``law`` whose tables also hold what tilted facets reflect; in all else it is the law.

    Its entries that are summed over pairs are of facets tilted by ``TILT`` to four sides, those of each pair are of a facet that has
    turned to the half vector.
    """

    law: type[Brdf]

    def __getattr__(self, name: str) -> Any:
        if name == "law":  # asked for by a copy that has no fields yet
            raise AttributeError(name)
        return getattr(self.law, name)

    def tabulate(self, angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        *fields, weight = torch.broadcast_tensors(*vars(angles).values(), weight)
        angles = Incidence(*fields)
        turned = replace(angles, cos_i=angles.cos_half, cos_r=angles.cos_half)
        lobe = self.law.tabulate(turned, weight)
        diffuse = self.law.tabulate(to_four_sides(angles), torch.cat([weight / 4] * 4, -2))
        tilted = {name: (lobe if lobe[name].ndim == weight.ndim else diffuse)[name] for name in lobe}
        return self.law.tabulate(angles, weight) | {PREFIX + name: entry for name, entry in tilted.items()}

    def condense(self, table: Mapping[str, Tensor]) -> dict[str, Tensor]:
        flat, tilted = parted(table)
        return self.law.condense(flat) | {
            PREFIX + name: entry for name, entry in self.law.condense(tilted).items()
        }

    def parts(self, table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        flat, tilted = parted(table)
        lobe, diffuse = self.law.parts(flat, values)
        if "tilt_variance" not in values:
            return lobe, diffuse
        turned, aside = self.law.parts(tilted, values)
        # of a function that a second-order mean describes the four sides hold TILT^2 / 4 of the Laplacian, all tilts v / 2 of it;
        # exp(-3 v) is what all orders leave of mu0 mu
        curved = -torch.expm1(-3 * values["tilt_variance"]) * 2 / (3 * TILT**2)
        return (
            torch.lerp(lobe, turned, per_epoch(values["tilt_share"])),
            (diffuse + per_epoch(curved) * (aside - diffuse)).clamp(min=0),
        )


def parted(table: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """What a table holds of the mean facet and of tilted ones; both have the extent of the source."""
    flat = {name: entry for name, entry in table.items() if not name.startswith(PREFIX)}
    tilted = {name.removeprefix(PREFIX): entry for name, entry in table.items() if name not in flat}
    return flat, tilted | ({"spread": flat["spread"]} if "spread" in flat else {})


def to_four_sides(angles: Incidence) -> Incidence:
    """Angles on facets tilted by ``TILT`` towards the Sun's side, away from it and to both others, along the pair axis."""
    sine = torch.sqrt((1 - angles.cos_i**2).clamp(min=DARK))
    along = (2 * angles.cos_half**2 - 1 - angles.cos_i * angles.cos_r) / sine
    across = torch.sqrt((1 - angles.cos_r**2 - along**2).clamp(min=DARK))
    upright, aside = math.cos(TILT), math.sin(TILT)
    sides = ((sine, along), (-sine, -along), (0 * sine, across), (0 * sine, -across))
    cos_i = torch.cat([upright * angles.cos_i + aside * sun for sun, _ in sides], -2)
    cos_r = torch.cat([upright * angles.cos_r + aside * observer for _, observer in sides], -2)
    others = (torch.cat([one] * 4, -2) for one in (angles.cos_half, angles.log_u, angles.log_v))
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
