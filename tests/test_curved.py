"""Curved surfaces at any sharpness of the lobe, against sums over a hundred thousand pieces of the true surface of the
published laws, written out here, and against the closed forms of a cylinder and a mirror ball."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchlc
from tests.effects.cases import RANGE_KM, flux, seen_from, still, unit

SHARPNESS = [1.0, 10.0, 1e3, 1e4, 1e5, 3e5, 1e6]
SIZES = {
    "cylinder": "radius = 1.2\nlength = 4.0\naxis = [0.2, 0.1, 1]",
    "cone": "radius = 1.2\nradius_top = 0.3\nlength = 2.0\naxis = [0.2, 0.1, 1]",
    "sphere": "radius = 1.2",
    "dish": "radius = 1.2\ndepth = 0.3\naxis = [0.2, 0.1, 1]",
}
AXIS = unit([0.2, 0.1, 1.0])
FAINT = 1e-3
"""Of the brightest row of a case: rows below it are left out, where light is a lobe's deep tail alone."""


def body(shape: str) -> str:
    return (
        f'[[components]]\nname = "part"\nshape = "{shape}"\n{SIZES[shape]}\n'
        'centre = [0, 0, 0]\nmaterial = "white"\n'
    )


# ------------------------------------------------------------------ the laws as published


def ashikhmin_shirley(mu0, mu, cos_n, cos_h, n, r_spec=0.4, r_diff=0.1):
    """Ashikhmin and Shirley 2000, eqs. 4 and 5, f_r mu0 mu of an isotropic lobe; (n.h)^n from ln cos."""
    fresnel = r_spec + (1 - r_spec) * (1 - cos_h) ** 5
    with np.errstate(divide="ignore"):
        power = np.exp(n * np.log(np.clip(cos_n, 0, 1)))
    spec = (n + 1) / (8 * np.pi) * power * fresnel / (cos_h * np.maximum(mu0, mu))
    diff = 28 * r_diff / (23 * np.pi) * (1 - r_spec)
    diff = diff * (1 - (1 - mu0 / 2) ** 5) * (1 - (1 - mu / 2) ** 5)
    return (spec + diff) * mu0 * mu


def ggx(mu0, mu, cos_n, cos_h, alpha, f0=0.4, r_diff=0.1):
    """Walter et al. 2007, eqs. 33 and 34, with Schlick's Fresnel factor."""
    tan2 = (1 - cos_n**2) / cos_n**2
    d = alpha**2 / (np.pi * cos_n**4 * (alpha**2 + tan2) ** 2)

    def g1(c):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 - c**2) / c**2))

    spec = (f0 + (1 - f0) * (1 - cos_h) ** 5) * d * g1(mu0) * g1(mu) / 4
    diff = 28 * r_diff / (23 * np.pi) * (1 - f0)
    return spec + diff * (1 - (1 - mu0 / 2) ** 5) * (1 - (1 - mu / 2) ** 5) * mu0 * mu


def cook_torrance(mu0, mu, cos_n, cos_h, m, f0=0.4, r_diff=0.1):
    """Cook and Torrance 1982 with Beckmann's slopes and the V-cavities' masking, over 4."""
    d = np.exp(-(1 - cos_n**2) / cos_n**2 / m**2) / (np.pi * m**2 * cos_n**4)
    masked = np.minimum(1, 2 * cos_n * np.minimum(mu0, mu) / cos_h)
    spec = (f0 + (1 - f0) * (1 - cos_h) ** 5) * d * masked / 4
    diff = 28 * r_diff / (23 * np.pi) * (1 - f0)
    return spec + diff * (1 - (1 - mu0 / 2) ** 5) * (1 - (1 - mu / 2) ** 5) * mu0 * mu


LAWS = {
    "ashikhmin-shirley": (ashikhmin_shirley, "n", lambda n: n, "r_spec"),
    "ggx": (ggx, "alpha", lambda n: max(1e-3, (2 / (n + 2)) ** 0.5), "f0"),
    "cook-torrance": (cook_torrance, "m", lambda n: max(1e-3, (2 / (n + 2)) ** 0.5), "f0"),
}


def paint(law: str, n: float) -> str:
    _, name, value, mirror = LAWS[law]
    return f'[materials.white]\nmodel = "{law}"\n{name} = {value(n)!r}\n{mirror} = 0.4\nr_diff = 0.1\n'


# ------------------------------------------------------------------ brute force over the true surface


def frame(axis):
    first = unit(np.cross(axis, [0.3, -0.7, 0.2]))
    return first, np.cross(axis, first)


def round_about(axis, leaning, area, around=200_000):
    """Normals and areas of strips of a surface whose normals lean from the plane across its axis."""
    first, second = frame(axis)
    turn = 2 * np.pi * (np.arange(around) + 0.5) / around
    level = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.cos(leaning) * level + np.sin(leaning) * axis, np.full(around, area / around)


