"""Beckmann's slopes with Smith's masking (Walter et al. 2007): a lobe that ends sharply, as of ground metal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import TINY_COS, Incidence, coupled_diffuse, per_pair, schlick_parts, schlick_weight
from torchlc.brdf.cook_torrance import slopes_of
from torchlc.brdf.ggx import Ggx

STEEPEST = 1e3
"""Cotangent over alpha from which on nothing is masked: 1 - G1 is below rounding from 6 on."""


class Beckmann(Ggx):
    """f_r = F D G / (4 mu0 mu) plus the diffuse part of eq. 6; D = exp(-tan^2 / alpha^2) / (pi alpha^2 cos^4).

    G is Smith's, separable: G1(mu0) G1(mu), G1 = 2 / (1 + erf(a) + exp(-a^2) / (a sqrt(pi))), a = 1 / (alpha tan) (Walter
    et al. 2007, eqs. 25 and 26 without their fit). ``cook-torrance`` has the same D and the masking of V-shaped cavities. F is Schlick's with f0, and the
    diffuse part that of Ashikhmin and Shirley with f0 for r_spec. Neglected: light scattered more than once
    between microfacets, at normal incidence 0.06 mag of the lobe at alpha = 0.5, 0.84 mag at 1.
    """

    model: ClassVar[str] = "beckmann"
    edged: ClassVar[bool] = True

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        fresnel = schlick_weight(angles.cos_half)
        cos_n = torch.exp(angles.log_half).clamp(min=1e-6)
        base = weight / (4 * math.pi * cos_n**4)
        return {
            "tan2": -torch.expm1(2 * angles.log_half) / cos_n**2,
            "cos_i": angles.cos_i.clamp(min=TINY_COS),
            "cos_r": angles.cos_r.clamp(min=TINY_COS),
            "normal": base * (1 - fresnel),
            "grazing": base * fresnel,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        alpha = values["alpha"]
        seen = slopes_of(table, alpha) * _open(table["cos_i"], alpha) * _open(table["cos_r"], alpha)
        return schlick_parts(table, values["f0"], values["r_diff"], seen)

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        return 0.5 * values["alpha"] ** 2

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        return {**values, "alpha": torch.sqrt(values["alpha"] ** 2 + 2 * variance)}


def _open(cosine: Tensor, alpha: Tensor) -> Tensor:
    """G1, (..., K, T)."""
    sine = torch.sqrt((1 - cosine**2).clamp(min=1e-12))
    a = (cosine / (per_pair(alpha) * sine)).clamp(max=STEEPEST)
    root = math.sqrt(math.pi) * a
    return 2 * root / (root * (1 + torch.erf(a)) + torch.exp(-(a**2)))
