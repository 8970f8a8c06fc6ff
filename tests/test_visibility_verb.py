"""Areas and shares of components: closed forms, brute force rays, finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchlc
from tests.paper_orbits import ORBIT_1
from tests.rays import blocked as blocked_by
from tests.rays import fraction_lit_and_seen, jittered_points, triangles_of
from torchlc.errors import InputError

TIMES = {"start": "2020-10-17T12:00:00", "hours": 6.0, "cadence": 1800.0}
HEAD = f"""
format = "torchlc-scene/1"
name = "test"
[orbit]
tle = ["{ORBIT_1[0]}", "{ORBIT_1[1]}"]
[[stations]]
id = "weihai"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "inertial"
spin_axis = [1, 2, 3]
spin_rate = 0.37
[model]
effects = []
[materials.m]
n = 10.0
r_spec = 0.1
r_diff = 0.1
"""
BOX = """
[[components]]
name = "box"
shape = "box"
size = [2.0, 1.5, 1.0]
centre = [0, 0, 0]
material = "m"
"""
PLATE = """
[[components]]
name = "plate"
shape = "plate"
size = [2.0, 4.0]
centre = [0.3, 3.0, 0.4]
u = [1, 0, 0]
v = [0, 1, 0]
material = "m"
"""


def scene(*components: str) -> torchlc.Scene:
    return torchlc.Scene.from_toml(HEAD + "".join(components))


def test_a_box_shows_the_sum_of_its_faces():
    """Cross-section of a box: |x| Ay Az + |y| Ax Az + |z| Ax Ay over the direction's components."""
    found = torchlc.visibility(scene(BOX), **TIMES)
    for direction, area in ((found.to_sun, found.area_to_sun), (found.to_observer, found.area_to_observer)):
        sides = np.array([1.5 * 1.0, 2.0 * 1.0, 2.0 * 1.5])
        np.testing.assert_allclose(area[0], np.abs(direction.numpy()) @ sides, rtol=1e-13)
    # three of six faces are lit: half of the surface, whatever the direction
    np.testing.assert_allclose(found.lit, 0.5, rtol=1e-13)
    both = found.lit_and_seen[0].numpy()
    sides = 2 * np.array([1.5, 2.0, 3.0]) / (4 * (1.5 + 2.0 + 3.0))
    same = np.sign(found.to_sun.numpy()) == np.sign(found.to_observer.numpy())
    np.testing.assert_allclose(both, same @ sides, rtol=1e-13)


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        ('shape = "sphere"\nradius = 0.8', lambda d: np.full(len(d), math.pi * 0.64)),
        (
            'shape = "cylinder"\nradius = 0.6\nlength = 2.5\naxis = [0, 0, 1]',
            lambda d: math.pi * 0.36 * np.abs(d[:, 2]) + 2 * 0.6 * 2.5 * np.hypot(d[:, 0], d[:, 1]),
        ),
        (
            'shape = "plate"\nsize = [2.0, 3.0]\nu = [1, 0, 0]\nv = [0, 1, 0]',
            lambda d: 6.0 * np.abs(d[:, 2]),
        ),
    ],
    ids=["sphere", "cylinder", "plate"],
)
def test_outlines_in_closed_form(shape, area):
    """A midpoint rule over 64 facets a turn is within (2 pi/64)^2/12 = 8e-4; a plate is exact."""
    one = f'[[components]]\nname = "one"\n{shape}\ncentre = [0.1, 0.2, 0.3]\nmaterial = "m"\n'
    found = torchlc.visibility(scene(one), **TIMES)
    expected = area(found.to_sun.numpy())
    np.testing.assert_allclose(found.area_to_sun[0], expected, rtol=1e-13 if "plate" in shape else 8e-4)
    velocity = torch.einsum("tji,tj->ti", found.rotation, _velocity(found))
    assert velocity.shape == found.to_sun.shape
    np.testing.assert_allclose(
        found.area_towards["velocity"][0], area(velocity.numpy()), rtol=1e-13 if "plate" in shape else 8e-4
    )


def _velocity(found):
    """Unit velocities of the object from SGP4 itself, turned by nothing: TEME for GCRS is 0.3 deg off, so through the
    package's track."""
    from torchlc.geometry.orbit import make_track, observation_grid

    one = scene(BOX)
    state = make_track(one, observation_grid(one, *TIMES.values())).at(0.0, 0.0, 0.0)
    return torch.nn.functional.normalize(state.velocity, dim=-1)


def test_a_plate_above_a_plate_hides_its_overlap():
    """Seen along the common normal, what a unit plate hides of a 2 x 2 plate is its own square; moved sideways by the
    tangent of the direction, the overlap of two rectangles."""
    below = '[[components]]\nname = "below"\nshape = "plate"\nsize = [2, 2]\ncentre = [0, 0, 0]\nu = [1, 0, 0]\nv = [0, 1, 0]\nmaterial = "m"\n'
    above = (
        below.replace("below", "above")
        .replace("size = [2, 2]", "size = [1, 1]")
        .replace("[0, 0, 0]", "[0, 0, 1]")
    )
    one = scene(below, above)
    found = torchlc.visibility(one, **TIMES)
    tilts = (0.0, 0.4, 0.9, 1.3)
    for tilt in tilts:
        body = torch.tensor([math.sin(tilt), 0.0, math.cos(tilt)], dtype=torch.float64)
        towards = {"tilted": found.rotation @ body}
        area = torchlc.visibility(one, **TIMES, towards=towards).area_towards["tilted"]
        moved = math.tan(tilt)
        # the shadow spans -0.5 - moved to 0.5 - moved on a plate from -1 to 1
        overlap = max(0.0, min(1.0, 0.5 - moved) - max(-1.0, -0.5 - moved))
        np.testing.assert_allclose(area[0], (4.0 - overlap) * math.cos(tilt), rtol=1e-9)
        np.testing.assert_allclose(area[1], 1.0 * math.cos(tilt), rtol=1e-9)


