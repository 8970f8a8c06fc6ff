"""Magnitudes by airmass: the table of Kasten & Young (1989)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.effects.passes import LOW_PASS, TUMBLING, magnitudes, orbiting, rows
from tests.paper_orbits import LOW
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import Scene

TABLE = {90.0: 1.0, 60.0: 1.154, 30.0: 1.994, 20.0: 2.904, 10.0: 5.586, 5.0: 10.306}
"""Airmass at altitudes in degrees, from their table II."""


def sky(tmp_path: Path, altitudes) -> tuple[Scene, object]:
    scene = Scene.from_toml(
        """
        format = "torchlc-scene/1"
        name = "ball over a station"
        [orbit]
        altaz = true
        [[stations]]
        id = "here"
        latitude = 37.5
        longitude = 122.0
        height = 0.0
        [attitude]
        mode = "sun"
        [[components]]
        name = "ball"
        shape = "sphere"
        radius = 1.0
        centre = [0, 0, 0]
        material = "white"
        [materials.white]
        model = "lambert"
        albedo = 0.6
        [model]
        effects = []
        """,
        tmp_path, "sky",
    )  # fmt: skip
    lines = ["time,mag,mag_err,alt,az,height"]
    lines += [f"2021-03-20T12:0{i}:00,10,0.1,{alt},180,36000" for i, alt in enumerate(altitudes)]
    path = tmp_path / "sky.csv"
    path.write_text("\n".join(lines) + "\n")
    return scene, load_recording(path, scene)


def test_published_airmass(tmp_path):
    scene, recording = sky(tmp_path, TABLE)
    added = magnitudes(scene, recording, "extinction_residual", extinction_residual__mag_per_airmass=0.05)
    added -= magnitudes(scene, recording)
    np.testing.assert_allclose(added / 0.05 + 1, list(TABLE.values()), rtol=1e-3)


def test_rising_and_setting_alike():
    """A function of airmass alone: rows at one airmass on both sides of the culmination have one change."""
    scene = orbiting(TUMBLING, tle=LOW)
    recording = rows(scene, LOW_PASS, 0.15, 5.0)
    before = magnitudes(scene, recording)
    lit = np.isfinite(before)  # the pass ends in the Earth's shadow or with no facet lit and seen
    after = magnitudes(scene, recording, "extinction_residual", extinction_residual__mag_per_airmass=-0.2)
    airmass = LightCurve(scene, recording, effects=[]).assembly.context.airmass
    assert airmass is not None
    change, order = (after[lit] - before[lit]), np.argsort(airmass.numpy()[lit])
    assert (np.diff(change[order]) <= 1e-12).all()
    assert change.min() < -0.2
    assert np.ptp(change[: lit.sum() // 2]) > 0.1
    assert np.ptp(change[lit.sum() // 2 :]) > 0.1


def test_where_the_airmass_stays(tmp_path):
    effect = registry()["extinction_residual"]()
    scene, recording = sky(tmp_path, [45.0, 45.0])
    context = LightCurve(scene, recording, effects=[]).assembly.context
    assert effect.missing(context) == "the airmass does not change"
    assert effect.missing(replace(context, airmass=None)) == "the airmass is unknown"
    varied = replace(context, airmass=context.seconds + 1.0)
    assert effect.missing(varied) is None
