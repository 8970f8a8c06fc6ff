"""EON, energy-preserving Oren and Nayar (Portsmouth, Kutz and Hill 2025): rough diffuse surfaces that lose no light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import TINY_COS, Incidence, lambert, per_epoch, retro
from torchlc.brdf.base import Brdf
from torchlc.parameters import REFLECTANCE, Quantity

LOST = 0.5 - 2 / (3 * math.pi)
LOST_ON_AVERAGE = 2 / 3 - 28 / (15 * math.pi)
"""c1 and c2: light once scattered from normal incidence and from a white sky, per unit of A roughness."""


class Eon(Brdf):
    """f_r = albedo / pi A (1 + roughness s / t) plus what is scattered again; Portsmouth et al.'s eqs. for EON.

    s = s.o - mu0 mu, t = max(mu0, mu) where s > 0 and else 1, A = 1 / (1 + c1 roughness) as Fujii has it. What that
    leaves of a white surface's light, 1 - E(mu0), is scattered again and tinted by the albedo once more each time.
    So albedo 1 sends out all that comes in, whatever the roughness. Roughness 0 is Lambert's law; one of 0.44 has
    the ratio B/A of `oren-nayar` at sigma = 30 deg. Neglected: the shadows that cavities cast, which make a dark surface
    fainter, by 0.15 mag where sigma is 30 deg.
    """

    model: ClassVar[str] = "eon"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "albedo",
            "",
            0.0,
            1.0,
            "share of the light that is scattered each time it meets the surface",
            role=REFLECTANCE,
        ),
        Quantity("roughness", "", 0.0, 1.0, "0: Lambert's law; 1: as rough as the law goes"),
    )
    additive: ClassVar[bool] = True
    curved: ClassVar[tuple[str, ...]] = ("albedo",)

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        cos_i, cos_r = angles.cos_i.clamp(min=0), angles.cos_r.clamp(min=0)
        back = retro(angles)
        shape = torch.where(back > 0, back * torch.minimum(cos_i, cos_r), back * cos_i * cos_r)
        again = lambert(angles) * _left(cos_i) * _left(cos_r) / (LOST - LOST_ON_AVERAGE)
        return {
            "smooth": (weight * lambert(angles)).sum(-2),
            "rough": (weight * shape / math.pi).sum(-2),
            "again": (weight * again).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        albedo, roughness = per_epoch(values["albedo"]), per_epoch(values["roughness"])
        scale = 1 / (1 + LOST * roughness)
        average = scale * (1 + LOST_ON_AVERAGE * roughness)
        tint = albedo**2 * average / (1 - albedo * (1 - average))
        once = albedo * (table["smooth"] + roughness * table["rough"])
        diffuse = scale * (once + tint * roughness * table["again"])
        return torch.zeros_like(diffuse), diffuse


def _left(cosine: Tensor) -> Tensor:
    """c1 - G / pi: what is left of light from this angle after it is scattered once, over A roughness, 0 to c1."""
    sine = torch.sqrt((1 - cosine * cosine).clamp(min=TINY_COS**2))
    across = cosine * (1 + sine + sine * sine) / (1 + sine)  # (1 - sine^3) / cosine
    angle = torch.atan2(sine, cosine)
    return LOST - sine * (angle - sine * cosine + 2 / 3 * (across - 1)) / math.pi
