"""Oren and Nayar (1994): rough diffuse surfaces, flatter than Lambert's and brighter towards the light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchlc.brdf.angles import TINY_COS, Incidence, lambert, per_epoch, retro
from torchlc.brdf.base import Brdf
from torchlc.parameters import REFLECTANCE, Quantity

MOST_SIGMA = 40.0
"""deg; up to here the law is compared with the integral over cavities."""
NEARLY = 1 - 1e-12
"""What is cut at the roughest surface's darkness stays above it by more than rounding."""


class OrenNayar(Brdf):
    """Light once scattered by V-shaped cavities with Lambert walls: L1 of Oren and Nayar's full model.

    f_r = albedo / pi [C1 + cos(azimuth) C2 tan(b) + (1 - |cos(azimuth)|) C3 tan((a + b) / 2)]; a and b are the
    larger and the smaller of the two angles to the normal. With s2, the square of ``sigma`` in rad:

    - C1 = 1 - 0.5 s2 / (s2 + 0.33).
    - C2 = 0.45 s2 / (s2 + 0.09) (sin(a) - [azimuth > 90 deg] (2 b / pi)^3).
    - C3 = 0.125 s2 / (s2 + 0.09) (4 a b / pi^2)^2.

    Sigma 0 is Lambert's law. It follows the integral over Gaussian cavities within 0.03 mag rms up to 80 deg
    from the normal where sigma is at least 20 deg, 0.06 mag below; their shorter, qualitative model (A and B alone) by
    0.07 to 0.3 mag. Neglected: light scattered more than once within a cavity, 0.03 mag at sigma = 30 deg and
    albedo 0.2, 0.13 mag at albedo 0.9 (`eon` keeps all of it). At grazing light the fit sends out up to 0.2 % too
    much of a white surface's light. At sigma = 40 deg, more than 88 deg from the normal on opposite sides, the fit would
    fall to 2 % of Lambert's law below none, and is cut there: no sigma sends out less than none.
    """

    model: ClassVar[str] = "oren-nayar"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "albedo", "", 0.0, 1.0, "share of the light that the walls of cavities scatter", role=REFLECTANCE
        ),
        Quantity("sigma", "deg", 0.0, MOST_SIGMA, "standard deviation of the angles of the cavities' walls"),
    )
    additive: ClassVar[bool] = True

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        cos_i, cos_r = angles.cos_i.clamp(min=0), angles.cos_r.clamp(min=0)
        high, low = torch.minimum(cos_i, cos_r), torch.maximum(cos_i, cos_r)  # cosines of a and of b
        sin_a, sin_b = (torch.sqrt((1 - c * c).clamp(min=TINY_COS**2)) for c in (high, low))
        a, b = torch.atan2(sin_a, high), torch.atan2(sin_b, low)
        back = retro(angles)
        behind = torch.where(back < 0, (2 * b / math.pi) ** 3 / sin_a, 0.0)
        towards = 0.45 * back * high * (1 - behind)
        bent = 4 * a * b / math.pi**2
        beside = bent * (bent - 4 / math.pi**2 * back.abs() * (a / sin_a) * (b / sin_b))  # (1 - |cos|) bent^2
        middle = (
            cos_i * cos_r * (sin_a + sin_b) / (cos_i + cos_r).clamp(min=TINY_COS)
        )  # mu0 mu tan((a + b) / 2)
        smooth = lambert(angles)
        # where the roughest surface sends out nothing the smoother ones, whose share of the bent part is less, send out some
        flat, bent_share = _shares(angles.cos_i.new_tensor(math.radians(MOST_SIGMA)) ** 2)
        rough = torch.maximum(
            (towards + 0.125 * beside * middle) / math.pi, -smooth * flat / bent_share * NEARLY
        )
        return {"smooth": (weight * smooth).sum(-2), "rough": (weight * rough).sum(-2)}

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        albedo, square = per_epoch(values["albedo"]), per_epoch(torch.deg2rad(values["sigma"]) ** 2)
        flat, bent = _shares(square)
        diffuse = albedo * (flat * table["smooth"] + bent * table["rough"])
        return torch.zeros_like(diffuse), diffuse


def _shares(square: Tensor) -> tuple[Tensor, Tensor]:
    """C1 and what multiplies the two bent terms, of the square of sigma in rad."""
    return 1 - 0.5 * square / (square + 0.33), square / (square + 0.09)
