"""A body whose opposite sides are painted unlike turns about one axis, though its scene has one paint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from tests.rotating_bodies import Circle, box, recording, scene, steady, unit_of
from torchlc.api import usable
from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.fixed_axis import STRUCTURE
from torchlc.inference.rotation.kinds import FLOOR, unlike_sides
from torchlc.inference.rotation.passes import rows_of
from torchlc.inference.rotation.refine import Refiner
from torchlc.lightcurve.model import LightCurve

PERIOD_S, POLE = 61.7, unit_of(143.0, 36.0)


@pytest.mark.long
def test_opposite_sides_of_unlike_paint_are_not_taken_for_a_free_rotation(tmp_path: Path) -> None:
    """Two opposite faces reflect 0.3 of what the others do, which flat facets by numpy sum. A body of one paint repeats after
    half a turn and leaves much; the light itself repeats after the whole turn, and the period is that to 2 %,
    since the bisector goes 20 deg in 6.5 turns, which a turn of the other sense would take for 0.11 turns more."""
    plain = box(2.6, 1.8, 1.2)
    dark = (plain.normal[:, 0] < -0.5) | (plain.normal[:, 1] < -0.5)
    painted = replace(plain, area=plain.area * np.where(dark, 0.3, 1.0))
    rng = np.random.default_rng(11)
    circle = Circle.past(30.0, 20.0, 40.0, 400.0, 1500.0)
    (tmp_path / "scene.toml").write_text(scene(plain, (60.0, 40.0, 140.0)))
    (tmp_path / "seen.ecsv").write_text(
        recording(
            painted,
            lambda seconds: steady(seconds, POLE, PERIOD_S, 0.21),
            [(0.0, np.sort(rng.uniform(0.0, 400.0, 90)), circle)],
            materials=(45.0, 0.18, 0.4),
            noise=0.04,
            rng=rng,
        )
    )
    known = torchlc.load(tmp_path / "scene.toml")
    assert isinstance(known, torchlc.Scene)
    model = LightCurve(known, usable(known, tmp_path / "seen.ecsv"))
    rows, body = rows_of(model), FacetLight.of(model.assembly)
    bounds = (1 / 140.0, 1 / 40.0)
    grid = torch.linspace(*bounds, 90, dtype=torch.float64)
    states = pole_grid.search(rows, body, pole_grid.directions(300), grid, symmetry=2)
    still = torch.zeros(3, dtype=torch.float64)
    one_paint = Refiner(rows, body, FLOOR).refined(states[:12], [still] * 12)[0]
    two_paints = unlike_sides(rows, body, states, bounds, 120)[0]
    assert one_paint.chi2 > 5 * len(rows.flux)
    assert two_paints.chi2 < STRUCTURE * len(rows.flux)
    assert abs(two_paints.frequency * PERIOD_S - 1) < 0.02


def test_light_of_painted_facets_adds_up_to_that_of_one_paint() -> None:
    """Light is linear in area: of paints of one exponent, each on facets of its own or sharing one, the columns add up to the light of
    the areas as one paint. To rounding, since both are sums of the same 40 numbers."""
    rng = np.random.default_rng(4)
    normal, sun, observer = (
        torch.nn.functional.normalize(torch.from_numpy(rng.standard_normal((count, 3))), dim=-1)
        for count in (40, 30, 30)
    )
    area = torch.zeros(40, 3, dtype=torch.float64)
    area[:15, 0], area[15:, 1] = torch.from_numpy(rng.random(15)), torch.from_numpy(rng.random(25))
    area[10:20, 2] = 0.5
    painted = FacetLight(normal, area, ("a", "b", "c"), (True,) * 3, (False,) * 3)
    plain = FacetLight(normal, area.sum(-1, keepdim=True), ("all",), (True,), (False,))
    exponent = torch.full((30, 1), 7.0, dtype=torch.float64)
    parts = painted.light(sun, observer, exponent.expand(30, 3))
    whole = plain.light(sun, observer, exponent)
    torch.testing.assert_close(parts[:, :3].sum(-1), whole[:, 0], rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(parts[:, 3:].sum(-1), whole[:, 1], rtol=1e-12, atol=1e-14)
    assert bool((whole > 0).any(0).all())
