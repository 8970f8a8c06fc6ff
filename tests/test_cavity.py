"""Light that is reflected many times within one mesh or dish, against closed forms of spherical cavities, path tracing
and finite differences."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import torchlc
from tests.effects.cases import RANGE_KM, STILL, flux, seen_from, tilted, unit
from torchlc.errors import InputError
from torchlc.lightcurve.assembly import assemble
from torchlc.pairs.cavity import cavities, exchanged, returned

SHADOWS, BOUNCES = ["self_shadowing"], ["self_shadowing", "interreflection"]
MESH = '[[components]]\nname = "bowl"\nshape = "mesh"\nfile = "mesh.obj"\ncentre = [0, 0, 0]\nmaterial = "white"\n'
DISH = (
    '[[components]]\nname = "bowl"\nshape = "dish"\nradius = 1.0\ndepth = {depth}\ncentre = [0, 0, 0]\n'
    'material = "white"\n'
)
LAMBERT = '[materials.white]\nmodel = "lambert"\nalbedo = {}\n'


def scene_of(folder: Path, parts: str, material: str, model: str = "") -> torchlc.Scene:
    return torchlc.Scene.from_toml(
        f'format = "torchlc-scene/1"\nname = "case"\n{STILL}{parts}{material}[model]\neffects = []\n'
        f"[model.parameters]\nband_sun_magnitude = -26.7\n{model}",
        folder,
    )


def light(scene, folder, to_sun, to_observer, effects=BOUNCES) -> np.ndarray:
    """Radiant intensity (T,), m2/sr, for unit irradiance."""
    recording = seen_from(scene, folder, to_sun, to_observer)
    values = {"interreflection__gain": 1.0} if "interreflection" in effects else {}
    return flux(scene, recording, effects, **values) * (1e3 * RANGE_KM) ** 2


def cap(half_deg: float) -> trimesh.Trimesh:
    """The inside of a sphere of radius 1 within an angle of -Z."""
    sphere = trimesh.creation.icosphere(subdivisions=4)
    inside = sphere.triangles_center[:, 2] < -math.cos(math.radians(half_deg))
    made = trimesh.Trimesh(sphere.vertices, sphere.faces[inside][:, ::-1], process=False)
    made.remove_unreferenced_vertices()
    return made


def saved(mesh: trimesh.Trimesh, folder: Path) -> trimesh.Trimesh:
    mesh.export(folder / "mesh.obj")
    return mesh


@pytest.mark.parametrize("albedo", [0.3, 0.8, 1.0])
@pytest.mark.parametrize("half_deg", [60.0, 90.0, 130.0])
def test_spherical_cavities_have_their_closed_form(tmp_path, half_deg, albedo):
    """Every point of a sphere sees every other with the share dA / (4 pi r^2), so the light that a cap of the share F
    of the sphere keeps, albedo F of each round, is uniform: an integrating sphere.

    Sunlight through the opening, of area S, is a power S; after the first reflection albedo S F reach the cap
    again, after all of them albedo S F / (1 - albedo F), and seen face on its area is S. Rays
    leave 2e-3 of F, which 1 / (1 - albedo F) makes up to 1 %.
    """
    mesh = saved(cap(half_deg), tmp_path)
    scene = scene_of(tmp_path, MESH, LAMBERT.format(albedo))
    ahead = [[0.0, 0.0, 1.0]]
    once, often = (light(scene, tmp_path, ahead, ahead, effects)[0] for effects in (SHADOWS, BOUNCES))
    opening = float(
        (mesh.area_faces[:, None] * mesh.face_normals).sum(0)[2]
    )  # a closed surface has none in all
    share = mesh.area / (4 * math.pi)
    received = albedo * opening * share / (1 - albedo * share)
    expected = albedo * opening / math.pi * received / mesh.area
    assert often - once == pytest.approx(expected, rel=0.012)
    assert expected > (0.05 if albedo == 0.3 else 0.2) * once


def test_form_factors_of_a_sphere(tmp_path):
    """Rays: uniform to 1/sqrt(2048) of the largest share, and exact in all."""
    saved(cap(170.0), tmp_path)
    scene = scene_of(tmp_path, MESH, LAMBERT.format(1.0))
    context = assemble(scene, seen_from(scene, tmp_path, [[0, 0, 1.0]] * 2, [[0, 0, 1.0]] * 2)).context
    (cavity,) = cavities(context)
    share, area = exchanged(cavity, context.rest[0], context)
    expected = (area / (4 * math.pi)).expand_as(share)
    torch.testing.assert_close(share.sum(1), expected.sum(1), rtol=0, atol=0.025)
    torch.testing.assert_close(share, expected, rtol=0, atol=4 * float(expected.max() / 2048) ** 0.5)
    torch.testing.assert_close(area[:, None] * share, (area[:, None] * share).mT, rtol=1e-12, atol=0)


def test_two_plates_exchange_a_geometric_series():
    """A closed pair of unit patches that see nothing but each other: light alternates, each round albedo^2 of it."""
    share = torch.tensor([[0.0, 1.0], [1.0, 0.0]], dtype=torch.float64)
    source, sink = torch.zeros(1, 2, 6, dtype=torch.float64), torch.zeros(1, 2, 6, dtype=torch.float64)
    source[0, 0], sink[0, 1] = 1 / 6, 1 / 6  # sun on the first, the second seen
    for a, b in ((0.5, 0.3), (0.9, 0.99)):
        albedo = torch.tensor([a, b], dtype=torch.float64)[:, None].expand(2, 6)
        found = returned(share, source, sink, torch.ones(2, dtype=torch.float64), albedo)
        assert float(found) == pytest.approx(sum(a * b * (a * b) ** k for k in range(3000)), rel=1e-12)


def traced(mesh: trimesh.Trimesh, folder: Path, material: dict[str, Any], sun, observer, half=1.3) -> float:
    """Radiant intensity by Mitsuba's path tracer, up to 60 reflections."""
    mitsuba: Any = pytest.importorskip(
        "mitsuba", reason="mitsuba is not installed (pip install torchlc[test])"
    )
    mitsuba.set_variant("scalar_rgb")
    mesh.export(folder / "traced.ply")
    transform = mitsuba.ScalarTransform4f
    up = [0, 0, 1] if abs(observer[2]) < 0.9 else [1, 0, 0]
    camera = transform().look_at(origin=[9 * float(x) for x in observer], target=[0, 0, 0], up=up)
    film = {
        "type": "hdrfilm",
        "width": 96,
        "height": 96,
        "pixel_format": "luminance",
        "rfilter": {"type": "box"},
    }
    world = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 60, "rr_depth": 99},
        "sensor": {
            "type": "orthographic", "to_world": camera @ transform().scale([half, half, 1]), "film": film,
            "sampler": {"type": "independent", "sample_count": 64},
        },
        "sun": {"type": "directional", "direction": [-float(x) for x in sun], "irradiance": 1.0},
        "mesh": {"type": "ply", "filename": str(folder / "traced.ply"), "face_normals": True, "bsdf": material},
    }  # fmt: skip
    image = np.array(mitsuba.render(mitsuba.load_dict(world)), dtype=np.float64)
    return float(image.mean()) * (2 * half) ** 2


