"""Fresnel's equations for unpolarised light, as reflectances of cosine and optical constants.

Letters: c cosine of the angle between the light and the (micro)facet's normal. All arguments broadcast.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchlc.brdf.angles import TINY_COS


def dielectric(c: Tensor, ior: Tensor) -> Tensor:
    """Mean of the two polarisations' reflectances at a surface of refractive index ``ior``, at least 1 (Born and
    Wolf, sec. 1.5.2)."""
    c = c.clamp(TINY_COS, 1.0)
    square = ior * ior
    g = torch.sqrt(square - 1 + c * c)
    across, along = (g - c) / (g + c), (square * c - g) / (square * c + g)
    return 0.5 * (across * across + along * along)


def conductor(c: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """Mean of the two polarisations' reflectances at a surface of complex index ``eta`` + i ``k``, exact (Born and
    Wolf, sec. 14.2, with a + i b the square root of (eta + i k)^2 - sin^2)."""
    c = c.clamp(TINY_COS, 1.0)
    cos2 = c * c
    sin2 = 1 - cos2
    real, imaginary = eta * eta - k * k - sin2, 2 * eta * k
    size = torch.sqrt((real * real + imaginary * imaginary).clamp(min=TINY_COS**2))
    # a^2 = (size + real) / 2 without cancellation where real is negative
    positive = real >= 0
    other = 0.5 * imaginary * imaginary / torch.where(positive, 1.0, size - real)
    a = torch.sqrt(torch.where(positive, 0.5 * (size + real), other).clamp(min=TINY_COS**2))
    across = (size + cos2 - 2 * a * c) / (size + cos2 + 2 * a * c)
    ratio = (size * cos2 + sin2 * sin2 - 2 * a * c * sin2) / (size * cos2 + sin2 * sin2 + 2 * a * c * sin2)
    return 0.5 * across * (1 + ratio)


def least_schlick(reflectance: Callable[[Tensor], Tensor], like: Tensor) -> Tensor:
    """The least f0 (...) whose Schlick factor is nowhere below a ``reflectance`` of cosines, whose constants are
    ``like`` (...): what a diffuse part below may count on to be left of the light."""
    c = torch.linspace(1.0, 0.05, 20, dtype=like.dtype, device=like.device)
    grazing = (1 - c) ** 5
    return ((reflectance(c) - grazing) / (1 - grazing)).amax(-1).clamp(min=0)
