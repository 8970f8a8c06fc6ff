"""Cook and Torrance (1982): Beckmann's slopes in V-shaped cavities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.base import (
    Brdf,
    Incidence,
    coupled_diffuse,
    lobe,
    per_epoch,
    per_pair,
    schlick_weight,
)
from torchlc.parameters import Quantity


class CookTorrance(Brdf):
    """f_r = F D G / (4 mu0 mu) plus the diffuse part of eq. 6; D = exp(-tan^2 / m^2) / (pi m^2 cos^4).

    G = min(1, 2 (n.h) min(mu0, mu) / (h.s)) is the V-cavities' (Torrance and Sparrow 1967), F is Schlick's
    with f0. The denominator is 4, which keeps energy, where the original has pi with another D. The diffuse
    part is that of Ashikhmin and Shirley with f0 for r_spec: a plain Lambert term would exceed 1 with F at
    grazing incidence.
    """

    model: ClassVar[str] = "cook-torrance"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("m", "", 1e-3, 1.0, "rms slope of the microfacets times sqrt 2", prior="loguniform"),
        Quantity("f0", "", 0.0, 1.0, "Fresnel reflectance at normal incidence"),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance"),
    )
    simplex: ClassVar[tuple[str, ...]] = ("f0", "r_diff")

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        cos_n = torch.exp(angles.log_half).clamp(min=1e-6)
        fresnel = schlick_weight(angles.cos_half)
        lower = torch.minimum(angles.cos_i, angles.cos_r).clamp(min=0)
        open_ = (2 * cos_n * lower / angles.cos_half).clamp(max=1)
        base = weight * open_ / (4 * math.pi * cos_n**4)
        return {
            "tan2": -torch.expm1(2 * angles.log_half) / cos_n**2,
            "normal": base * (1 - fresnel),
            "grazing": base * fresnel,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        f0 = per_epoch(values["f0"])
        per_m2 = 1 / per_pair(values["m"] ** 2)
        per_m2 = per_m2 / (2 * per_m2 * table.get("spread", 0.0)).clamp(min=1)
        slopes = lobe(torch.addcmul(torch.log(per_m2), -per_m2, table["tan2"]))
        specular = f0 * (table["normal"] * slopes).sum(-2) + (table["grazing"] * slopes).sum(-2)
        return specular, per_epoch(values["r_diff"]) * (1 - f0) * table["diffuse"]

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        return 0.5 * values["m"] ** 2

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        return {**values, "m": torch.sqrt(values["m"] ** 2 + 2 * variance)}
