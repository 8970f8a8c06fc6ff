"""Lommel-Seeliger plus Lambert, the law of asteroid inversion (Kaasalainen, Torppa and Muinonen 2001)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import TINY_COS, Incidence, lambert, per_epoch
from torchlc.brdf.base import Brdf
from torchlc.parameters import REFLECTANCE, Quantity


class LommelSeeligerLambert(Brdf):
    """f_r mu0 mu = albedo mu0 mu (1 / (mu0 + mu) + weight) / pi: single scattering, and Lambert's law.

    ``albedo`` is a scale, not a Bond albedo: the hemispherical reflectance at grazing incidence is albedo (2
    + weight), so energy is kept only up to albedo = 1 / (2 + weight). A surface of single-scattering albedo w
    has albedo = w / 4. Neglected: the phase function, 0.03 to 0.05 mag per degree for asteroids, and the
    opposition surge.
    """

    model: ClassVar[str] = "lommel-seeliger-lambert"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity("weight", "", 0.0, 10.0, "weight of Lambert's law beside Lommel and Seeliger's"),
        Quantity("albedo", "", 0.0, 1.0, "scale of both laws together", role=REFLECTANCE),
    )
    defaults: ClassVar[Mapping[str, float]] = {"albedo": 1.0}
    additive: ClassVar[bool] = True

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        cos_i, cos_r = angles.cos_i.clamp(min=0), angles.cos_r.clamp(min=0)
        seeliger = cos_i * cos_r / (math.pi * (cos_i + cos_r).clamp(min=TINY_COS))
        return {"seeliger": (weight * seeliger).sum(-2), "lambert": (weight * lambert(angles)).sum(-2)}

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        weight, albedo = per_epoch(values["weight"]), per_epoch(values["albedo"])
        diffuse = albedo * (table["seeliger"] + weight * table["lambert"])
        return torch.zeros_like(diffuse), diffuse
