"""Directions, values and flux for the tests of laws of reflection."""

from __future__ import annotations

import math

import numpy as np
import torch
from hypothesis import settings
from hypothesis import strategies as st
from torch import Tensor

from torchlc.brdf import Brdf, Incidence, incidence

SHORT = settings(max_examples=25, deadline=None, derandomize=True)
Z, X = torch.eye(3, dtype=torch.float64)[[2, 0]]


def unit(*shape: int, seed: int, up: bool = False) -> Tensor:
    vector = torch.randn(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    if up:
        vector[..., 2] = vector[..., 2].abs()
    return torch.nn.functional.normalize(vector, dim=-1)


def at(angle_deg: float, azimuth_deg: float = 0.0) -> Tensor:
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    sine = math.sin(angle)
    return torch.tensor(
        [sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(angle)], dtype=torch.float64
    )


def tilted(angle: Tensor) -> tuple[Tensor, Tensor]:
    """Normal and u of a facet turned about y by angles in rad."""
    sine, cosine, zero = torch.sin(angle), torch.cos(angle), 0 * angle
    return torch.stack([sine, zero, cosine], -1), torch.stack([cosine, zero, -sine], -1)


def numbers(**values: float) -> dict[str, Tensor]:
    return {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}


def one_row(angles: Incidence, weight: Tensor) -> tuple[Incidence, Tensor]:
    fields = torch.broadcast_tensors(
        angles.cos_i, angles.cos_r, angles.cos_half, angles.log_u, angles.log_v, weight
    )
    *fields, weight = (field.reshape(1, -1) for field in fields)
    return Incidence(*fields), weight


def flux(
    model: type[Brdf], values: dict[str, Tensor], normal: Tensor, u: Tensor, s: Tensor, o: Tensor
) -> Tensor:
    """f_r mu0 mu of single facets, in the way a scene computes it."""
    angles = incidence(normal, u, s, o)
    angles, weight = one_row(angles, angles.lit_and_seen.to(s.dtype))
    specular, diffuse = model.parts(model.tabulate(angles, weight), values)
    return specular + diffuse


@st.composite
def any_values(draw: st.DrawFn, model: type[Brdf]) -> dict[str, float]:
    """Values anywhere in the allowed range, bounds included."""
    values, left = {}, 1.0
    for quantity in model.quantities:
        share = draw(st.floats(0.0, 1.0))
        if quantity.name in model.simplex:
            values[quantity.name] = left * share
            left -= values[quantity.name]
        elif quantity.prior == "loguniform":
            shift = 0.0 if quantity.low else 1.0
            ratio = (quantity.high + shift) / (quantity.low + shift)
            value = (quantity.low + shift) * ratio**share - shift
            values[quantity.name] = min(max(value, quantity.low), quantity.high)
        else:
            values[quantity.name] = quantity.low + (quantity.high - quantity.low) * share
    return values


def reflectance(model: type[Brdf], values: dict[str, Tensor], incidence_deg: float, axis_deg: float) -> float:
    """Share of the light from one direction that leaves the facet, by brute force.

    Half of the samples follow the half vector, graded towards the lobe (d omega_o = 4 (h.s) d omega_h), and
    integrate the lobe; the others are uniform in the exit cosine and integrate the diffuse part.
    """
    s, azimuths = at(incidence_deg), 128
    node, share = (torch.tensor(x) for x in np.polynomial.legendre.leggauss(160))
    phi = 2 * math.pi * (torch.arange(azimuths, dtype=torch.float64) + 0.5) / azimuths
    around = torch.stack([torch.cos(phi), torch.sin(phi)], -1)

    def directions(sine: Tensor, cosine: Tensor) -> Tensor:
        flat = sine[:, None, None] * around
        return torch.cat([flat, cosine[:, None, None].expand(-1, azimuths, 1)], -1)

    def total(o: Tensor, solid_angle: Tensor, part: int) -> float:
        angles = incidence(Z, at(90.0, axis_deg), s, o)
        weight = torch.where(angles.lit_and_seen, solid_angle / angles.cos_i, 0.0)
        angles, weight = one_row(angles, weight)
        return float(model.parts(model.tabulate(angles, weight), values)[part].sum())

    cosine = 0.5 * (node + 1)
    ring = 0.5 * share * 2 * math.pi / azimuths
    diffuse = total(directions(torch.sqrt(1 - cosine**2), cosine), ring[:, None].expand(-1, azimuths), 1)

    width = min(float(model.lobe_variance(values)) ** 0.5, 1.0)
    top = math.asinh(1e3 / width)
    tangent, slope = width * torch.sinh(cosine * top), width * torch.cosh(cosine * top) * top
    cosine = 1 / torch.sqrt(1 + tangent**2)
    half = directions(tangent * cosine, cosine)
    towards = (half * s).sum(-1)
    ring = (share * 0.5 * slope * cosine**2 * tangent * cosine * 2 * math.pi / azimuths)[:, None]
    exits = 2 * towards[..., None] * half - s
    return diffuse + total(exits, torch.where(towards > 0, 4 * towards * ring, 0.0), 0)
