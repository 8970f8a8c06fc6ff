"""Joint visibility against plane geometry, brute-force rays and finite differences."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import torch
import trimesh

from tests.rays import blocked, fraction_lit_and_seen, triangles_of
from tests.test_shape import EROS, component, shape_of, sizes
from torchlc.occlusion import may_meet, visible_fractions
from torchlc.shapes import tracking_pose

F64 = torch.float64
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")


def fractions(parts, to_sun, to_observer, values=None, poses=None):
    shape = shape_of(*parts)
    values = sizes(*parts) if values is None else values
    facets = [part.facets(values) for part in shape.parts]
    return visible_fractions(shape, facets, poses or [None] * len(parts), unit(to_sun), unit(to_observer))


def unit(vectors):
    return torch.nn.functional.normalize(torch.as_tensor(vectors, dtype=F64), dim=-1)


def directions(count, seed):
    generator = torch.Generator().manual_seed(seed)
    return unit(torch.randn(2, count, 3, generator=generator, dtype=F64)).unbind()


FLOOR = component("floor", "plate", size=[4.0, 4.0], u=[1, 0, 0], v=[0, 1, 0])
LID = component("lid", "plate", size=[1.0, 2.0], u=[1, 0, 0], v=[0, 1, 0], centre=[0, 0, 1.0])


def test_shadow_of_a_lid_on_a_floor():
    """A lid at height 1, the Sun at slope x: the shadow, shifted by x, joins what the lid hides."""
    x = torch.tensor([0.0, 0.5, 1.0, 1.75, 2.0, 3.0], dtype=F64)
    sun = torch.stack([x, torch.zeros_like(x), torch.ones_like(x)], dim=-1)
    above = torch.tensor([0.0, 0.0, 1.0], dtype=F64).expand(6, 3)
    floor, lid = fractions([FLOOR, LID], sun, above)
    on_floor = torch.clamp(2.0 - (x - 0.5), 0.0, 1.0)  # width of the shadow that is still on the floor
    union = 1.0 + torch.minimum(x, on_floor)  # with the unit-wide outline below the lid
    assert torch.allclose(floor[:, 0], 1 - 2 * union / 16, atol=1e-8)
    assert torch.equal(floor[:, 1], torch.ones(6, dtype=F64))
    assert torch.equal(lid, torch.ones(6, 2, dtype=F64))


def test_sun_behind_the_observer_hides_nothing_more():
    sun = torch.tensor([[0.3, 0.2, 1.0]], dtype=F64)
    floor, _ = fractions([FLOOR, LID], sun, sun)
    assert floor[0, 0].item() == pytest.approx(1 - 2 / 16, abs=1e-8)


def test_a_wall_that_stands_on_the_floor():
    """A wall 1 high and 2 long, Sun and observer 45 deg high, on opposite sides or the same."""
    wall = component("wall", "plate", size=[2.0, 1.0], u=[0, 1, 0], v=[0, 0, 1], centre=[0, 0, 0.5])
    floor, standing = fractions([FLOOR, wall], [[1.0, 0, 1], [1.0, 0, 1]], [[-1.0, 0, 1], [1.0, 0, 1]])
    assert floor[:, 0].tolist() == pytest.approx([1 - 4 / 16, 1 - 2 / 16], abs=1e-8)
    assert standing.min() > 1 - 1e-8


def test_a_wall_sunk_through_the_floor_shades_both_sides():
    wall = component("wall", "plate", size=[2.0, 2.0], u=[0, 1, 0], v=[0, 0, 1], centre=[0, 0, 0.5])
    sun = [[1.0, 0, 1], [1.0, 0, -1]]
    floor, standing = fractions([FLOOR, wall], sun, sun)
    assert floor[0, 0].item() == pytest.approx(1 - 2 * 1.5 / 16, abs=1e-8)
    assert floor[1, 1].item() == pytest.approx(1 - 2 * 0.5 / 16, abs=1e-8)
    from_above = standing[0, 0].item()  # what is below the floor is dark
    assert from_above == pytest.approx(0.75, abs=1e-8)


def test_boxes_in_contact():
    lower = component("lower", "box", size=[2.0, 2.0, 2.0])
    upper = component("upper", "box", size=[1.0, 1.0, 1.0], centre=[0, 0, 1.5])
    label = component("label", "plate", size=[1.0, 1.0], u=[0, 1, 0], v=[0, 0, 1], centre=[1.0, 0, 0])
    zenith, side = [[0.1, 0.05, 1.0]], [[1.0, 0.02, 0.01]]
    below, _, on_side = fractions([lower, upper, label], zenith, zenith)
    shaded = 1.1 * 1.05 - 0.1 * 0.05  # the foot and the shadow behind it, a hexagon
    assert below[0, 4].item() == pytest.approx(1 - shaded / 4, abs=1e-8)
    below, _, on_side = fractions([lower, upper, label], side, side)
    assert below[0, 0].item() == pytest.approx(1 - 1 / 4, abs=1e-8)
    assert on_side[0, 0].item() == pytest.approx(1.0, abs=1e-8)


def box_wing(gap=0.0):
    wing = {"size": [1.72, 6.6], "u": [1, 0, 0], "v": [0, 1, 0]}
    return [
        component("body", "box", size=[2.01, 1.712, 2.189]),
        component("+Y", "plate", centre=[0, 4.156 + gap, 0], **wing),
        component("-Y", "plate", centre=[0, -4.156 - gap, 0], **wing),
    ]


def turned_wings(count, seed):
    generator = torch.Generator().manual_seed(seed)
    to = unit(torch.randn(2, count, 3, generator=generator, dtype=F64))
    axis, front = torch.tensor([0.0, 1, 0], dtype=F64), torch.tensor([0.0, 0, 1], dtype=F64)
    return [None, tracking_pose(axis, front, to[0]), tracking_pose(axis, front, to[1])]


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_box_wing_against_rays(gap):
    """Of M jittered rays the standard error is about 0.7 M^(-3/4), see rays.py; 40 facets are compared."""
    count, rays = 12, 40_000
    parts = box_wing(gap)
    sun, observer = directions(count, seed=5)
    sun[:, 1] = sun[:, 1].abs()
    poses = turned_wings(count, seed=6)
    worst, touched = worst_against_rays(parts, poses, unit(sun), observer, rays)
    assert touched > 10
    assert worst < 3 * rays**-0.75


def worst_against_rays(parts, poses, sun, observer, rays):
    shape = shape_of(*parts)
    values = sizes(*parts)
    found = fractions(parts, sun, observer, poses=poses)
    generator = np.random.default_rng(7)
    worst, touched = 0.0, 0
    for n in range(len(sun)):
        corners, normals = [], []
        for part, pose in zip(shape.parts, poses, strict=True):
            facets = part.facets(values)
            pivot, turn = torch.as_tensor(part.pivot), torch.eye(3, dtype=F64) if pose is None else pose[n]
            corners.append(((facets.vertices - pivot) @ turn.T + pivot).numpy())
            normals.append((facets.normal @ turn.T).numpy())
        s, o = sun[n].numpy(), observer[n].numpy()
        for k, own in enumerate(corners):
            others = np.concatenate(
                [triangles_of(face) for j, other in enumerate(corners) if j != k for face in other]
            )
            for f, face in enumerate(own):
                if normals[k][f] @ s > 0 and normals[k][f] @ o > 0:
                    traced = fraction_lit_and_seen(face, others, s, o, rays, generator)
                    worst = max(worst, abs(traced - found[k][n, f].item()))
                    touched += 0 < traced < 1
    return worst, touched


def shadow_functional(parts, sun, observer, poses):
    generator = torch.Generator().manual_seed(8)
    weights = torch.rand(len(sun), 10, generator=generator, dtype=F64)
    keys = list(sizes(*parts))

    def functional(numbers, sun=sun):
        values = dict(zip(keys, numbers, strict=True))
        seen = fractions(parts, sun, observer, values=values, poses=poses)
        return (weights * torch.cat(seen, dim=1)).sum(dim=1)

    return functional, torch.stack(list(sizes(*parts).values()))


def test_gradient_through_shadows_with_respect_to_sizes():
    parts = box_wing(0.1)
    sun, observer = directions(60, seed=9)
    functional, numbers = shadow_functional(parts, sun, observer, turned_wings(60, seed=10))
    forward = torch.func.jacfwd(functional)(numbers)
    backward = torch.func.jacrev(functional)(numbers)
    torch.testing.assert_close(forward, backward, rtol=1e-10, atol=1e-12)
    step = 1e-6
    rows = torch.eye(len(numbers), dtype=F64) * step
    difference = torch.stack(
        [(functional(numbers + row) - functional(numbers - row)) / (2 * step) for row in rows], 1
    )
    assert difference.abs().max() > 0.05
    torch.testing.assert_close(backward, difference, rtol=1e-3, atol=1e-5)


def test_gradient_with_respect_to_directions_and_poses():
    parts = box_wing()
    sun, observer = directions(40, seed=11)
    axis, front = torch.tensor([0.0, 1, 0], dtype=F64), torch.tensor([0.0, 0, 1], dtype=F64)

    def turned(angle):
        zero, one = torch.zeros_like(angle), torch.ones_like(angle)
        c, s = torch.cos(angle), torch.sin(angle)
        return torch.stack([c, zero, s, zero, one, zero, -s, zero, c]).reshape(3, 3)

    def functional(angles):
        moved = sun @ turned(angles[0]).T
        panel = turned(angles[1]) @ tracking_pose(axis, front, moved)
        seen = fractions(parts, moved, observer, poses=[None, panel, panel])
        return torch.cat(seen, dim=1).sum(dim=1)

    angles = torch.tensor([0.1, 0.2], dtype=F64)
    gradient = torch.func.jacrev(functional)(angles)
    step = 1e-6
    rows = torch.eye(2, dtype=F64) * step
    difference = torch.stack(
        [(functional(angles + row) - functional(angles - row)) / (2 * step) for row in rows], 1
    )
    assert difference.abs().max() > 0.1
    torch.testing.assert_close(gradient, difference, rtol=1e-3, atol=1e-5)


def test_under_vmap_equals_the_loop():
    parts = box_wing()
    sun, observer = directions(30, seed=12)
    functional, numbers = shadow_functional(parts, sun, observer, turned_wings(30, seed=13))
    batch = numbers * torch.linspace(0.8, 1.2, 4, dtype=F64)[:, None]
    together = torch.func.vmap(functional)(batch)
    gradients = torch.func.vmap(torch.func.grad(lambda row: functional(row).sum()))(batch)
    for k in range(4):
        torch.testing.assert_close(together[k], functional(batch[k]), rtol=1e-14, atol=1e-14)
        alone = torch.func.grad(lambda row: functional(row).sum())(batch[k])
        torch.testing.assert_close(gradients[k], alone, rtol=1e-12, atol=1e-12)
    suns = torch.stack([sun, sun.flip(0)])
    together = torch.func.vmap(lambda rows: functional(numbers, rows))(suns)
    torch.testing.assert_close(together[1], functional(numbers, suns[1]), rtol=1e-14, atol=1e-14)


def test_cylinder_sphere_and_cone_shade_a_floor_by_their_outlines():
    """From straight above the outline is a circle, from the side of a lying cylinder a rectangle."""
    floor = component("floor", "plate", size=[8.0, 8.0], u=[1, 0, 0], v=[0, 1, 0])
    up = [[0.0, 0.0, 1.0]]
    standing = component("c", "cylinder", radius=1.0, length=1.0, centre=[0, 0, 2])
    lying = component("c", "cylinder", radius=1.0, length=3.0, axis=[1, 0, 0], centre=[0, 0, 2])
    sphere = component("s", "sphere", radius=1.0, centre=[0, 0, 2])
    cone = component("k", "cone", radius=1.0, radius_top=0.0, length=2.0, centre=[0, 0, 2])
    for part, area in [(standing, math.pi), (lying, 6.0), (sphere, math.pi), (cone, math.pi)]:
        seen, _ = fractions([floor, part], up, up)
        assert (1 - seen[0, 0].item()) * 64 == pytest.approx(area, rel=0.01)


def test_a_plate_shades_a_sphere():
    """A plate that covers the half x > 0 of a sphere, seen and lit along z: half of its outline is left."""
    sphere = component("s", "sphere", radius=1.0)
    plate = component("p", "plate", size=[4.0, 8.0], u=[1, 0, 0], v=[0, 1, 0], centre=[2, 0, 3])
    up = [[0.0, 0.0, 1.0]]
    seen, _ = fractions([sphere, plate], up, up)
    facets = shape_of(sphere).parts[0].facets(sizes(sphere))
    outline = facets.area * facets.normal[:, 2].clamp(min=0)
    assert (outline * seen[0]).sum().item() == pytest.approx(math.pi / 2, rel=2e-3)
    below = (facets.normal[:, 2] > 0.1) & (facets.centroid[:, 0] > 0.1)
    assert seen[0, below].max() < 1e-8


def saved(mesh, tmp_path):
    mesh.export(tmp_path / "mesh.ply")
    return component("mesh", "mesh", file="mesh.ply")


def by_direction(facets, seen):
    """Visible area of the facets that face each of +X -X +Y -Y +Z -Z, (N, 6)."""
    axes = torch.cat([torch.eye(3, dtype=F64), -torch.eye(3, dtype=F64)])[[0, 3, 1, 4, 2, 5]]
    return (seen * facets.area) @ (facets.normal @ axes.T > 0.99).to(F64)


def test_a_mesh_of_two_boxes_sees_itself_as_two_box_parts_do(tmp_path):
    """A face of the mesh is 32 x 32 pairs of triangles, lit or not: an edge of shadow is 1/64 off at most."""
    first = component("first", "box", size=[1.0, 2.0, 1.5], centre=[-1, 0, 0])
    second = component("second", "box", size=[1.0, 1.0, 3.0], centre=[0.8, 0.3, 0.2])
    meshes = []
    for box in (first, second):
        mesh = trimesh.creation.box(extents=box.size)
        for _ in range(5):
            mesh = mesh.subdivide()
        mesh.apply_translation(box.centre)
        meshes.append(mesh)
    whole = saved(trimesh.util.concatenate(meshes), tmp_path)
    sun, observer = directions(60, seed=20)
    boxes = shape_of(first, second)
    exact = fractions([first, second], sun, observer)
    expected = sum(
        by_direction(part.facets(sizes(first, second)), seen)
        for part, seen in zip(boxes.parts, exact, strict=True)
    )
    shape = shape_of(whole, directory=tmp_path)
    facets = shape.parts[0].facets({})
    (traced,) = visible_fractions(shape, [facets], [None], sun, observer)
    assert (exact[0] < 0.9).sum() > 10
    found = by_direction(facets, traced)
    assert (found - expected).abs().max() < 4.5 / 64


def test_turned_parts_among_rays_equal_polygons(tmp_path):
    """A box-wing whose wings turn, its body a box or a mesh: 256 rays from each facet against polygons."""
    parts = box_wing()
    sun, observer = directions(60, seed=21)
    poses = turned_wings(60, seed=22)
    exact = fractions(parts, sun, observer, poses=poses)
    body = saved(trimesh.creation.box(extents=parts[0].size), tmp_path)
    shape = shape_of(body, *parts[1:], directory=tmp_path)
    facets = [part.facets(sizes(*parts[1:])) for part in shape.parts]
    traced = visible_fractions(shape, facets, poses, sun, observer)
    assert (exact[1] < 0.99).any()
    for polygons, rays in zip(exact[1:], traced[1:], strict=True):
        assert (polygons - rays).abs().max() < 0.04  # 4 sigma of 0.7 x 256^(-3/4)
    whole = by_direction(facets[0], traced[0])
    box = shape_of(parts[0]).parts[0].facets(sizes(*parts))
    assert ((whole - by_direction(box, exact[0])) / box.area).abs().max() < 0.04


def test_a_dish_shades_itself_as_brute_force_says():
    dish = component("d", "dish", radius=1.0, depth=0.6)
    shape = shape_of(dish)
    facets = shape.parts[0].facets(sizes(dish))
    sun, observer = unit([[1.0, 0.3, 0.8]]), unit([[-0.4, 0.9, 1.0]])
    (traced,) = visible_fractions(shape, [facets], [None], sun, observer)
    half = len(facets.area) // 2
    bowl = np.concatenate([triangles_of(corners) for corners in facets.vertices[:half].numpy()])
    middles = facets.vertices.mean(dim=1).numpy() + 1e-4 * facets.normal.numpy()
    up = ((facets.normal @ sun[0] > 0) & (facets.normal @ observer[0] > 0)).numpy()
    free = ~(blocked(middles, sun[0].numpy(), bowl) | blocked(middles, observer[0].numpy(), bowl))
    assert 0.1 < free[up].mean() < 0.9
    area = facets.area.numpy()
    assert area[up] @ (traced[0].numpy() - free)[up] == pytest.approx(0.0, abs=0.01 * area[up].sum())
    clear = (traced[0].numpy() > 0.9) | (traced[0].numpy() < 0.1)
    assert ((traced[0].numpy() > 0.5) == free)[clear & up].all()


def test_rays_under_transforms(tmp_path):
    rock = saved(
        trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.box([3, 0.5, 0.5])]), tmp_path
    )
    shape = shape_of(rock, directory=tmp_path)
    facets = [shape.parts[0].facets({})]
    sun, observer = directions(12, seed=23)

    def seen(rows):
        return visible_fractions(shape, facets, [None], rows, observer)[0]

    batch = torch.stack([sun, sun.flip(0), -sun])
    together = torch.func.vmap(seen)(batch)
    assert torch.equal(together, torch.stack([seen(rows) for rows in batch]))
    assert (together < 1).any()
    for jacobian in (torch.func.jacrev, torch.func.jacfwd):
        assert not jacobian(lambda angle: seen(sun * angle).sum())(torch.ones((), dtype=F64)).any()


def test_eros_against_brute_force():
    """Rays from the middle of each facet, and traced in bulk: usually 1000 rows a second on one core."""
    if not EROS.exists():
        pytest.skip("the Eros data are not here")
    shape = shape_of(component("eros", "mesh", file="eros.obj", scale=20480.0), directory=EROS)
    facets = [shape.parts[0].facets({})]
    sun, observer = directions(200, seed=24)
    start = time.perf_counter()
    (seen,) = visible_fractions(shape, facets, [None], sun, observer)
    assert time.perf_counter() - start < 4.0
    up = ((facets[0].normal @ sun[3] > 0) & (facets[0].normal @ observer[3] > 0)).numpy()
    size = facets[0].vertices.norm(dim=-1).max()
    triangles = (facets[0].vertices / size).numpy()
    lift = 1e-3 * (facets[0].area.sqrt() / size)[:, None] * facets[0].normal
    points = triangles[up].mean(axis=1) + lift.numpy()[up]
    free = ~(blocked(points, sun[3].numpy(), triangles) | blocked(points, observer[3].numpy(), triangles))
    assert 0.01 < np.mean(~free) < 0.5
    assert np.mean(seen[3].numpy()[up] != free) < 0.003  # single precision at silhouettes


def test_second_derivatives_are_those_of_gauss_and_newton():
    parts = box_wing(0.1)
    sun, observer = directions(20, seed=25)
    functional, numbers = shadow_functional(parts, sun, observer, turned_wings(20, seed=26))
    jacobian = torch.func.jacrev(functional)(numbers)
    assert jacobian.abs().max() > 0.01
    for hessian in (torch.func.hessian, lambda f: torch.func.jacrev(torch.func.jacrev(f))):
        found = hessian(lambda row: functional(row).square().sum())(numbers)
        torch.testing.assert_close(found, 2 * jacobian.T @ jacobian, rtol=1e-10, atol=1e-12)


def test_gradient_is_zero_where_nothing_is_in_the_way():
    parts = [LID, component("far", "plate", size=[1, 1], u=[1, 0, 0], v=[0, 1, 0], centre=[50, 0, 1.0])]
    values = {name: value.requires_grad_() for name, value in sizes(*parts).items()}
    up = [[0.1, 0.2, 1.0]]
    seen = torch.cat(fractions(parts, up, up, values=values), dim=1)
    assert torch.equal(seen.detach(), torch.ones(1, 4, dtype=F64))
    gradients = torch.autograd.grad(
        seen.sum(), list(values.values()), allow_unused=True, materialize_grads=True
    )
    assert all(gradient == 0 for gradient in gradients)


def test_panels_side_by_side_in_one_plane_leave_each_other_alone():
    turn = [12.0, 33.0, 77.0]
    panels = [
        component(f"p{k}", "plate", size=[1.1, 0.7], u=[1, 0, 0], v=[0, 1, 0], rotation=turn)
        for k in range(3)
    ]
    across = shape_of(panels[0]).parts[0].turn[:, 0]
    for k, panel in enumerate(panels):
        panel.centre = [0.3, 0.1, -0.2] + 1.1 * k * across
    sun, observer = directions(200, seed=27)
    assert min(seen.min() for seen in fractions(panels, sun, observer)) > 1 - 1e-6


def test_rows_in_which_parts_cannot_meet_have_nothing_hidden():
    """Of a box and two plates that turn, against the clipping of their polygons, along random directions; sizes are a batch
    of two. Each of the two answers is given often enough to be wrong."""
    parts = [
        component("body", "box", size=[1.0, 2.0, 1.5]),
        component("left", "plate", size=[1.0, 2.0], u=[1, 0, 0], v=[0, 1, 0], centre=[0, 7.0, 0]),
        component("right", "plate", size=[1.5, 1.0], u=[0, 0, 1], v=[0, 1, 0], centre=[0.5, -6.0, 1.0]),
    ]
    shape, count = shape_of(*parts), 1500
    values = {name: torch.stack([value, 1.6 * value]) for name, value in sizes(*parts).items()}
    facets = [part.facets(values) for part in shape.parts]
    sun, observer = directions(count, 3)
    turn = tracking_pose(
        torch.tensor([0.0, 1.0, 0.0], dtype=F64), torch.tensor([0.0, 0.0, 1.0], dtype=F64), sun
    )
    rows = torch.Size((2, count))
    meeting = may_meet(shape.parts, facets, rows, (sun[None], observer[None]))
    for size in range(2):
        alone = [part.facets({name: value[size] for name, value in values.items()}) for part in shape.parts]
        found = visible_fractions(shape, alone, [None, turn, turn], sun, observer)
        hidden = (torch.cat(found, -1) < 1).any(-1)
        assert not (hidden & ~meeting[size]).any()
        assert hidden.sum() > 20
        assert (~meeting[size]).sum() > 20
    assert (meeting[1] & ~meeting[0]).any()
