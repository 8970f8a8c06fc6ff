"""A geometry that is free: what it leaves out of the Sun's disc, and batches of sizes, against what is worked out without
any of that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.effects.cases import PLATE, flux, material, seen_from, still, tilted
from tests.effects.passes import BODY, CELLS, TUMBLING, WINGS, orbiting
from tests.effects.test_finite_sun import POINTS, disc
from tests.test_gradients import FREE_FOIL, free, tumbling
from torchlc.effects.finite_sun import FEW_SPOKES, disc_nodes
from torchlc.lightcurve.evaluators.contract import TABULATED_MAG
from torchlc.lightcurve.model import LightCurve
from torchlc.pairs.discs import LEFT_OUT_MAG, RULE_ERRORS

SHARP = FREE_FOIL.replace("50.0", "1000.0")
ALL = ("light_time", "sun_distance", "finite_sun", "self_shadowing", "earth_shadow")
SIZES = {
    "body.size_x": 2.0, "body.size_y": 1.7, "body.size_z": 2.2,
    "wing +Y.size_u": 1.7, "wing +Y.size_v": 4.0,
}  # fmt: skip


def sized(sizes: dict[str, float] | None = None) -> str:
    """The box-wing with these sizes, or with all of SIZES free."""
    numbers = {name: free(value, 0.1, 9.0) for name, value in SIZES.items()} if sizes is None else sizes
    body = [numbers[f"body.size_{axis}"] for axis in "xyz"]
    wing = [numbers[f"wing +Y.size_{axis}"] for axis in "uv"]
    components = BODY.replace("[2.0, 1.7, 2.2]", f"[{', '.join(map(str, body))}]")
    return components + WINGS.replace("[1.7, 4.0]", f"[{', '.join(map(str, wing))}]", 1)


def of_flux(components: str, materials: str, effects, count: int = 30) -> LightCurve:
    scene = orbiting(TUMBLING, components, materials)
    return LightCurve(scene, replace(tumbling(scene, count), kind="flux"), effects=list(effects))


# ------------------------------------------------------------------ the disc


def disc_mean(slope: float, curvature: float, azimuth: float) -> float:
    """Mean of exp(z x - q r^2 / 2) over the limb-darkened disc, 1 - 0.6 (1 - mu), by Gauss-Legendre in r^2 and the
    midpoint rule in the azimuth, which converge exponentially: 1e-13 at z = 30."""
    x, w = np.polynomial.legendre.leggauss(120)
    # with mu = sqrt(1 - r^2) as the variable nothing is singular: r dr = - mu dmu
    mu, w = 0.5 * (x + 1), 0.5 * w
    light = w * mu * (1 - 0.6 * (1 - mu))
    angle = 2 * math.pi * (np.arange(160) + 0.5) / 160
    radius = np.sqrt(1 - mu**2)[:, None]
    lobe = np.exp(slope * radius * np.cos(angle - azimuth) - 0.5 * curvature * radius**2)
    return float((light[:, None] * lobe).sum() / (160 * light.sum()))


def test_rules_for_the_disc_err_no_more_than_stated():
    """300 lobes of slopes to 30 and curvatures to 20 across the disc, in any direction, and what is left of the bound at the
    worst of them, so that it is no idle one."""
    generator = np.random.default_rng(0)
    rules = [(np.zeros((1, 2)), np.ones(1))]
    rules.append(tuple(one.numpy() for one in disc_nodes(torch.zeros((), dtype=torch.float64), FEW_SPOKES)))
    slopes, curvatures = 10 ** generator.uniform(-2, 1.5, 300), 10 ** generator.uniform(-4, 1.3, 300)
    azimuths = generator.uniform(0, 2 * math.pi, 300)
    for (points, weights), (factor, power) in zip(rules, RULE_ERRORS, strict=True):
        share = []
        for slope, curvature, azimuth in zip(slopes, curvatures, azimuths, strict=True):
            along = points @ [math.cos(azimuth), math.sin(azimuth)]
            found = weights @ np.exp(slope * along - 0.5 * curvature * (points**2).sum(1))
            bound = factor * (slope**2 + 2 * curvature) ** (power / 2) * math.exp(slope)
            share.append(abs(found - disc_mean(slope, curvature, azimuth)) / bound)
        assert 0.1 < max(share) < 1.0


@pytest.mark.parametrize("n", [1e2, 1e3, 1e4, 1e5, 1e6])
def test_a_glint_of_a_free_attitude_is_that_of_ten_thousand_suns(tmp_path, n):
    """From the middle of the glint outwards through all rules of the disc to where its middle does. Within 0.2 % of the finest
    rule at n = 1e6 and what is stated, of the row; without diffuse light what is fainter than 1e-5 of the peak is none."""
    scene = still(PLATE, material("white", n, 0.9, 0.05))
    off = np.concatenate([np.linspace(0.0, 0.4, 5), np.geomspace(0.6, 30.0, 9)])
    to_sun, to_observer = tilted(20.0 + off), tilted(20.0, 180.0) + 0 * off[:, None]
    found = flux(scene, seen_from(scene, tmp_path, to_sun, to_observer), ["finite_sun", "attitude_offset"])
    expected = []
    for number, (sun, observer) in enumerate(zip(to_sun, to_observer, strict=True)):
        points, weight = disc(sun)
        folder = tmp_path / str(number)
        folder.mkdir()
        single = flux(scene, seen_from(scene, folder, points, np.tile(observer, (POINTS, 1))))
        expected.append(float(weight @ np.asarray(single)))
    error = 2.5 * np.abs(np.log10(found / np.array(expected)))
    assert error.max() < LEFT_OUT_MAG + 1.0857 * 2e-3
    assert error[off > 2.0].max() < LEFT_OUT_MAG


@pytest.mark.parametrize(
    "effects",
    [
        ALL,
        ("panel_offset", *ALL),
        ("attitude_offset", *ALL),
        ("attitude_offset", "finite_sun", "second_material[cells]", "opposition_surge[foil]"),
        ("attitude_offset", "finite_sun", "normal_dispersion[foil]"),
    ],
    ids=["sizes", "panel", "attitude", "materials", "wrinkles"],
)
def test_what_is_left_out_of_the_disc_is_within_what_is_stated(effects):
    """Against tables of every point of the disc for every pair, made for each theta by itself, from n = 1 to 1e6."""
    curve = of_flux(sized(), FREE_FOIL + CELLS, effects)
    stated = LEFT_OUT_MAG + (TABULATED_MAG if curve.evaluation.tabulated else 0.0)
    assert curve.evaluation.error_mag == stated
    theta = curve.parameter_set.sample_prior(12, torch.Generator().manual_seed(1))
    theta[:, curve.names.index("foil.n")] = torch.logspace(0, 6, 12, dtype=theta.dtype)
    with torch.no_grad():
        found = curve.brightness(theta).flux
        expected = []
        for row in theta:
            values = curve.values(row)
            expected.append(
                curve.shine(curve.make_tables(curve.view(values), False, compact=True), values).flux
            )
    expected = torch.stack(expected)
    lit = expected > 1e-6 * expected.amax(-1, keepdim=True)
    error = 2.5 * torch.log10(found[lit] / expected[lit]).abs()
    assert 0 < float(error.max()) < LEFT_OUT_MAG


# ------------------------------------------------------------------ sizes


@pytest.mark.parametrize(
    "effects",
    [(), ("sun_distance", "earth_shadow"), ("self_shadowing",), ("self_shadowing", "panel_offset")],
)
def test_a_batch_of_sizes_is_scenes_of_these_sizes(effects):
    """Against scenes that give the sizes as numbers, whose tables are made without a batch."""
    curve = of_flux(sized(), FREE_FOIL + CELLS, effects)
    generator = torch.Generator().manual_seed(2)
    theta = curve.parameter_set.start().repeat(5, 1)
    columns = [curve.names.index(name) for name in SIZES]
    theta[:, columns] *= 1 + 0.3 * torch.rand(5, len(columns), generator=generator, dtype=theta.dtype)
    with torch.no_grad():
        found = curve.brightness(theta).flux
    for row, light in zip(theta, found, strict=True):
        given = of_flux(
            sized(dict(zip(SIZES, row[columns].tolist(), strict=True))), FREE_FOIL + CELLS, effects
        )
        other = torch.stack([row[curve.names.index(name)] for name in given.names])
        with torch.no_grad():
            expected = given.brightness(other).flux
        torch.testing.assert_close(light, expected, rtol=1e-9, atol=1e-12 * float(expected.max()))