def inside_of(scene, recording) -> trimesh.Trimesh:
    """Triangles of the inside of a dish, as torchlc has cut it."""
    (facets,) = assemble(scene, recording).context.rest
    vertices = facets.vertices[: len(facets.vertices) // 2].numpy()
    triangles = np.concatenate([vertices[:, [0, 1, 2]], vertices[:, [0, 2, 3]]])
    return trimesh.Trimesh(
        triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False
    )


@pytest.mark.parametrize(("depth", "least"), [(0.4, 0.08), (1.2, 0.3)])
def test_a_white_dish_against_path_tracing(tmp_path, depth, least):
    """Albedo 0.8, sunlit and seen askew. Facets of 0.1 in shadow or not, and paths of 1e5, leave 1 %; without further
    bounces the light is ``least`` too faint."""
    scene = scene_of(tmp_path, DISH.format(depth=depth), LAMBERT.format(0.8))
    fine = scene_of(tmp_path, DISH.format(depth=depth) + "facets = 400\n", LAMBERT.format(0.8))
    sun, observer = tilted(25.0, 10.0), tilted(20.0, 130.0)
    once, often = (light(scene, tmp_path, [sun], [observer], effects)[0] for effects in (SHADOWS, BOUNCES))
    mesh = inside_of(fine, seen_from(fine, tmp_path, [sun] * 2, [observer] * 2))
    expected = traced(mesh, tmp_path, {"type": "diffuse", "reflectance": 0.8}, sun, observer)
    assert often == pytest.approx(expected, rel=0.01)
    assert once < (1 - least) * expected


def room() -> trimesh.Trimesh:
    """A box without its lid, a post in the middle that hides its walls from each other, seen from within."""
    walls = trimesh.creation.box(extents=[1.6, 1.2, 1.0])
    walls.update_faces(walls.face_normals[:, 2] < 0.5)
    walls.invert()
    post = trimesh.creation.box(extents=[0.3, 0.4, 0.8])
    post.apply_translation([0.1, 0.0, -0.1])
    return trimesh.util.concatenate([walls, post]).subdivide().subdivide().subdivide()


@pytest.mark.parametrize("albedo", [0.5, 0.9])
def test_a_mesh_with_a_post_against_path_tracing(tmp_path, albedo):
    """Facets hide others: rays decide who sees whom; 1.5 % of the light is left by patches of 0.1 to 0.3."""
    mesh = saved(room(), tmp_path)
    sun, observer = unit([0.3, 0.2, 1.0]), unit([-0.4, 0.3, 1.0])
    scene = scene_of(tmp_path, MESH, LAMBERT.format(albedo))
    once, often = (light(scene, tmp_path, [sun], [observer], effects)[0] for effects in (SHADOWS, BOUNCES))
    expected = traced(mesh, tmp_path, {"type": "diffuse", "reflectance": albedo}, sun, observer)
    assert often == pytest.approx(expected, rel=0.015)
    assert once < (0.85 if albedo == 0.5 else 0.7) * expected


def test_shares_of_a_dish_have_their_gradients(tmp_path):
    """Of radius and depth, against central differences."""
    scene = scene_of(tmp_path, DISH.format(depth=0.6), LAMBERT.format(0.8))
    recording = seen_from(scene, tmp_path, [[0, 0, 1.0]] * 2, [[0, 0, 1.0]] * 2)
    context = assemble(scene, recording).context
    (cavity,) = cavities(context)

    def total(size: torch.Tensor) -> torch.Tensor:
        values = {"bowl.radius": size[0], "bowl.depth": size[1]}
        share, _ = exchanged(cavity, context.parts[0].facets(values), context)
        return share @ torch.linspace(0, 1, len(share), dtype=torch.float64)

    size = torch.tensor([1.0, 0.6], dtype=torch.float64)
    slopes = torch.func.jacfwd(total)(size)
    for k in range(2):
        step = torch.zeros(2, dtype=torch.float64)
        step[k] = 1e-6
        central = (total(size + step) - total(size - step)) / 2e-6
        torch.testing.assert_close(slopes[:, k], central, rtol=1e-5, atol=1e-8)


def test_gradients_and_batches(tmp_path):
    """A shallow dish face on, in which nothing hides anything, with its depth, its material and the gain free."""
    parts = DISH.format(depth="{ value = 0.3, low = 0.1, high = 0.5 }")
    numbers = (
        "n = 20.0\nr_spec = { value = 0.2, low = 0, high = 1 }\nr_diff = { value = 0.6, low = 0, high = 1 }\n"
    )
    scene = scene_of(tmp_path, parts, f"[materials.white]\n{numbers}")
    recording = seen_from(scene, tmp_path, tilted([0.0, 3.0]), tilted([2.0, 1.0], 90.0))
    model = torchlc.LightCurve(scene, recording, effects=["interreflection"])
    theta = model.theta().detach()

    def curve(point: torch.Tensor) -> torch.Tensor:
        return model.brightness(point).flux * 1e12

    slopes = torch.func.jacrev(curve)(theta)
    for k, name in enumerate(model.names):
        step = torch.zeros_like(theta)
        step[k] = 1e-5
        central = (curve(theta + step) - curve(theta - step)).detach() / 2e-5
        torch.testing.assert_close(
            slopes[:, k], central, rtol=1e-5, atol=1e-8, msg=lambda m, name=name: name + m
        )
    batch = theta + 0.01 * torch.arange(3, dtype=torch.float64)[:, None]
    rows = torch.stack([curve(row) for row in batch])
    torch.testing.assert_close(curve(batch), rows, rtol=1e-12, atol=0)


def test_what_is_convex_has_none(tmp_path):
    saved(trimesh.creation.icosphere(subdivisions=2), tmp_path)
    scene = scene_of(tmp_path, MESH, LAMBERT.format(0.8))
    with pytest.raises(InputError, match="none has facets that face its own"):
        light(scene, tmp_path, [[0, 0, 1.0]], [[0, 0, 1.0]])


def test_the_cost_of_a_value_of_theta_does_not_grow_with_the_mesh(tmp_path):
    """Facets are gathered into at most 96 patches, whatever their number."""
    for finer in (0, 2):
        mesh = room()
        for _ in range(finer):
            mesh = mesh.subdivide()
        saved(mesh, tmp_path)
        scene = scene_of(tmp_path, MESH, LAMBERT.format(0.8))
        recording = seen_from(scene, tmp_path, [[0, 0, 1.0]] * 2, [[0, 0, 1.0]] * 2)
        (cavity,) = cavities(assemble(scene, recording).context)
        assert len(cavity.materials) == 96
