"""How a surface reflects: f mu0 mu (sr^-1) of a flat patch, the paper's equations 2-6 as audited.

Geometry is given as unit vectors (N, 3): normal, to_sun, to_observer; the caller leaves out rows where a
cosine is not positive. Every law is written from its defining equation; nothing is shared with the package
under test.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import erf
from sky import Array, unit


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


@lru_cache(maxsize=64)
def tail_lobe(n: float, g: float) -> tuple[float, float]:
    """a^2 - 1 and c of D = c [1 + (a^2 - 1) cos^2]^-g with the cosine power's half width at half maximum.

    (n + 1)/(2 pi) cos^n integrates to 1 over the hemisphere, and so does D (by quadrature).
    """
    cos2 = 2.0 ** (-2.0 / n)
    a2 = (1.0 - cos2) / (2.0 ** (1.0 / g) - cos2)
    gap = np.logspace(-14.0, 0.0, 20001)  # 1 - cos(theta), dense where the lobe is
    shape = (1.0 + (a2 - 1.0) * (1.0 - gap) ** 2) ** -g
    integral = 2.0 * np.pi * np.trapezoid(shape * gap, np.log(gap))
    return a2 - 1.0, 1.0 / float(integral)


def _ashikhmin_shirley(
    material: Mapping[str, Any], geometry: tuple[Array, ...], g: float | None
) -> tuple[Array, Array]:
    """Specular and diffuse f mu0 mu, eq. 3-6; ``g``: a lobe with a heavier tail than the cosine power."""
    cos_i, cos_r, cos_half, cos_sun_half, along_u, along_v = geometry
    r_spec, r_diff = material["r_spec"], material["r_diff"]
    n_u, n_v = material.get("n_u", material.get("n")), material.get("n_v", material.get("n"))
    fresnel = r_spec + (1.0 - r_spec) * (1.0 - cos_sun_half) ** 5
    if g is not None:
        a2_1, constant = tail_lobe(float(n_u), float(g))
        lobe = 0.25 * constant * (1.0 + a2_1 * cos_half**2) ** -g
    else:
        if n_u == n_v:
            exponent = n_u
        else:
            exponent = (n_u * along_u**2 + n_v * along_v**2) / np.maximum(along_u**2 + along_v**2, 1e-300)
        lobe = np.sqrt((n_u + 1.0) * (n_v + 1.0)) / (8.0 * np.pi) * cos_half**exponent
    specular = lobe / cos_sun_half * fresnel * np.minimum(cos_i, cos_r)
    bend = (1.0 - (1.0 - cos_i / 2.0) ** 5) * (1.0 - (1.0 - cos_r / 2.0) ** 5)
    diffuse = 28.0 * r_diff / (23.0 * np.pi) * (1.0 - r_spec) * bend * cos_i * cos_r
    return specular, diffuse


def _conductor(material: Mapping[str, Any], geometry: tuple[Array, ...]) -> tuple[Array, Array]:
    """Rough conductor D G F / 4 with Smith's G over a Lambert base: GGX, or Beckmann's distribution, whose G is
    exact, by the error function (Walter et al. 2007)."""
    cos_i, cos_r, cos_half, cos_sun_half, _, _ = geometry
    alpha2 = material["alpha"] ** 2
    gaussian = material["model"] == "beckmann"
    if gaussian:
        tan2 = 1.0 / np.maximum(cos_half, 1e-9) ** 2 - 1.0
        distribution = np.exp(-tan2 / alpha2) / (np.pi * alpha2 * np.maximum(cos_half, 1e-9) ** 4)
    else:
        distribution = alpha2 / (np.pi * (cos_half**2 * (alpha2 - 1.0) + 1.0) ** 2)

    def seen(cosine: Array) -> Array:
        tan2 = np.maximum(1.0 / cosine**2 - 1.0, 1e-18)
        if gaussian:
            a = 1.0 / np.sqrt(alpha2 * tan2)
            return 2.0 / (1.0 + erf(a) + np.exp(-(a**2)) / (a * np.sqrt(np.pi)))
        return 2.0 / (1.0 + np.sqrt(1.0 + alpha2 * tan2))

    fresnel = material["f0"] + (1.0 - material["f0"]) * (1.0 - cos_sun_half) ** 5
    specular = distribution * seen(cos_i) * seen(cos_r) * fresnel / 4.0
    return specular, material["r_diff"] / np.pi * cos_i * cos_r


def _law(material: Mapping[str, Any], geometry: tuple[Array, ...], g: float | None) -> tuple[Array, Array]:
    model = material.get("model", "ashikhmin-shirley")
    if model == "ashikhmin-shirley":
        return _ashikhmin_shirley(material, geometry, g)
    if model == "lambert":
        return np.zeros_like(geometry[0]), material["albedo"] / np.pi * geometry[0] * geometry[1]
    if model in ("ggx", "beckmann"):
        return _conductor(material, geometry)
    raise ValueError(f"no such truth: {model}")


def reflected(
    material: Mapping[str, Any],
    changes: Mapping[str, Mapping[str, Any]],
    normal: Array,
    u: Array,
    v: Array,
    to_sun: Array,
    to_observer: Array,
) -> Array:
    """f mu0 mu (N,) of a material with its ``changes``: lobe_tail, second_material, opposition_surge."""
    half = unit(to_sun + to_observer)
    geometry = (
        _dot(normal, to_sun),
        _dot(normal, to_observer),
        np.clip(_dot(normal, half), 0.0, 1.0),
        np.clip(_dot(to_sun, half), 1e-9, 1.0),
        _dot(half, u),
        _dot(half, v),
    )
    tail = changes.get("lobe_tail")
    specular, diffuse = _law(material, geometry, tail["g"] if tail else None)
    if "opposition_surge" in changes:
        surge = changes["opposition_surge"]
        tangent = np.sqrt(np.maximum(1.0 - geometry[3] ** 2, 0.0)) / geometry[3]  # tan(phase angle / 2)
        diffuse = diffuse * (1.0 + surge["b0"] / (1.0 + tangent / surge["h"]))
    total = specular + diffuse
    if "second_material" in changes:
        second = changes["second_material"]
        total = (1.0 - second["weight"]) * total + second["weight"] * sum(_law(second, geometry, None))
    return total
