"""Facets against closed forms: areas, volumes, Lambert curves of smooth shapes, poses, meshes on disk."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from torchlc.errors import InputError, MissingExtraError
from torchlc.shapes import Shape, tracking_pose

F64 = torch.float64


def component(name, shape, **keys):
    blank = {
        "centre": [0, 0, 0], "rotation": [0, 0, 0], "axis": [0, 0, 1], "scale": 1.0, "u": None, "u_around": None,
        "material": "m", "face_materials": {}, "back_material": None, "tracks": None, "facets": None,
        "two_tone": None, "sectors": (), "inside_material": None,
    }  # fmt: skip
    return SimpleNamespace(name=name, shape=shape, **(blank | keys))


def shape_scene(*components, directory="."):
    return SimpleNamespace(components=list(components), directory=Path(directory), source="scene.toml")


def shape_of(*components, n=100.0, directory="."):
    """The shape of a material whose lobe, up to an exponent n, may be wider along u than along v."""
    return Shape(shape_scene(*components, directory=directory), {"m": n})


def sizes(*components):
    values = {}
    for part in components:
        axes = {"box": "xyz", "plate": "uv"}.get(part.shape, "")
        named = {f"size_{axis}": size for axis, size in zip(axes, getattr(part, "size", []), strict=True)}
        named |= {
            key: getattr(part, key)
            for key in ("radius", "radius_top", "length", "depth")
            if hasattr(part, key)
        }
        values |= {f"{part.name}.{key}": torch.tensor(float(size), dtype=F64) for key, size in named.items()}
    return values


BOX = component("b", "box", size=[2.0, 3.0, 4.0], rotation=[10, 20, 30], centre=[1, 2, 3])
CYLINDER = component("c", "cylinder", radius=0.8, length=3.0, axis=[0, 1, 0])
CONE = component("k", "cone", radius=1.0, radius_top=0.4, length=2.0, axis=[1, 1, 0])
TIP = component("t", "cone", radius=1.0, radius_top=0.0, length=2.0)
SPHERE = component("s", "sphere", radius=2.0)
DISH = component("d", "dish", radius=1.0, depth=0.3, axis=[0, 0, 1])


def facets_of(part, n=100.0):
    return shape_of(part, n=n).parts[0].facets(sizes(part))


@pytest.mark.parametrize(
    ("part", "area", "volume"),
    [
        (BOX, 52.0, 24.0),
        (CYLINDER, 2 * math.pi * 0.8 * (0.8 + 3.0), math.pi * 0.64 * 3.0),
        (CONE, math.pi * (1.4 * math.hypot(2.0, 0.6) + 1.16), math.pi * 2.0 / 3 * (1 + 0.4 + 0.16)),
        (TIP, math.pi * (math.sqrt(5) + 1), math.pi * 2 / 3),
        (SPHERE, 16 * math.pi, 32 * math.pi / 3),
    ],
    ids=["box", "cylinder", "cone", "pointed cone", "sphere"],
)
def test_area_volume_and_closure(part, area, volume):
    facets = facets_of(part)
    middle = facets.centroid - torch.as_tensor(part.centre, dtype=F64)
    enclosed = (facets.area * (middle * facets.normal).sum(dim=-1)).sum() / 3
    assert facets.area.sum().item() == pytest.approx(area, rel=1e-12)
    assert enclosed.item() == pytest.approx(volume, rel=1e-3)  # midpoint rule at 72 around: (2 pi/72)^2/6
    assert (facets.area[:, None] * facets.normal).sum(dim=0).abs().max() < 1e-12 * area


def test_dish_has_the_area_of_its_paraboloid_on_both_sides():
    facets = facets_of(DISH)
    steep = 2 * 0.3 / 1.0
    one_side = 2 * math.pi / (3 * steep**2) * ((1 + steep**2) ** 1.5 - 1)
    assert facets.area.sum().item() == pytest.approx(2 * one_side, rel=1e-12)
    inside = facets.normal[:, 2] > 0
    rim_disc = (facets.area * facets.normal[:, 2])[inside].sum()
    assert rim_disc.item() == pytest.approx(math.pi, rel=1e-3)
    focus = torch.tensor([0.0, 0.0, 1.0 / (4 * 0.3) - 0.15], dtype=F64)  # from the vertex at -depth/2
    ray = torch.nn.functional.normalize(facets.centroid[inside] - focus, dim=-1)
    mirrored = ray - 2 * (ray * facets.normal[inside]).sum(dim=-1, keepdim=True) * facets.normal[inside]
    assert (mirrored[:, 2] > 1 - 1e-12).all()  # a parabola sends its focus along its axis


@pytest.mark.parametrize("part", [BOX, CYLINDER, CONE, TIP, SPHERE, DISH], ids=lambda part: part.shape)
def test_corners_run_counter_clockwise_about_the_normal(part):
    facets = facets_of(part)
    corners = facets.vertices
    polygon = 0.5 * torch.linalg.cross(corners, corners.roll(-1, dims=1)).sum(dim=1)
    polygon_area = polygon.norm(dim=-1)
    assert ((polygon * facets.normal).sum(dim=-1) > 0.999 * polygon_area).all()
    assert polygon_area.sum().item() == pytest.approx(facets.area.sum().item(), rel=1e-2)
    assert (facets.u * facets.normal).sum(dim=-1).abs().max() < 1e-12


def lambert_sum(facets, to_sun, to_observer):
    lit = (facets.normal @ to_sun).clamp(min=0)
    seen = (facets.normal @ to_observer).clamp(min=0)
    return (facets.area * lit * seen).sum().item() / math.pi


@pytest.mark.parametrize("phase", [0.0, 20.0, 60.0, 110.0, 150.0])
@pytest.mark.parametrize(("n", "around"), [(1.0, 64), (1e3, 199)])
def test_sphere_follows_the_lambert_phase_law(phase, n, around):
    alpha = math.radians(phase)
    axis = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    side = np.cross(axis, [1.0, 0, 0]) / np.linalg.norm(np.cross(axis, [1.0, 0, 0]))
    observer = torch.as_tensor(math.cos(alpha) * axis + math.sin(alpha) * side)
    found = lambert_sum(facets_of(SPHERE, n), torch.as_tensor(axis), observer)
    expected = 2 * 4.0 / (3 * math.pi) * (math.sin(alpha) + (math.pi - alpha) * math.cos(alpha))
    full = 2 * 4.0 / 3
    assert abs(found - expected) < (2 * math.pi / around) ** 2 / 12 * full


@pytest.mark.parametrize("psi", [0.0, 35.0, 90.0, 140.0])
def test_cylinder_side_follows_the_lambert_law(psi):
    """Physics A4: rho R L |s_p||o_p| [sin psi + (pi - psi) cos psi]/(2 pi)."""
    angle, sun_tilt, observer_tilt = math.radians(psi), 0.4, -0.7
    sun = torch.tensor([math.cos(sun_tilt), math.sin(sun_tilt), 0.0], dtype=F64)
    observer = math.cos(observer_tilt) * torch.tensor([math.cos(angle), 0.0, math.sin(angle)], dtype=F64)
    observer[1] = math.sin(observer_tilt)
    shape = shape_of(CYLINDER)
    facets = shape.parts[0].facets(sizes(CYLINDER))
    side = torch.tensor([face == "side" for face in shape.parts[0].faces])
    lit, seen = (facets.normal @ sun).clamp(min=0), (facets.normal @ observer).clamp(min=0)
    found = (facets.area * lit * seen)[side].sum().item() / math.pi
    factor = 0.8 * 3.0 * math.cos(sun_tilt) * math.cos(observer_tilt) / (2 * math.pi)
    expected = factor * (math.sin(angle) + (math.pi - angle) * math.cos(angle))
    assert abs(found - expected) < (2 * math.pi / 72) ** 2 / 12 * factor * math.pi


def test_facets_follow_the_scene_and_an_uneven_lobe():
    """A cylinder's are 64 or more whatever its lobe, and as many as the scene asks for; a sphere's 2 pi sqrt(n) where
    the lobe is wider one way than the other."""
    for n in (0.0, 1e2, 1e6):
        assert shape_of(CYLINDER, n=n).parts[0].faces.count("side") == 72
    finer = component("c", "cylinder", radius=1, length=1, facets=500)
    assert shape_of(finer).parts[0].faces.count("side") >= 500
    uneven, even = shape_of(SPHERE, n=1e4), Shape(shape_scene(SPHERE), {})
    assert len(uneven.parts[0].faces) > 512**2 / math.pi
    assert "629 facets around are wanted, 512 are used" in uneven.warnings[0]
    assert len(even.parts[0].faces) < 1500
    assert even.warnings == []


def test_neighbouring_normals_of_a_sphere_are_closer_than_the_lobe_is_wide():
    normal = facets_of(SPHERE, n=400.0).normal
    generator = torch.Generator().manual_seed(1)
    anywhere = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator, dtype=F64), dim=-1)
    nearest = torch.acos((anywhere @ normal.T).amax(dim=1))
    assert nearest.max() < 1 / math.sqrt(400.0)


def test_axes_and_labels_of_the_box():
    plain = component("b", "box", size=[2.0, 3.0, 4.0], face_materials={"-Y": "radiator"})
    part = shape_of(plain).parts[0]
    facets = part.facets(sizes(plain))
    assert part.faces == ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
    assert part.materials == ("m", "m", "m", "radiator", "m", "m")
    assert facets.area.tolist() == [12, 12, 8, 8, 6, 6]
    assert facets.centroid.tolist() == [
        [1, 0, 0],
        [-1, 0, 0],
        [0, 1.5, 0],
        [0, -1.5, 0],
        [0, 0, 2],
        [0, 0, -2],
    ]
    assert facets.u.tolist() == [[0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]]


def test_rotation_turns_about_body_x_then_y_then_z():
    turned = component("p", "plate", size=[1, 1], u=[1, 0, 0], v=[0, 1, 0], rotation=[90, 90, 0])
    facets = facets_of(turned)  # +Z -> -Y (about x) -> -Y (about y); +X -> +X -> -Z
    assert torch.allclose(facets.normal[0], torch.tensor([0.0, -1, 0], dtype=F64), atol=1e-15)
    assert torch.allclose(facets.u[0], torch.tensor([0.0, 0, -1], dtype=F64), atol=1e-15)
    last = facets_of(component("p", "plate", size=[1, 1], u=[1, 0, 0], v=[0, 1, 0], rotation=[90, 0, 90]))
    assert torch.allclose(last.normal[0], torch.tensor([1.0, 0, 0], dtype=F64), atol=1e-15)


@pytest.mark.parametrize("part", [BOX, CYLINDER, CONE, SPHERE, DISH], ids=lambda part: part.shape)
def test_gradient_with_respect_to_sizes(part):
    shape, values = shape_of(part), sizes(part)
    generator = torch.Generator().manual_seed(2)
    weights = {
        name: torch.randn(t.shape, generator=generator, dtype=F64) for name, t in _fields(shape, values)
    }

    def functional(*numbers):
        named = dict(zip(values, numbers, strict=True))
        return sum((weights[name] * tensor).sum() for name, tensor in _fields(shape, named))

    numbers = tuple(value.clone().requires_grad_() for value in values.values())
    assert torch.autograd.gradcheck(functional, numbers)


def _fields(shape, values):
    return vars(shape.parts[0].facets(values)).items()


def test_facets_under_vmap_equal_the_loop():
    shape = shape_of(BOX, CYLINDER)
    values = sizes(BOX, CYLINDER)
    batch = {name: value * torch.tensor([1.0, 1.1, 0.7], dtype=F64) for name, value in values.items()}

    def area_moment(named):
        return torch.stack([part.facets(named).vertices.square().sum() for part in shape.parts])

    together = torch.func.vmap(area_moment)(batch)
    for k in range(3):
        assert torch.allclose(
            together[k], area_moment({name: value[k] for name, value in batch.items()}), rtol=1e-14
        )


@pytest.mark.parametrize("front", [[1.0, 0, 0], [0.6, 0.8, 0.0]])
def test_tracking_beats_every_other_angle(front):
    axis, front = torch.tensor([0.0, 1, 0], dtype=F64), torch.tensor(front, dtype=F64)
    generator = torch.Generator().manual_seed(3)
    sun = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator, dtype=F64), dim=-1)
    pose = tracking_pose(axis, front, sun)
    assert torch.allclose(pose @ pose.mT, torch.eye(3, dtype=F64).expand(20, 3, 3), atol=1e-14)
    assert torch.allclose(pose @ axis, axis.expand(20, 3), atol=1e-14)
    assert torch.allclose(torch.linalg.det(pose), torch.ones(20, dtype=F64), atol=1e-14)
    angle = torch.linspace(0, 2 * math.pi, 721, dtype=F64)
    cosine, sine, still = torch.cos(angle), torch.sin(angle), front[1].expand(721)
    turned = torch.stack(
        [front[0] * cosine + front[2] * sine, still, front[2] * cosine - front[0] * sine], dim=-1
    )
    best = (turned @ sun.T).amax(dim=0)
    assert ((pose @ front * sun).sum(dim=-1) >= best - 1e-12).all()


def test_sun_along_the_axis_keeps_the_last_angle():
    axis, front = torch.tensor([0.0, 1, 0], dtype=F64), torch.tensor([0.0, 0, 1], dtype=F64)
    along, toward_x, toward_z = [0.0, 1, 0], [1.0, 1, 0], [0.0, -1, 2]
    sun = torch.nn.functional.normalize(
        torch.tensor([along, toward_x, along, toward_z, along], dtype=F64), dim=-1
    )
    sun.requires_grad_()
    facing = tracking_pose(axis, front, sun) @ front
    x, z = [1.0, 0, 0], [0.0, 0, 1]
    assert torch.allclose(facing, torch.tensor([x, x, x, z, z], dtype=F64), atol=1e-15)
    (gradient,) = torch.autograd.grad(facing.sum(), sun)
    assert gradient.isfinite().all()
    never = torch.tensor([along, along], dtype=F64)
    assert torch.allclose(tracking_pose(axis, front, never), torch.eye(3, dtype=F64).expand(2, 3, 3))
    batch = torch.stack([sun.detach(), sun.detach().flip(0)])
    together = torch.func.vmap(lambda rows: tracking_pose(axis, front, rows))(batch)
    assert torch.allclose(together[1], tracking_pose(axis, front, batch[1]))


def test_an_axis_that_cannot_turn_the_front_is_refused():
    tracks = SimpleNamespace(target="sun", axis=[0, 0, 1])
    with pytest.raises(InputError, match=r"tracks\.axis"):
        shape_of(component("p", "plate", size=[1, 1], u=[1, 0, 0], v=[0, 1, 0], tracks=tracks))


def mesh_part(path):
    return component("rock", "mesh", file=path.name, scale=2.0)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_mesh_of_a_box_in_every_format(tmp_path, suffix):
    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box(extents=[1, 2, 3]).export(path)
    shape = shape_of(mesh_part(path), directory=tmp_path)
    facets = shape.parts[0].facets({})
    assert shape.warnings == []
    assert len(facets.area) == 12
    assert facets.area.sum().item() == pytest.approx(4 * 22)
    assert (facets.area * (facets.centroid * facets.normal).sum(dim=-1)).sum().item() / 3 == pytest.approx(
        8 * 6
    )


@pytest.mark.parametrize("turned", [[0, 5, 7], list(range(12))], ids=["some", "all"])
def test_inside_out_faces_of_a_closed_mesh_are_turned_round(tmp_path, turned):
    box = trimesh.creation.box(extents=[1, 2, 3])
    faces = box.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    path = tmp_path / "box.obj"
    trimesh.Trimesh(box.vertices, faces, process=False).export(path)
    shape = shape_of(mesh_part(path), directory=tmp_path)
    facets = shape.parts[0].facets({})
    assert f"{len(turned)} faces of 12 turned round, from inside out" in shape.warnings[0]
    assert (facets.area * (facets.centroid * facets.normal).sum(dim=-1)).sum().item() / 3 == pytest.approx(
        8 * 6
    )


def test_holes_and_faces_without_area_are_told(tmp_path):
    path = tmp_path / "open.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n")
    shape = shape_of(mesh_part(path), directory=tmp_path)
    assert any("holes" in line for line in shape.warnings)
    assert any("1 face without area" in line for line in shape.warnings)
    assert len(shape.parts[0].faces) == 1


@pytest.mark.parametrize(
    "text", ["", "nonsense\n", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "v 0 0 0\nf 1 5 9\n"]
)
def test_a_broken_mesh_is_refused_in_one_line(tmp_path, text):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(InputError, match=r"bad\.obj") as refused:
        shape_of(mesh_part(path), directory=tmp_path)
    assert "\n" not in str(refused.value)


def test_without_trimesh_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'torchlc\[mesh\]'"):
        shape_of(mesh_part(tmp_path / "rock.obj"), directory=tmp_path)


def test_a_missing_mesh_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        shape_of(mesh_part(tmp_path / "none.obj"), directory=tmp_path)


EROS = Path("/work/shared/data/eros")


@pytest.mark.skipif(not EROS.exists(), reason="the Eros data are not here")
def test_eros_has_its_published_volume():
    shape = shape_of(component("eros", "mesh", file="eros.obj", scale=20480.0), directory=EROS)
    facets = shape.parts[0].facets({})
    assert len(facets.area) == 4000
    assert shape.warnings == []
    volume_km3 = (facets.area * (facets.centroid * facets.normal).sum(dim=-1)).sum().item() / 3 / 1e9
    assert volume_km3 == pytest.approx(2500, rel=1e-3)
