"""Blinn and Phong's lobe about the half vector, normalised to keep energy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, lambert, lobe, per_epoch, per_pair
from torchlc.brdf.base import Brdf
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, REFLECTANCE, Quantity


class PhongHalf(Brdf):
    """f_r = r_diff / pi + r_spec (n + 2) (n + 4) / (8 pi (n + 2^(-n/2))) (n.h)^n.

    The factor makes r_spec the lobe's reflectance at normal incidence, for every n (Giesen 2009). Away from
    it a narrow lobe darkens as the squared cosine of the incidence, 1.5 mag at 60 degrees: no masking term is
    there to divide by.
    """

    model: ClassVar[str] = "phong-half"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("n", "", 0.0, 1e6, "lobe exponent about the half vector", prior="loguniform", role=EXPONENT),
        Quantity(
            "r_spec", "", 0.0, 1.0, "mirror-like reflectance at normal incidence", role=LOBE_REFLECTANCE
        ),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex: ClassVar[tuple[str, ...]] = ("r_spec", "r_diff")

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        cosines = angles.cos_i.clamp(min=0) * angles.cos_r.clamp(min=0)
        return {
            "log_half": angles.log_half,
            "lobe": weight * cosines / (8 * math.pi),
            "diffuse": (weight * lambert(angles)).sum(-2),
        }

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        n = per_pair(values["n"])
        n = n / (n * table.get("spread", 0.0)).clamp(min=1)
        log_norm = torch.log((n + 2) * (n + 4) / (n + torch.exp2(-0.5 * n)))
        specular = (table["lobe"] * lobe(torch.addcmul(log_norm, n, table["log_half"]))).sum(-2)
        return per_epoch(values["r_spec"]) * specular, per_epoch(values["r_diff"]) * table["diffuse"]

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        return 1 / values["n"]

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        return {**values, "n": values["n"] / (1 + values["n"] * variance)}
