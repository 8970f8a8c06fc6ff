"""Shadows, second bounces, the Sun's disc and earthshine against path tracing by Mitsuba 3.

An orthographic camera in the observer's direction collects radiance times projected area: the radiant
intensity, which is Phi times range squared where the Sun's irradiance is 1. Mitsuba has no
Ashikhmin-Shirley model: materials are Lambert's or GGX with a Fresnel factor of 1. It computes in float32,
and 10^5 to 10^6 paths leave 0.1 to 1 %.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.effects.cases import AU_KM, RANGE_KM, flux, seen_from, still, tilted, unit

mitsuba: Any = pytest.importorskip("mitsuba", reason="mitsuba is not installed (pip install torchlc[test])")

SUN_RADIUS = 695_700.0 / AU_KM
EARTH_RADIUS_KM = 6371.0
DISTANCE = 50.0
DIRECT, ONE_BOUNCE_MORE = 2, 3
SHADOWS, BOUNCES = ["self_shadowing"], ["self_shadowing", "interreflection"]


@pytest.fixture(autouse=True)
def _scalar_variant() -> None:
    mitsuba.set_variant("scalar_rgb")


class Object:
    """Parts added one by one, to a scene of torchlc and to one of Mitsuba alike."""

    def __init__(self) -> None:
        self.components: list[str] = []
        self.materials: dict[str, str] = {}
        self.shapes: dict[str, Any] = {}

    def _material(self, name: str, kind: str, value: float) -> dict[str, Any]:
        if kind == "lambert":
            self.materials[name] = f'model = "lambert"\nalbedo = {value}\n'
            return {"type": "diffuse", "reflectance": value}
        self.materials[name] = f'model = "ggx"\nalpha = {value}\nf0 = 1.0\nr_diff = 0.0\n'
        return {"type": "roughconductor", "distribution": "ggx", "alpha": value, "material": "none"}

    def plate(self, centre, u, v, size, kind, value) -> Object:
        name = f"part{len(self.components)}"
        self.components.append(
            f'[[components]]\nname = "{name}"\nshape = "plate"\nsize = {list(size)}\ncentre = {list(centre)}\n'
            f'u = {list(u)}\nv = {list(v)}\nmaterial = "{name}"\n'
        )
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack(
            [0.5 * size[0] * unit(u), 0.5 * size[1] * unit(v), np.cross(unit(u), unit(v))], 1
        )
        matrix[:3, 3] = centre
        material = {"type": "twosided", "sides": self._material(name, kind, value)}
        self.shapes[name] = {
            "type": "rectangle",
            "to_world": mitsuba.ScalarTransform4f(matrix),
            "bsdf": material,
        }
        return self

    def box(self, centre, size, kind, value) -> Object:
        name = f"part{len(self.components)}"
        self.components.append(
            f'[[components]]\nname = "{name}"\nshape = "box"\nsize = {list(size)}\ncentre = {list(centre)}\n'
            f'material = "{name}"\n'
        )
        matrix = np.diag([0.5 * size[0], 0.5 * size[1], 0.5 * size[2], 1.0])
        matrix[:3, 3] = centre
        material = self._material(name, kind, value)
        self.shapes[name] = {"type": "cube", "to_world": mitsuba.ScalarTransform4f(matrix), "bsdf": material}
        return self

    def model(self, folder, to_sun, to_observer, effects, position=None, **values) -> np.ndarray:
        """Phi range^2 (T,), m2/sr."""
        materials = "".join(f"[materials.{name}]\n{text}" for name, text in self.materials.items())
        scene = still("".join(self.components), materials)
        recording = seen_from(scene, folder, to_sun, to_observer, position=position)
        return flux(scene, recording, effects, **values) * (1e3 * RANGE_KM) ** 2

    def traced(
        self, to_sun, to_observer, depth, *, half=3.0, pixels=128, paths=32, lights=None, near=DISTANCE
    ) -> float:
        """Radiant intensity of all that is within ``half`` of the middle, for unit irradiance by the
        Sun."""
        transform = mitsuba.ScalarTransform4f
        up = [0, 0, 1] if abs(to_observer[2]) < 0.9 else [1, 0, 0]
        camera = transform().look_at(origin=[near * float(x) for x in to_observer], target=[0, 0, 0], up=up)
        film = {"type": "hdrfilm", "width": pixels, "height": pixels, "pixel_format": "luminance"}
        sun = {"type": "directional", "direction": [-float(x) for x in to_sun], "irradiance": 1.0}
        world = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth, "rr_depth": 99},
            "sensor": {
                "type": "orthographic", "to_world": camera @ transform().scale([half, half, 1]),
                "film": {**film, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": paths},
            },
            **({"sun": sun} if lights is None else lights),
            **self.shapes,
        }  # fmt: skip
        return (
            float(np.array(mitsuba.render(mitsuba.load_dict(world)), dtype=np.float64).mean())
            * (2 * half) ** 2
        )


def box_wing(gap: float, tilt_deg: float, kind: str = "lambert") -> Object:
    """A cube with two wings along Y at some turn about it."""
    values = (0.6, 0.3) if kind == "lambert" else (0.25, 0.15)
    made = Object().box((0.0, 0.0, 0.0), (1.2, 1.0, 1.4), kind, values[0])
    u = (math.cos(math.radians(tilt_deg)), 0.0, -math.sin(math.radians(tilt_deg)))
    for side in (1.0, -1.0):
        made.plate((0.0, side * (1.25 + gap), 0.0), u, (0.0, 1.0, 0.0), (1.4, 1.5), kind, values[1])
    return made


def corner(kind: str, first: float, second: float) -> Object:
    floor = ((1.0, 0.0, 0.0), (1, 0, 0), (0, 1, 0), (2.0, 2.0))
    wall = ((0.0, 0.0, 1.0), (0, 1, 0), (0, 0, 1), (2.0, 2.0))
    return Object().plate(*floor, kind, first).plate(*wall, kind, second)


def test_shadows_of_a_box_wing(tmp_path):
    """Three attitudes to Sun and observer; in the first a wing's shadow takes a fifth of the light."""
    made = box_wing(0.0, 30.0)
    to_sun = unit([[0.3, 0.9, 0.5], [0.8, -0.5, 0.3], [-0.4, 0.7, 0.6]])
    to_observer = unit([[0.6, 0.2, 0.8], [0.9, 0.3, 0.3], [0.2, 0.9, 0.4]])
    found = made.model(tmp_path, to_sun, to_observer, SHADOWS)
    expected = [made.traced(*pair, DIRECT) for pair in zip(to_sun, to_observer, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=4e-3)
    bare = made.model(tmp_path, to_sun, to_observer, [])
    assert (bare / found).max() > 1.1


def test_shadows_of_crossed_and_stacked_parts(tmp_path):
    """A plate over a box, half its light in shadow, and a plate through the sight of another."""
    to_sun, to_observer = unit([[0.1, 0.2, 1.0]]), unit([[0.5, -0.4, 0.7]])
    stacked = Object().box((0.0, 0.0, 0.0), (1.5, 1.5, 0.8), "lambert", 0.7)
    stacked.plate((0.3, 0.2, 1.0), (1, 0, 0), (0, 1, 0), (1.2, 1.4), "lambert", 0.2)
    crossed = Object().plate((0.0, 0.0, 0.0), (1, 0, 0), (0, 1, 0), (2.5, 2.0), "lambert", 0.5)
    crossed.plate((0.5, -0.9, 0.8), (0, 0.6, 0.8), (1, 0, 0), (1.5, 1.0), "lambert", 0.9)
    for made in (stacked, crossed):
        found = made.model(tmp_path, to_sun, to_observer, SHADOWS)[0]
        assert found == pytest.approx(made.traced(to_sun[0], to_observer[0], DIRECT), rel=4e-3)
    hidden = (
        stacked.model(tmp_path, to_sun, to_observer, [])[0]
        / stacked.model(tmp_path, to_sun, to_observer, SHADOWS)[0]
    )
    assert hidden > 1.3


@pytest.mark.parametrize(
    ("made", "to_sun", "to_observer", "least"),
    [
        (lambda: corner("lambert", 0.6, 0.5), [0.3, 0.1, 1.0], [1.0, 0.2, 0.4], 0.1),
        (lambda: corner("ggx", 0.2, 0.3), [0.6, 0.1, 0.8], [0.75, 0.0, 0.65], 5.0),
        (lambda: box_wing(0.0, 40.0), [0.35, 0.8, 0.5], [0.5, 0.7, 0.5], 0.02),
        (lambda: box_wing(0.3, 60.0, "ggx"), [0.35, 0.8, 0.5], [0.42, 0.75, 0.5], 0.1),
    ],
    ids=["white corner", "glossy corner", "white box-wing", "glossy box-wing"],
)  # fmt: skip
def test_second_bounces(tmp_path, made, to_sun, to_observer, least):
    """Depth 3 against depth 2; between glossy plates the second bounce is many times the direct light."""
    made, sun, observer = made(), unit(to_sun), unit(to_observer)
    direct = made.model(tmp_path, [sun], [observer], SHADOWS)[0]
    found = made.model(tmp_path, [sun], [observer], BOUNCES, interreflection__gain=1.0)[0]
    assert found / direct > 1 + least
    expected = made.traced(sun, observer, ONE_BOUNCE_MORE, paths=64)
    assert found == pytest.approx(expected, rel=6e-3)


@pytest.mark.parametrize("alpha", [0.05, 0.01, 0.003])
def test_glint_of_the_suns_disc(tmp_path, alpha):
    """A far disc of the Sun's size and limb darkening; at the narrowest (n about 2e5) it takes a quarter of
    the peak."""
    far = 1e5
    sun = tilted(20.0)
    r = (np.arange(256) + 0.5) / 256
    brightness = (1 - 0.6 * (1 - np.sqrt(1 - r**2))) / (0.8 * math.pi * SUN_RADIUS**2)
    bitmap = mitsuba.Bitmap(np.broadcast_to(brightness[None, :, None], (2, 256, 1)).astype(np.float32).copy())
    place = mitsuba.ScalarTransform4f().look_at(origin=(far * sun).tolist(), target=[0, 0, 0], up=[0, 1, 0])
    radiance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    disc = {
        "type": "disk", "to_world": place @ mitsuba.ScalarTransform4f().scale([far * SUN_RADIUS, far * SUN_RADIUS, 1]),
        "emitter": {"type": "area", "radiance": radiance},
    }  # fmt: skip
    plate = Object().plate((0.0, 0.0, 0.0), (1, 0, 0), (0, 1, 0), (2.0, 2.0), "ggx", alpha)
    width = math.degrees(math.hypot(alpha, SUN_RADIUS / 2))
    for off in (0.0, 1.0, 2.0):
        observer = tilted(20.0 + off * width, 180.0)
        found = plate.model(tmp_path, [sun], [observer], ["finite_sun"])[0]
        expected = plate.traced(sun, observer, DIRECT, half=0.5, pixels=64, paths=256, lights={"disc": disc})
        assert found == pytest.approx(4.0 * observer[2] * expected, rel=6e-3)


@pytest.mark.parametrize(
    ("radius", "kind", "value", "to_sun", "close"),
    [
        (6871.0, "lambert", 0.6, [0.3, 0.1, 1.0], 0.01),
        (7500.0, "ggx", 0.15, [-0.9, 0.2, 0.4], 0.015),
        (12000.0, "lambert", 0.8, [1.0, 0.3, 0.1], 0.02),
    ],
    ids=["full", "glossy", "half"],
)
def test_earthshine_from_below(tmp_path, radius, kind, value, to_sun, close):
    """A plate that faces down, the Sun behind it: all that an observer below sees is by way of a Lambert
    Earth."""
    plate = Object().plate((0.0, 0.0, 0.0), (1, 0, 0), (0, 1, 0), (2.0, 2.0), kind, value)
    sun, observer = unit(to_sun), unit([0.25, 0.1, -1.0])
    position = np.array([0.0, 0.0, radius])
    from_object = unit(AU_KM * sun - position)
    values = {"earthshine__albedo": 0.3}
    found = plate.model(tmp_path, [from_object], [observer], ["earthshine"], position, **values)[0]
    earth = {
        "type": "sphere", "center": [0.0, 0.0, -radius], "radius": EARTH_RADIUS_KM,
        "bsdf": {"type": "diffuse", "reflectance": 0.3},
    }  # fmt: skip
    plate.shapes["earth"] = earth
    expected = plate.traced(sun, observer, ONE_BOUNCE_MORE, half=0.5, pixels=64, paths=128, near=5.0)
    assert found == pytest.approx(4.0 * -observer[2] * expected, rel=close)
