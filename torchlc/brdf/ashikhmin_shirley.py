"""Ashikhmin and Shirley (2000): the paper's model, eqs. 2 to 6, isotropic or anisotropic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.base import Brdf, Incidence, coupled_diffuse, lobe, per_epoch, per_pair, schlick_weight
from torchlc.parameters import Quantity


class AshikhminShirley(Brdf):
    """Half-vector cosine-power lobe with Schlick's Fresnel factor, and a diffuse part coupled to it.

    ``n`` sets n_u = n_v. The factor mu0 mu / max(mu0, mu) of eqs. 3, 8 and 9 is taken as min(mu0, mu),
    which has no 0/0 at the limb; the pair min(mu0, mu) / (h.s) is at most 1. Neglected: light scattered
    more than once between microfacets.
    """

    model: ClassVar[str] = "ashikhmin-shirley"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("n_u", "", 0.0, 1e6, "lobe exponent along the facet's u axis", prior="loguniform"),
        Quantity("n_v", "", 0.0, 1e6, "lobe exponent along the facet's v axis", prior="loguniform"),
        Quantity("r_spec", "", 0.0, 1.0, "mirror-like reflectance at normal incidence"),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance"),
    )
    simplex: ClassVar[tuple[str, ...]] = ("r_spec", "r_diff")
    shared: ClassVar[Mapping[str, tuple[str, ...]]] = {"n": ("n_u", "n_v")}

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        """Eq. 6 summed over K; eq. 3 as two weights, F = r_spec (1 - p) + p with p = (1 - h.s)^5."""
        fresnel = schlick_weight(angles.cos_half)
        base = (
            weight * torch.minimum(angles.cos_i, angles.cos_r).clamp(min=0) / (8 * math.pi * angles.cos_half)
        )
        return {
            "log_u": angles.log_u,
            "log_v": angles.log_v,
            "log_half": angles.log_half,
            "normal": base * (1 - fresnel),
            "grazing": base * fresnel,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Eqs. 3 and 6 summed over K."""
        return AshikhminShirley.parts_of_lobe(table, values, *cosine_power(table, *exponents(values)))

    @staticmethod
    def parts_of_lobe(
        table: Mapping[str, Tensor], values: Mapping[str, Tensor], shape: Tensor, norm: Tensor
    ) -> tuple[Tensor, Tensor]:
        """`parts` with another lobe.

        Its ``shape`` (..., K, T) is 1 at h = n and integrates to 2 pi / ``norm`` (...) over the hemisphere.
        """
        r_spec, r_diff = per_epoch(values["r_spec"]), per_epoch(values["r_diff"])
        specular = r_spec * (table["normal"] * shape).sum(-2) + (table["grazing"] * shape).sum(-2)
        return per_epoch(norm) * specular, r_diff * (1 - r_spec) * table["diffuse"]

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        """1 / n of the narrower axis: cos^n is a Gaussian of variance 1/n in its core."""
        return 1 / torch.maximum(*exponents(values))

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        """1/n grows by the variance."""
        n_u, n_v = exponents(values)
        wider = n_u / (1 + n_u * variance)
        if "n" in values:
            return {**values, "n": wider}
        return {**values, "n_u": wider, "n_v": wider if n_u is n_v else n_v / (1 + n_v * variance)}


def exponents(values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """n_u and n_v (...); one and the same tensor for an isotropic lobe."""
    if "n" in values:
        return values["n"], values["n"]
    return values["n_u"], values["n_v"]


def cosine_power(table: Mapping[str, Tensor], n_u: Tensor, n_v: Tensor) -> tuple[Tensor, Tensor]:
    """The lobe of eq. 4, (..., K, T), and its norm (...); one exponential a pair where n_u is n_v."""
    if n_u is n_v:
        return lobe(per_pair(n_u) * table["log_half"]), n_u + 1
    shape = lobe(per_pair(n_u) * table["log_u"] + per_pair(n_v) * table["log_v"])
    return shape, torch.sqrt((n_u + 1) * (n_v + 1))