def test_shares_and_areas_against_brute_force_rays():
    """Box and plate with points on every face. Standard error of a share: sqrt(e/2) M^(-3/4), e at most 4 edges and
    M = 40,000: 5e-4 of the face; 2e-3 is four of these."""
    found = torchlc.visibility(scene(BOX, PLATE), **TIMES)
    box = _box_faces(np.array([2.0, 1.5, 1.0]))
    plate = np.array([[-0.7, 1.0, 0.4], [1.3, 1.0, 0.4], [1.3, 5.0, 0.4], [-0.7, 5.0, 0.4]])
    faces = {"box": box, "plate": [plate, plate[[0, 3, 2, 1]]]}
    triangles = {
        "box": np.concatenate([triangles_of(face) for face in box]),
        "plate": triangles_of(plate),
    }
    generator = np.random.default_rng(3)
    shadowed = 0
    for row in range(len(found.seconds)):
        sun, observer = found.to_sun[row].numpy(), found.to_observer[row].numpy()
        for c, name in enumerate(found.components):
            obstacles = triangles["plate" if name == "box" else "box"]
            total = lit = both = area = 0.0
            for face in faces[name]:
                cross = np.cross(face[1] - face[0], face[3] - face[0])
                size = np.linalg.norm(cross)
                total += size
                cos_sun, cos_observer = cross @ sun / size, cross @ observer / size
                if cos_sun > 0:
                    points = jittered_points(face, 40_000, generator)
                    free = 1 - blocked_by(points, sun, obstacles).mean()
                    shadowed += 0.02 < free < 0.98
                    lit += size * free
                    area += size * free * cos_sun
                if min(cos_sun, cos_observer) > 0:
                    both += size * fraction_lit_and_seen(face, obstacles, sun, observer, 40_000, generator)
            assert float(found.lit[c, row]) == pytest.approx(lit / total, abs=2e-3)
            assert float(found.lit_and_seen[c, row]) == pytest.approx(both / total, abs=2e-3)
            assert float(found.area_to_sun[c, row]) == pytest.approx(area, abs=2e-3 * total)
    assert shadowed > 3  # the case is one in which something is hidden


def _box_faces(size):
    faces = []
    for k in range(3):
        for sign in (1.0, -1.0):
            normal = np.zeros(3)
            normal[k] = sign
            u = np.roll(np.eye(3)[k], 1)
            v = np.cross(normal, u)
            corners = [
                0.5 * normal + a * u + b * v for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
            ]
            faces.append(np.array(corners) * size)
    return faces


def test_gradients_are_those_of_finite_differences():
    """Central differences at 1e-5 m: rounding 1e-10, curvature 1e-9 of areas of 10 m2."""
    one = scene(BOX, PLATE)
    names = ("plate.size_u", "plate.size_v", "box.size_y", "attitude.spin_phase")
    start = torch.tensor([2.0, 4.0, 1.5, 20.0], dtype=torch.float64)

    def total(numbers):
        values = dict(zip(names, numbers, strict=True))
        found = torchlc.visibility(one, **TIMES, values=values)
        weight = torch.linspace(1, 2, len(found.seconds), dtype=torch.float64)
        return (
            (found.area_to_sun @ weight).sum()
            + (found.area_towards["velocity"] @ weight).sum()
            + (found.lit @ weight).sum()
        )

    numbers = start.clone().requires_grad_()
    total(numbers).backward()
    for k in range(len(names)):
        step = torch.zeros_like(start)
        step[k] = 1e-5
        expected = (total(start + step) - total(start - step)) / 2e-5
        assert float(numbers.grad[k]) == pytest.approx(float(expected), rel=1e-5, abs=1e-6), names[k]


def test_the_earth_takes_the_sun_from_a_geostationary_object():
    """At the equinox an object over the equator is in the shadow for about 70 min around its midnight (Soop 1994, 1.15 h).
    Around 2020-10-10 the season is nearly over for the orbit of the paper: compare with the midsummer's full light."""
    one = scene(BOX)
    summer = torchlc.visibility(one, start="2020-12-21T00:00:00", hours=24.0, cadence=600.0)
    assert float(summer.sunlight.min()) == 1.0
    equinox = torchlc.visibility(one, start="2020-09-22T00:00:00", hours=24.0, cadence=60.0)
    minutes = float((1 - equinox.sunlight).sum())
    assert 60 < minutes < 73


def test_refusals_name_what_was_wrong():
    one = scene(BOX)
    with pytest.raises(InputError, match=r"'box.size_q' is no number of this scene"):
        torchlc.visibility(one, **TIMES, values={"box.size_q": torch.tensor(1.0)})
    with pytest.raises(InputError, match=r"shape \(2,\)"):
        torchlc.visibility(one, **TIMES, towards={"wind": torch.zeros(2)})
    with pytest.raises(InputError, match="one or the other"):
        torchlc.visibility(one)
