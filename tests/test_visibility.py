"""Joint visibility against plane geometry, brute-force rays and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.rays import fraction_lit_and_seen, triangles_of
from tests.test_shape import component, shape_of, sizes
from torchlc.shape import tracking_pose
from torchlc.visibility import visible_fractions

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
