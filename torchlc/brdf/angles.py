"""Angles of light on a facet, and what laws of reflection make of them alike.

Shapes: T epochs, K = facets x quadrature nodes, ``...`` any batch; the last axis of a direction is 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.tensors.vectors import dot

TINY_COS = 1e-15
"""Floor of a cosine that is divided by or whose logarithm is taken."""
FEW_PAIRS = 8
"""Pairs a row up to which a sum over them is taken pair by pair."""


@dataclass(frozen=True)
class Incidence:
    """Angles of light on a facet; all fields broadcast together.

    With s to the Sun, o to the observer, h = unit(s + o), n the normal: ``cos_i`` = n.s, ``cos_r`` = n.o,
    ``cos_half`` = h.s = cos(phase / 2). The lobe of eq. 4 is (n.h)^z = exp(n_u ``log_u`` + n_v ``log_v``),
    and ``log_u + log_v`` = log(n.h).
    """

    cos_i: Tensor
    cos_r: Tensor
    cos_half: Tensor
    log_u: Tensor
    log_v: Tensor

    @property
    def log_half(self) -> Tensor:
        """log(n.h): the logarithm of the cosine of the glint angle."""
        return self.log_u + self.log_v

    @property
    def lit_and_seen(self) -> Tensor:
        """True where the facet faces both the Sun and the observer."""
        return (self.cos_i > 0) & (self.cos_r > 0)

    def flattened(self) -> Incidence:
        """Every pair as an epoch of its own, (1, N): K = 1."""
        fields = torch.broadcast_tensors(self.cos_i, self.cos_r, self.cos_half, self.log_u, self.log_v)
        return Incidence(*(field.reshape(1, -1) for field in fields))


def incidence(normal: Tensor, u: Tensor, to_sun: Tensor, to_observer: Tensor) -> Incidence:
    """Angles from unit vectors (..., 3) that broadcast; ``u`` lies in the facet and v = n x u."""
    bisector = to_sun + to_observer
    v = torch.linalg.cross(*torch.broadcast_tensors(normal, u))
    return projected(
        dot(normal, to_sun),
        dot(normal, to_observer),
        dot(u, bisector),
        dot(v, bisector),
        dot(bisector, bisector),
    )


def projected(cos_i: Tensor, cos_r: Tensor, along_u: Tensor, along_v: Tensor, square: Tensor) -> Incidence:
    """Angles from the cosines and from s + o: its components along u and v, and the square of its length.

    log(n.h) = -1/2 log(1 + tan^2) of the glint angle, which keeps its digits near the glint, where the
    cosine has lost them; behind the facet it is near log(TINY_COS).
    """
    ahead = (cos_i + cos_r).clamp(min=TINY_COS)
    tan_u, tan_v = (along_u / ahead) ** 2, (along_v / ahead) ** 2
    tan2 = (tan_u + tan_v).clamp(min=TINY_COS**2)
    per_square = -0.5 * torch.log1p(tan2) / tan2
    return Incidence(
        cos_i=cos_i,
        cos_r=cos_r,
        cos_half=0.5 * torch.sqrt(square.clamp(min=4 * TINY_COS**2)),
        log_u=tan_u * per_square,
        log_v=tan_v * per_square,
    )


def schlick_weight(cos_half: Tensor) -> Tensor:
    """(1 - h.s)^5 of Schlick's Fresnel factor F = r + (1 - r) (1 - h.s)^5, eq. 5."""
    below = (1 - cos_half).clamp(min=0)
    square = below * below
    return square * square * below


def lambert(angles: Incidence) -> Tensor:
    """mu0 mu / pi: the flux of a white Lambert facet."""
    return angles.cos_i.clamp(min=0) * angles.cos_r.clamp(min=0) / math.pi


def retro(angles: Incidence) -> Tensor:
    """s.o - mu0 mu = sin sin cos(azimuth between Sun and observer): positive where both are on one side."""
    return 2 * angles.cos_half**2 - 1 - angles.cos_i * angles.cos_r


def coupled_diffuse(angles: Incidence) -> Tensor:
    """mu0 mu times the diffuse shape of eq. 6: 28/(23 pi) [1 - (1 - mu0/2)^5] [1 - (1 - mu/2)^5].

    The shape leaves to grazing light what Schlick's factor reflects there, so lobe and diffuse part never
    exceed 1 together.
    """
    cos_i, cos_r = angles.cos_i.clamp(min=0), angles.cos_r.clamp(min=0)
    return 28 / (23 * math.pi) * cos_i * cos_r * _less_fifth(cos_i) * _less_fifth(cos_r)


def _less_fifth(cosine: Tensor) -> Tensor:
    """1 - (1 - c/2)^5 for c in [0, 1], with all its digits."""
    total = 0.3125 - cosine / 32
    for coefficient in (1.25, 2.5, 2.5):
        total = coefficient - cosine * total
    return cosine * total


def lobe(exponent: Tensor) -> Tensor:
    """exp(exponent), kept far above the denormal numbers, whose arithmetic is slower by an order of ten."""
    return exponent.clamp(min=0.85 * math.log(torch.finfo(exponent.dtype).tiny)).exp_()


def weighed(values: Tensor, weight: Tensor) -> Tensor:
    """Sum over K of values (..., K, T) times weight (..., K, T); a few pairs one after the other, so that
    nothing of the size of all is written."""
    pairs = weight.shape[-2]
    if pairs > FEW_PAIRS:
        return (values * weight).sum(-2)
    total = values[..., 0, :] * weight[..., 0, :]
    for pair in range(1, pairs):
        total = torch.addcmul(total, values[..., pair, :], weight[..., pair, :])
    return total


def per_epoch(value: Tensor) -> Tensor:
    """A parameter (...) shaped to meet (T,)."""
    return value[..., None]


def per_pair(value: Tensor) -> Tensor:
    """A parameter (...) shaped to meet (K, T)."""
    return value[..., None, None]


def schlick_parts(
    table: Mapping[str, Tensor], f0: Tensor, diffuse: Tensor, slopes: Tensor
) -> tuple[Tensor, Tensor]:
    """Lobe and diffuse part of a law whose Fresnel factor is Schlick's with ``f0`` (...) and whose ``diffuse`` reflectance (...) is that of
    :func:`coupled_diffuse`: ``slopes`` (..., K, T) is what microfacets send of the table's ``normal`` and ``grazing`` weights."""
    f0 = per_epoch(f0)
    specular = f0 * (table["normal"] * slopes).sum(-2) + (table["grazing"] * slopes).sum(-2)
    return specular, per_epoch(diffuse) * (1 - f0) * table["diffuse"]