def about(middle, reach=0.5 * np.pi, rings=1200, spokes=800):
    """Unit vectors up to an angle from a direction, most of them near it, and the solid angle of each."""
    first, second = frame(middle)
    edge = reach * np.linspace(0, 1, rings + 1) ** 4
    angle = 0.5 * (edge[1:] + edge[:-1])
    solid = np.repeat((np.cos(edge[:-1]) - np.cos(edge[1:])) * 2 * np.pi / spokes, spokes)
    turn = 2 * np.pi * (np.arange(spokes) + 0.5) / spokes
    level = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    found = np.cos(angle)[:, None, None] * middle + np.sin(angle)[:, None, None] * level
    return found.reshape(-1, 3), solid


def disc(axis, radius):
    return axis[None], np.array([np.pi * radius**2])


def pieces(shape, half):
    """Normals (N, 3) and areas (N,) of all of a body."""
    if shape == "cylinder":
        found = [round_about(AXIS, 0.0, 2 * np.pi * 1.2 * 4.0), disc(AXIS, 1.2), disc(-AXIS, 1.2)]
    elif shape == "cone":
        slant = math.hypot(2.0, 0.9)
        side = round_about(AXIS, math.asin(0.9 / slant), np.pi * 1.5 * slant)
        found = [side, disc(AXIS, 0.3), disc(-AXIS, 1.2)]
    elif shape == "sphere":
        normal, solid = about(half)
        found = [(normal, 1.2**2 * solid)]
    else:  # z = depth (r / radius)^2: Gauss's curvature is (2 depth / radius^2)^2 (n.axis)^4
        found = []
        curvature = (2 * 0.3 / 1.2**2) ** 2
        for axis in (AXIS, -AXIS):
            normal, solid = about(half)
            within = normal @ axis > 1 / math.hypot(1, 2 * 0.3 / 1.2)
            normal, solid = normal[within], solid[within]
            found.append((normal, solid / curvature / (normal @ axis) ** 4))
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


def brute(shape, law, n, sun, observer, share=None):
    half = unit(sun + observer)
    normal, area = pieces(shape, half)
    mu0, mu = normal @ sun, normal @ observer
    lit = (mu0 > 0) & (mu > 0)
    normal, area, mu0, mu = normal[lit], area[lit], mu0[lit], mu[lit]
    cos_n = np.sqrt(
        np.clip(1 - np.sum(np.cross(normal, half) ** 2, -1), 0, None)
    )  # keeps digits at the glint
    function, _, value, _ = LAWS[law]
    light = function(mu0, mu, cos_n, half @ sun, value(n)) * area
    if share is not None:
        light = light * share(normal)
    return light.sum() / (1e3 * RANGE_KM) ** 2


def geometries(shape, count=24):
    """Sun and observer: anywhere, and for a side so that h is within 2 lobes of the line of glints."""
    rng = np.random.default_rng(5)
    sun, observer = unit(rng.normal(size=(2, count, 3)))
    if shape in ("cylinder", "cone"):
        lean = 0.0 if shape == "cylinder" else math.asin(0.9 / math.hypot(2.0, 0.9))
        first, second = frame(AXIS)
        for k in range(count // 2):
            turn = 2 * np.pi * rng.uniform()
            level = np.cos(turn) * first + np.sin(turn) * second
            normal = np.cos(lean + 1e-3 * rng.normal()) * level + np.sin(lean + 1e-3 * rng.normal()) * AXIS
            sun[k] = unit(normal + 0.8 * rng.normal(size=3))
            observer[k] = 2 * (sun[k] @ unit(normal)) * unit(normal) - sun[k]
    if shape == "dish":  # h from well within the rim to just outside it
        rim = math.atan(0.5)
        for k in range(count // 2):
            first = unit(np.cross(AXIS, rng.normal(size=3)))
            lean = rim * (0.4 * k / 3 if k < 4 else 1 + 3e-3 * rng.normal())
            normal = (np.cos(lean) * AXIS + np.sin(lean) * first) * (-1) ** k
            sun[k] = unit(normal + 0.5 * rng.normal(size=3))
            observer[k] = 2 * (sun[k] @ normal) * normal - sun[k]
    return sun, observer


def errors(found, expected):
    """Errors of the rows that are not faint, mag."""
    bright = expected > FAINT * np.median(expected)
    return 2.5 * np.log10(found[bright] / expected[bright])


@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("shape", list(SIZES))
def test_light_of_every_sharpness_is_that_of_the_true_surface(tmp_path, shape, law):
    sun, observer = geometries(shape)
    worst = []
    for n in SHARPNESS:
        scene = still(body(shape), paint(law, n))
        found = np.asarray(flux(scene, seen_from(scene, tmp_path, sun, observer)))
        expected = np.array([brute(shape, law, n, s, o) for s, o in zip(sun, observer, strict=True)])
        left = errors(found, expected)
        worst.append((n, np.sqrt(np.mean(left**2)), np.abs(left).max(), len(left)))
    print(shape, law, *(f"{n:g}: {a:.1e} {b:.1e} ({c})" for n, a, b, c in worst))
    assert max(rms for _, rms, _, _ in worst) < 2e-3
