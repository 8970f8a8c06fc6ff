"""Sides of a body that shine alike: which one a pass shows is said by how the passes join."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import torchlc
from tests.rotating_bodies import Circle, cylinder, recording, scene, steady, unit_of
from torchlc.api import usable
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.kinds import FLOOR, sides_taken
from torchlc.inference.rotation.passes import rows_of
from torchlc.inference.rotation.pole_grid import GridState
from torchlc.inference.rotation.refine import Local, Refiner
from torchlc.lightcurve.model import LightCurve

PERIOD_S, POLE, PHASE = 61.7, unit_of(143.0, 36.0), 0.21
STARTS = (0.0, 9000.0, 26000.0)
SECTOR = 'sectors = [{ start = 20.0, width = 150.0, material = "other" }]'


def test_passes_are_joined_by_the_side_that_a_steady_turn_shows(tmp_path: Path) -> None:
    """The light, by numpy, is that of a cylinder of one paint; the scene gives part of its side a material of its own, so that half a turn
    is no symmetry of it. With the middle pass taken half a turn on the rows fit as well, but no steady turn of 61.7 s joins the
    passes. Of what comes first the phases are those of t / P but for whole turns and one constant, to 0.01 turns."""
    rng = np.random.default_rng(8)
    body = cylinder(1.2, 6.0)
    passes = []
    for start, (lon, lat) in zip(STARTS, ((30.0, 20.0), (15.0, -40.0), (55.0, 40.0)), strict=True):
        passes.append(
            (start, np.sort(rng.uniform(0.0, 300.0, 70)), Circle.past(lon, lat, 30.0, 300.0, 1500.0))
        )
    text = scene(body, (PERIOD_S, 58.0, 65.0)).replace('material = "body"', f'material = "body"\n{SECTOR}')
    body_material = text[text.index("[materials.body]") : text.index("[model]")]
    text = text.replace("[model]", body_material.replace("body", "other") + "[model]", 1)
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "seen.ecsv").write_text(
        recording(
            body,
            lambda seconds: steady(seconds, POLE, PERIOD_S, PHASE),
            passes,
            materials=(45.0, 0.18, 0.4),
            noise=0.05,
            rng=rng,
        )
    )
    known = torchlc.load(tmp_path / "scene.toml")
    assert isinstance(known, torchlc.Scene)
    model = LightCurve(known, usable(known, tmp_path / "seen.ecsv"))
    rows, facets = rows_of(model), FacetLight.of(model.assembly)
    assert facets.symmetry(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)) == 1
    turns = rows.middle / PERIOD_S
    # rows count from the first of them, and the frame of the search is a quarter of a turn from that of the light
    first = float(np.concatenate([after for _, after, _ in passes])[0])
    start = Local(
        torch.from_numpy(POLE), torch.full((3,), 1 / PERIOD_S, dtype=torch.float64),
        (turns + first / PERIOD_S + PHASE + 0.25 + torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)) % 1.0,
        torch.zeros(3, dtype=torch.float64), torch.full((2,), 45.0, dtype=torch.float64),
        torch.tensor([0.4, 0.4, 0.2, 0.2], dtype=torch.float64), 1e9, torch.eye(6, dtype=torch.float64),
    )  # fmt: skip
    refiner = Refiner(rows, facets, FLOOR)
    # as a search would leave it: at the bottom, with the middle pass half a turn on
    state = GridState(
        start.pole, tuple(start.frequencies.tolist()), tuple(start.phases.tolist()), 0.0, start.weights
    )
    wrong = refiner.refined([state], [start.tilt])[0]
    off = (wrong.phases - turns - (wrong.phases - turns)[0]).numpy()
    assert abs(abs(off[1] - np.round(off[1])) - 0.5) < 0.02
    best = sides_taken(rows, refiner, wrong, 1, (1 / 65.0, 1 / 58.0))[0]
    off = (best.phases - turns - (best.phases - turns)[0]).numpy()
    np.testing.assert_allclose(off - np.round(off), 0.0, atol=0.01)
