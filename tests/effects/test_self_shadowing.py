"""Shadow and occlusion between parts, against areas worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.cases import AU_KM, flux, material, seen_from, still, tilted, unit

LAMBERT = material("white", 0.0, 0.0, 0.6)
TWO = """
    [[components]]
    name = "low"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
    [[components]]
    name = "high"
    shape = "plate"
    size = [2.0, 2.0]
    centre = [0, 0, 1]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "white"
"""
ONE = TWO[: TWO.index("[[components]]", 5 + TWO.index("[[components]]"))]


@pytest.mark.parametrize("polar_deg", [10.0, 30.0, 44.0])
def test_plate_over_plate_hides_the_union_of_shadow_and_occlusion(tmp_path, polar_deg):
    """Sun and observer at equal angles on opposite sides: of the lower plate the Sun reaches one strip, the
    observer sees the other, and nothing is both: only the upper plate, 1 m above, shines."""
    scene = still(TWO, LAMBERT)
    single = still(ONE, LAMBERT)
    to_sun, to_observer = tilted(np.array([polar_deg])), tilted(np.array([polar_deg]), 180.0)
    lit = flux(single, seen_from(single, tmp_path, to_sun, to_observer))
    found = flux(scene, seen_from(scene, tmp_path, to_sun, to_observer), ["self_shadowing"])
    assert float(found[0] / lit[0]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("polar_deg", [10.0, 30.0, 44.0])
def test_plate_over_plate_leaves_the_strip_that_both_reach(tmp_path, polar_deg):
    """Sun and observer in the same direction: shadow and occlusion coincide, and a strip of width
    tan(angle) of the 2 m plate is lit and seen: the union, where a product would leave the square of it."""
    scene, single = still(TWO, LAMBERT), still(ONE, LAMBERT)
    direction = tilted(np.array([polar_deg]))
    lit = flux(single, seen_from(single, tmp_path, direction, direction))
    found = flux(scene, seen_from(scene, tmp_path, direction, direction), ["self_shadowing"])
    strip = np.tan(np.radians(polar_deg)) / 2.0
    assert float(found[0] / lit[0]) == pytest.approx(1.0 + strip, abs=1e-9)


def test_earthshine_is_hidden_from_the_observer_but_not_by_the_suns_shadow(tmp_path):
    """Earth and observer below to one side, the Sun above: what the upper plate shades is lit by the Earth
    all the same, and what the upper plate hides from the observer is not seen by the Earth's light
    either."""
    scene = still(TWO, LAMBERT)
    position = 7000.0 * tilted(180.0)
    sun = AU_KM * unit(np.array([0.0, 0.0, -1.0])) - position
    for polar_deg, share in ((0.0, 1.0), (20.0, 1.0 + np.tan(np.radians(20.0)) / 2)):
        to_observer = tilted(np.array([polar_deg]))
        case = seen_from(scene, tmp_path, unit(sun), to_observer, position=position)
        alone = still(ONE, LAMBERT)
        both, single = (
            flux(one, case, ["self_shadowing", "earthshine"], earthshine__albedo=0.3)[0]
            for one in (scene, alone)
        )
        assert both / single == pytest.approx(share, rel=1e-9)
