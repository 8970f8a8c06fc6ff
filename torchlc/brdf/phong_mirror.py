"""Phong's lobe about the mirror direction, normalised to keep energy (Lafortune and Willems 1994)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, lambert, lobe, per_epoch, per_pair
from torchlc.brdf.base import Brdf
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, REFLECTANCE, Quantity


class PhongMirror(Brdf):
    """f_r = r_diff / pi + r_spec (n + 2) / (2 pi) cos^n(angle to the mirror direction), 0 beyond 90 degrees.

    r_spec is the lobe's reflectance at normal incidence; elsewhere it falls as the cosine of the incidence,
    the price of reciprocity. In the glint angle the lobe is half as wide as in the mirror angle, so it has
    the width of a half-vector exponent of 4 n. Neglected: Fresnel's rise to grazing incidence and the masking
    that would undo the cosine, 0.75 mag at 60 degrees of incidence.
    """

    model: ClassVar[str] = "phong-mirror"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "n", "", 0.0, 1e6, "lobe exponent about the mirror direction", prior="loguniform", role=EXPONENT
        ),
        Quantity(
            "r_spec", "", 0.0, 1.0, "mirror-like reflectance at normal incidence", role=LOBE_REFLECTANCE
        ),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex: ClassVar[tuple[str, ...]] = ("r_spec", "r_diff")

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        """1 - cos(mirror angle) = 2 [(h.s)^2 sin^2(glint) + (mu0 - mu)^2 / 4], a sum without cancellation."""
        sin2 = -torch.expm1(2 * angles.log_half)
        below = 2 * angles.cos_half**2 * sin2 + 0.5 * (angles.cos_i - angles.cos_r) ** 2
        ahead = below < 1
        cosines = angles.cos_i.clamp(min=0) * angles.cos_r.clamp(min=0)
        return {
            "log_mirror": torch.log1p(-torch.where(ahead, below, 0.5)),
            "lobe": torch.where(ahead, weight * cosines / (2 * math.pi), 0.0),
            "diffuse": (weight * lambert(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        n = per_pair(values["n"])
        n = n / (4 * n * table.get("spread", 0.0)).clamp(min=1)
        specular = (table["lobe"] * lobe(torch.addcmul(torch.log(n + 2), n, table["log_mirror"]))).sum(-2)
        return (
            per_epoch(values["r_spec"]) * specular,
            per_epoch(values["r_diff"]) * table["diffuse"],
        )

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        return 0.25 / values["n"]

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        """A normal that turns by an angle turns the mirror direction by twice that."""
        return {**values, "n": values["n"] / (1 + 4 * values["n"] * variance)}
