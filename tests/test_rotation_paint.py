"""A body whose opposite sides are painted unlike turns about one axis, though its scene has one paint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import torchlc
from tests.rotating_bodies import Circle, box, recording, scene, steady, unit_of
from torchlc.api import usable
from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.passes import rows_of
from torchlc.inference.rotation.refine import Refiner
from torchlc.inference.rotation.search import FLOOR, STRUCTURE, _unlike
from torchlc.lightcurve.model import LightCurve

PERIOD_S, POLE = 61.7, unit_of(143.0, 36.0)


def test_opposite_sides_of_unlike_paint_are_not_taken_for_a_free_rotation(tmp_path: Path) -> None:
    """Two opposite faces reflect 0.3 of what the others do, which flat facets by numpy sum. A body of one paint repeats after
    half a turn and leaves much; the light itself repeats after the whole turn, and the period is that to 2 %,
    since the bisector goes 20 deg in 6.5 turns, which a turn of the other sense would take for 0.11 turns more."""
    plain = box(2.6, 1.8, 1.2)
    dark = (plain.normal[:, 0] < -0.5) | (plain.normal[:, 1] < -0.5)
    painted = replace(plain, area=plain.area * np.where(dark, 0.3, 1.0))
    rng = np.random.default_rng(11)
    middle = unit_of(30.0, 20.0)
    axis = np.cross(middle, [0.3, -0.2, 1.0])
    circle = Circle(middle, axis / np.linalg.norm(axis), np.radians(40) / 400, 1500.0)
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
    two_paints = _unlike(rows, body, states, bounds, 120)[0]
    assert one_paint.chi2 > 5 * len(rows.flux)
    assert two_paints.chi2 < STRUCTURE * len(rows.flux)
    assert abs(two_paints.frequency * PERIOD_S - 1) < 0.02
