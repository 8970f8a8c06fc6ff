"""Cook and Torrance (1982): Beckmann's slopes in V-shaped cavities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import (
    Incidence,
    coupled_diffuse,
    lobe,
    per_epoch,
    per_pair,
    schlick_parts,
    schlick_weight,
)
from torchlc.brdf.base import Brdf
from torchlc.brdf.fresnel import conductor, dielectric, least_schlick
from torchlc.parameters import FRESNEL, INDEX, REFLECTANCE, WIDTH, Quantity


class CookTorrance(Brdf):
    """f_r = F D G / (4 mu0 mu) plus the diffuse part of eq. 6; D = exp(-tan^2 / m^2) / (pi m^2 cos^4).

    G = min(1, 2 (n.h) min(mu0, mu) / (h.s)) is the V-cavities' (Torrance and Sparrow 1967), F is Schlick's
    with f0. The denominator is 4, which keeps energy, where the original has pi with another D. The diffuse
    part is that of Ashikhmin and Shirley with f0 for r_spec: a plain Lambert term would exceed 1 with F at
    grazing incidence.
    """

    model: ClassVar[str] = "cook-torrance"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "m", "", 1e-3, 1.0, "rms slope of the microfacets times sqrt 2", prior="loguniform", role=WIDTH
        ),
        Quantity("f0", "", 0.0, 1.0, "Fresnel reflectance at normal incidence", role=FRESNEL),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex: ClassVar[tuple[str, ...]] = ("f0", "r_diff")
    coupled: ClassVar[bool] = True
    edged: ClassVar[bool] = True

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        fresnel, (tan2, base) = schlick_weight(angles.cos_half), cavities(angles, weight)
        return {
            "tan2": tan2,
            "normal": base * (1 - fresnel),
            "grazing": base * fresnel,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        return schlick_parts(table, values["f0"], values["r_diff"], slopes_of(table, values["m"]))

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        return 0.5 * values["m"] ** 2

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        return {**values, "m": torch.sqrt(values["m"] ** 2 + 2 * variance)}


class CookTorranceDielectric(CookTorrance):
    """Cook and Torrance with Fresnel's own equations for a dielectric: glass, paint, plastic.

    ``cook-torrance`` with ``ior`` in place of f0 is this law. Schlick's factor with the same f0 is off by up to 0.29 mag for
    glass, at 55 deg of incidence on a microfacet. The diffuse part has the least f0
    whose Schlick factor is nowhere below Fresnel's. Neglected: polarisation, and light that leaves on another side.
    """

    model: ClassVar[str] = "cook-torrance-dielectric"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "m", "", 1e-3, 1.0, "rms slope of the microfacets times sqrt 2", prior="loguniform", role=WIDTH
        ),
        Quantity("ior", "", 1.0, 5.0, "refractive index of a dielectric", role=INDEX),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex: ClassVar[tuple[str, ...]] = ()
    form_of: ClassVar[str] = "cook-torrance"

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        tan2, base = cavities(angles, weight)
        return {
            "tan2": tan2,
            "cos_half": angles.cos_half,
            "base": base,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        ior = values["ior"]
        fresnel = dielectric(table["cos_half"], per_pair(ior))
        f0 = least_schlick(lambda cosine: dielectric(cosine, per_epoch(ior)), ior)
        specular = (table["base"] * fresnel * slopes_of(table, values["m"])).sum(-2)
        return specular, per_epoch(values["r_diff"] * (1 - f0)) * table["diffuse"]


class CookTorranceConductor(CookTorranceDielectric):
    """Cook and Torrance with Fresnel's own equations for a metal of complex index eta + i k.

    ``cook-torrance`` with ``eta`` and ``k`` in place of f0 is this law. Schlick's factor with the same f0 misses the dip of
    metals near 80 deg, by 0.11 mag for aluminium, 0.28 mag for titanium and iron. The diffuse part has the least f0 whose
    Schlick factor is nowhere below Fresnel's. Neglected:
    polarisation, and oxides on the metal.
    """

    model: ClassVar[str] = "cook-torrance-conductor"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "m", "", 1e-3, 1.0, "rms slope of the microfacets times sqrt 2", prior="loguniform", role=WIDTH
        ),
        Quantity("eta", "", 0.01, 10.0, "real part of a metal's refractive index", role=INDEX),
        Quantity("k", "", 0.0, 20.0, "imaginary part of a metal's refractive index", role=INDEX),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        eta, k = values["eta"], values["k"]
        fresnel = conductor(table["cos_half"], per_pair(eta), per_pair(k))
        f0 = least_schlick(lambda cosine: conductor(cosine, per_epoch(eta), per_epoch(k)), eta)
        specular = (table["base"] * fresnel * slopes_of(table, values["m"])).sum(-2)
        return specular, per_epoch(values["r_diff"] * (1 - f0)) * table["diffuse"]


def cavities(angles: Incidence, weight: Tensor) -> tuple[Tensor, Tensor]:
    """tan^2 of the slopes that mirror, and weight G / (4 pi cos^4), (K, T) each."""
    cos_n = torch.exp(angles.log_half).clamp(min=1e-6)
    lower = torch.minimum(angles.cos_i, angles.cos_r).clamp(min=0)
    open_ = (2 * cos_n * lower / angles.cos_half).clamp(max=1)
    return -torch.expm1(2 * angles.log_half) / cos_n**2, weight * open_ / (4 * math.pi * cos_n**4)


def slopes_of(table: Mapping[str, Tensor], m: Tensor) -> Tensor:
    """exp(-tan^2 / m^2) / m^2, (..., K, T)."""
    per_m2 = 1 / per_pair(m**2)
    per_m2 = per_m2 / (2 * per_m2 * table.get("spread", 0.0)).clamp(min=1)
    return lobe(torch.addcmul(torch.log(per_m2), -per_m2, table["tan2"]))
