"""Polished surfaces scatter more light far from the glint than a cosine power does."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf.angles import per_pair
from torchlc.brdf.ashikhmin_shirley import AshikhminShirley, cosine_power, exponents, widened
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, PANEL_GLINT, Shown

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)
"""Of the integral over the lobe, whatever n and g: 24 nodes are 3e-8 off, 48 are exact to rounding."""


class LobeTail(Effect):
    """More light far from the glint than a cosine power gives, and a lower peak for it.

    The lobe is 1 / (1 + (a^-2 - 1) sin^2)^g (generalised Trowbridge-Reitz; g = 2: GGX), as wide at half
    height as the cosine power and with the same integral over the hemisphere. At g = 2 the glint is 0.6 mag
    fainter and the tail at 3 half widths 2.9 mag brighter. Anisotropic lobes take the width of each azimuth
    and the geometric mean of the two norms, as Ashikhmin and Shirley's own does: off by a relative 1/n.
    Neglected: the masking that a tail meets at grazing light, 0.07 mag at 75 deg both ways for n = 200.
    """

    name = "lobe_tail"
    title = "more light far from the glint"
    shown = Shown(NIGHT, PANEL_GLINT, {"g": 2.0}, "panel")
    stage = "material"
    reshapes_lobe = True
    order = 0
    per = "material"
    unable = "the material is not of Ashikhmin and Shirley's model"
    quantities = (
        Quantity(
            "g", "", 1.0, 10.0, "steepness of the tail: 2 is GGX, infinity a cosine power",
            off=math.inf, typical=2.0,
        ),
    )  # fmt: skip

    @classmethod
    def targets(cls, context):
        return [name for name in context.materials if context.models[name] is AshikhminShirley]

    def material(self, reflect, surface, values, p):
        return lambda material: AshikhminShirley.parts_of_lobe(
            surface.table, material, _tailed(surface.table, *exponents(material), p["g"][..., 0])
        )


def _tailed(table: Mapping[str, Tensor], n_u: Tensor, n_v: Tensor, g: Tensor) -> Tensor:
    """Distribution (..., K, T) of integral 2 pi; the cosine power where g is infinite."""
    off = torch.isinf(g)
    g = torch.where(off, 2.0, g)
    wide_u, wide_v = widened(table, n_u, n_v)
    if n_u is n_v:
        n, norm = wide_u, _norm(n_u, g)
    else:
        log_half = torch.where(table["log_half"] < 0, table["log_half"], -1.0)
        share = torch.where(table["log_half"] < 0, table["log_u"] / log_half, 0.5)
        n = wide_u * share + wide_v * (1 - share)
        norm = torch.sqrt(_norm(n_u, g) * _norm(n_v, g))
    peak = torch.sqrt((wide_u + 1) * (wide_v + 1) / per_pair((n_u + 1) * (n_v + 1)))
    sin2 = -torch.expm1(2 * table["log_half"])
    tail = torch.log1p(_steepness(n, per_pair(g)) * sin2)
    tailed = per_pair(norm) * peak * torch.exp(-per_pair(g) * tail)
    return torch.where(per_pair(off), cosine_power(table, n_u, n_v), tailed)


def _steepness(n: Tensor, g: Tensor) -> Tensor:
    """a^-2 - 1 such that (1 + (a^-2 - 1) sin^2)^-g halves where cos^n does, at cos^2 = 4^(-1/n)."""
    return torch.expm1(math.log(2) / g) / -torch.expm1(-2 * math.log(2) / n.clamp(min=1e-3))


def _norm(n: Tensor, g: Tensor) -> Tensor:
    """One over the integral of (1 + k (1 - c^2))^-g for c from 0 to 1, (...), k the steepness.

    Split into c, which has an antiderivative, and 1 - c, small where the lobe is narrow, by Gauss-Legendre
    in log(1 + 2 k (1 - c)).
    """
    k = _steepness(n, g)
    log_k = torch.log1p(k)
    u = (g - 1) * log_k
    near = u.abs() < 1e-6
    ratio = torch.where(near, 1 - 0.5 * u, -torch.expm1(-u) / torch.where(near, 1.0, u))
    closed = 0.5 * log_k / k * ratio
    place, weight = (torch.as_tensor(array).to(n) for array in (0.5 * (NODES + 1), 0.5 * WEIGHTS))
    k, g, span = k[..., None], g[..., None], torch.log1p(2 * k)[..., None]
    grown = torch.expm1(span * place)  # 2 k (1 - c)
    below = grown / (2 * k)
    integrand = below * torch.exp(-g * torch.log1p(grown * (1 - 0.5 * below))) * (1 + grown) / (2 * k)
    return 1 / (closed + (weight * integrand).sum(-1) * span[..., 0])
