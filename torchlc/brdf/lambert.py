"""Lambert's law: equal radiance in every direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, lambert, per_epoch
from torchlc.brdf.base import Brdf
from torchlc.parameters import REFLECTANCE, Quantity


class Lambert(Brdf):
    """f_r = albedo / pi."""

    model: ClassVar[str] = "lambert"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("albedo", "", 0.0, 1.0, "share of the incident light that is scattered", role=REFLECTANCE),
    )
    radiance_as_irradiance: ClassVar[bool] = True
    additive: ClassVar[bool] = True

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        return {"diffuse": (weight * lambert(angles)).sum(-2)}

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        diffuse = per_epoch(values["albedo"]) * table["diffuse"]
        return torch.zeros_like(diffuse), diffuse
