"""Sunlight by the inverse square of the distance."""

from __future__ import annotations

import numpy as np

from tests.effects.cases import AU_KM, PLATE, flux, seen_from, still, tilted
from tests.effects.passes import magnitudes, orbiting, rows

LAMBERT = '[materials.white]\nmodel = "lambert"\nalbedo = 0.6\n'


def test_inverse_square(tmp_path):
    scene = still(PLATE, LAMBERT)
    distance = np.array([0.5, 0.983, 1.0, 1.017, 3.0])
    recording = seen_from(scene, tmp_path, tilted(20.0), tilted(np.full(5, 10.0)), sun_km=distance * AU_KM)
    ratio = flux(scene, recording, ["sun_distance"]) / flux(scene, recording)
    np.testing.assert_allclose(ratio, distance**-2.0, rtol=1e-12)


def test_october_and_perihelion():
    """17 October 2020: 0.9965 au, -0.008 mag; 2 January 2021: 0.98326 au (Astronomical Almanac)."""
    scene = orbiting()
    for start, au in (("2020-10-17T14:00:00", 0.9965), ("2021-01-02T13:51:00", 0.98326)):
        recording = rows(scene, start, 0.5)
        change = magnitudes(scene, recording, "sun_distance") - magnitudes(scene, recording)
        # the satellite is up to 0.0003 au nearer than the Earth
        np.testing.assert_allclose(change, 5 * np.log10(au), atol=5 * np.log10(1 + 4e-4))
