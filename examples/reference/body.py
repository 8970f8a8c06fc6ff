"""What the object is and how it points: a scene read anew, body axes, tracking wings, rays against parts.

Vectors are in the body frame unless said. Shapes: T rows, S samples of a row; leading (...) is anything.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from sky import Array, Mask, seconds, unit

DEFAULT_EFFECTS = (
    "sun_distance",
    "light_time",
    "finite_sun",
    "earth_shadow",
    "exposure_smearing",
    "self_shadowing",
)


def number(value: Any) -> float:
    """A scene number: itself, or the ``value`` of a free one."""
    return float(value["value"] if isinstance(value, Mapping) else value)


@dataclass(frozen=True)
class Scene:
    """A scene TOML as the reference sees it; ``materials`` are the true values."""

    name: str
    tle: tuple[str, str]
    stations: dict[str, tuple[float, float, float]]
    attitude: dict[str, Any]
    components: tuple[dict[str, Any], ...]
    materials: dict[str, dict[str, Any]]
    effects: tuple[str, ...]
    parameters: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Scene:
        tree = tomllib.loads(text)
        model = tree.get("model", {})
        materials = {
            name: {key: value if isinstance(value, str) else number(value) for key, value in table.items()}
            for name, table in tree["materials"].items()
        }
        return cls(
            name=tree.get("name", ""),
            tle=tuple(tree["orbit"]["tle"]),
            stations={
                s["id"]: (s["latitude"], s["longitude"], s.get("height", 0.0)) for s in tree["stations"]
            },
            attitude=tree["attitude"],
            components=tuple(tree["components"]),
            materials=materials,
            effects=tuple(model.get("effects", DEFAULT_EFFECTS)),
            parameters=model.get("parameters", {}),
        )

    @classmethod
    def read(cls, path: str | Path) -> Scene:
        return cls.parse(Path(path).read_text())

    def with_materials(self, materials: Mapping[str, Mapping[str, Any]]) -> Scene:
        return replace(self, materials={**self.materials, **{k: dict(v) for k, v in materials.items()}})


def rotation_about(axis: Array, angle: Array) -> Array:
    """Right-handed rotation (..., 3, 3) of vectors by ``angle`` (...) rad about ``axis`` (3,) or (..., 3)."""
    axis = unit(np.broadcast_to(np.asarray(axis, float), (*np.shape(angle), 3)))
    cross = np.zeros((*np.shape(angle), 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    angle = np.asarray(angle, float)[..., None, None]
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def body_axes(attitude: Mapping[str, Any], position: Array, velocity: Array, to_sun: Array) -> Array:
    """R (..., 3, 3) of the mode without spin, columns body X, Y, Z in GCRS; unit ``to_sun`` (..., 3)."""
    mode = attitude["mode"]
    pole = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    if mode == "nadir":
        z = -unit(position)
        x = unit(velocity - (velocity * z).sum(-1, keepdims=True) * z)
    elif mode == "yaw-steering":
        z = -unit(position)
        x = np.cross(unit(np.cross(z, to_sun)), z)
    elif mode == "sun":
        z = to_sun
        x = unit(np.cross(pole, z))
    elif mode == "inertial":
        z = pole
        angle = np.deg2rad(number(attitude.get("x_angle", 0.0)))
        x = np.broadcast_to([np.cos(angle), np.sin(angle), 0.0], position.shape)
    else:
        raise ValueError(f"attitude mode {mode} is not in the reference")
    return np.stack([x, np.cross(z, x), z], axis=-1)


def spin(attitude: Mapping[str, Any], t: Array, first: float, rate_offset: float = 0.0) -> Array:
    """Rot(spin_axis, spin_phase + 360 rate (t - spin_epoch)), (..., 3, 3); rev/h; default epoch ``first``."""
    rate = number(attitude.get("spin_rate", 0.0)) + rate_offset
    epoch = seconds(str(attitude["spin_epoch"])) if "spin_epoch" in attitude else first
    degrees = number(attitude.get("spin_phase", 0.0)) + 360.0 * rate * (t - epoch) / 3600.0
    return rotation_about(np.asarray(attitude.get("spin_axis", [0, 0, 1]), float), np.deg2rad(degrees))


Hit = Callable[[Array, Array], Mask]  # origin, direction (N, 3) in the part's own axes -> (N,)


@dataclass(frozen=True)
class Face:
    """A flat patch at rest in the body frame: a rectangle of sides e1, e2, or a disc of radii e1, e2."""

    part: int
    label: str
    material: str
    normal: Array
    u: Array
    centre: Array
    e1: Array
    e2: Array
    round: bool = False

    @property
    def area(self) -> float:
        return float(np.linalg.norm(np.cross(self.e1, self.e2)) * (np.pi if self.round else 1.0))

    def points(self, a: Array, b: Array) -> Array:
        """Places (N, 3), uniform over the area for uniform a, b (N,)."""
        if self.round:
            x, y = np.sqrt(a) * np.cos(2.0 * np.pi * b), np.sqrt(a) * np.sin(2.0 * np.pi * b)
        else:
            x, y = a - 0.5, b - 0.5
        return self.centre + x[:, None] * self.e1 + y[:, None] * self.e2

    def reach(self, origin: Array, direction: Array) -> Array:
        """Distance (N,) at which rays (N, 3) meet the front of this face; inf where they do not."""
        towards = direction @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            along = ((self.centre - origin) @ self.normal) / towards
            place = origin + along[:, None] * direction - self.centre
            x = place @ self.e1 / (self.e1 @ self.e1)
            y = place @ self.e2 / (self.e2 @ self.e2)
            inside = x**2 + y**2 < 1.0 if self.round else np.maximum(np.abs(x), np.abs(y)) < 0.5
        return np.where((towards < 0) & (along > 1e-9) & inside, along, np.inf)


@dataclass(frozen=True)
class Part:
    """One component: where it is, how it turns, and the convex solid that stops rays."""

    name: str
    centre: Array
    rotation: Array  # (3, 3) of the shape at rest
    axis: Array | None  # of the drive that follows the Sun
    front: Array  # normal at rest that is turned to the Sun
    hit: Hit | None  # None: stops nothing


def hits_box(half: Array) -> Hit:
    """Slab test against the box of half edges ``half``, centred at 0."""

    def hit(origin: Array, direction: Array) -> Mask:
        with np.errstate(divide="ignore", invalid="ignore"):
            near = (-half - origin) / direction
            far = (half - origin) / direction
        first = np.fmin(near, far).max(-1)
        last = np.fmax(near, far).min(-1)
        return (last > first) & (last > 1e-9)

    return hit


def hits_rectangle(half_u: float, half_v: float) -> Hit:
    """Ray against a rectangle in the plane of its own first two axes."""

    def hit(origin: Array, direction: Array) -> Mask:
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -origin[:, 2] / direction[:, 2]
            a = np.abs(origin[:, 0] + along * direction[:, 0])
            b = np.abs(origin[:, 1] + along * direction[:, 1])
        return (along > 1e-9) & (a < half_u) & (b < half_v)

    return hit


def hits_cylinder(radius: float, half_length: float) -> Hit:
    """Ray against a closed cylinder about its own third axis."""

    def hit(origin: Array, direction: Array) -> Mask:
        a = (direction[:, :2] ** 2).sum(-1)
        b = (origin[:, :2] * direction[:, :2]).sum(-1)
        c = (origin[:, :2] ** 2).sum(-1) - radius**2
        root2 = b**2 - a * c
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(np.maximum(root2, 0.0))
            wall_in, wall_out = (-b - root) / a, (-b + root) / a
            cap_1 = (-half_length - origin[:, 2]) / direction[:, 2]
            cap_2 = (half_length - origin[:, 2]) / direction[:, 2]
        first = np.fmax(wall_in, np.fmin(cap_1, cap_2))
        last = np.fmin(wall_out, np.fmax(cap_1, cap_2))
        return (root2 > 0) & (last > first) & (last > 1e-9)

    return hit


def _perpendicular(axis: Array) -> Array:
    return unit(np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0]))


def build(components: Sequence[Mapping[str, Any]], cylinder_facets: int) -> tuple[list[Part], list[Face]]:
    """Parts and faces of a scene's components, at rest."""
    parts: list[Part] = []
    faces: list[Face] = []
    for index, component in enumerate(components):
        shape, name = component["shape"], component["name"]
        centre = np.asarray(component.get("centre", [0, 0, 0]), float)
        angles = np.deg2rad(np.asarray(component.get("rotation", [0, 0, 0]), float))
        x_turn, y_turn, z_turn = (rotation_about(np.eye(3)[k], angles[k]) for k in range(3))
        rest = z_turn @ y_turn @ x_turn
        material = component["material"]
        front, hit, axes = np.array([0, 0, 1.0]), None, rest
        if shape == "box":
            size = np.array([number(s) for s in component["size"]])
            per_face = component.get("face_materials", {})
            for k in range(3):
                for sign in (1.0, -1.0):
                    label = "+-"[int(sign < 0)] + "XYZ"[k]
                    n, u = sign * rest[:, k], rest[:, (k + 1) % 3]
                    e2 = rest[:, (k + 2) % 3] * size[(k + 2) % 3]
                    middle = centre + 0.5 * size[k] * n
                    e1 = u * size[(k + 1) % 3]
                    faces.append(Face(index, label, per_face.get(label, material), n, u, middle, e1, e2))
            hit = hits_box(size / 2.0)
        elif shape == "plate":
            size = np.array([number(s) for s in component["size"]])
            u, v = (rest @ unit(np.asarray(component[key], float)) for key in "uv")
            front = np.cross(u, v)
            axes = np.stack([u, v, front], axis=-1)
            e1, e2 = u * size[0], v * size[1]
            faces.append(Face(index, "front", material, front, u, centre, e1, e2))
            behind = component.get("back_material", material)
            faces.append(Face(index, "back", behind, -front, u, centre, e1, e2))
            hit = hits_rectangle(size[0] / 2.0, size[1] / 2.0)
        elif shape == "cylinder":
            radius, length = number(component["radius"]), number(component["length"])
            axis = rest @ unit(np.asarray(component["axis"], float))
            x = _perpendicular(axis)
            y = np.cross(axis, x)
            axes = np.stack([x, y, axis], axis=-1)
            width = 2.0 * np.pi * radius / cylinder_facets
            for angle in (np.arange(cylinder_facets) + 0.5) * 2.0 * np.pi / cylinder_facets:
                n = np.cos(angle) * x + np.sin(angle) * y
                wall, across = centre + radius * n, np.cross(n, axis) * width
                faces.append(Face(index, "side", material, n, axis, wall, axis * length, across))
            for sign, label in ((1.0, "cap+"), (-1.0, "cap-")):
                middle = centre + sign * axis * length / 2.0
                faces.append(
                    Face(index, label, material, sign * axis, x, middle, x * radius, y * radius, True)
                )
            hit = hits_cylinder(radius, length / 2.0)
        else:
            raise ValueError(f"shape {shape} is not in the reference")
        tracks = component.get("tracks")
        axis = unit(np.asarray(tracks["axis"], float)) if tracks else None
        parts.append(Part(name, centre, axes, axis, front, hit))
    return parts, faces


def wing_pose(part: Part, to_sun: Array, offset_rad: float = 0.0, cant_rad: float = 0.0) -> Array | None:
    """Rotation (..., 3, 3) of a tracking part about its centre, to_sun (..., 3) in the body frame; or None.

    The drive turns the part until the front normal p has the largest p.s; ``offset_rad`` turns it further
    about the axis, ``cant_rad`` then tilts p about p x axis (towards +axis).
    """
    if part.axis is None:
        return None
    axis = part.axis
    rest = part.front - (part.front @ axis) * axis
    want = to_sun - (to_sun @ axis)[..., None] * axis
    angle = np.arctan2(np.cross(rest, want) @ axis, want @ rest) + offset_rad
    pose = rotation_about(axis, angle)
    if cant_rad:
        pose = rotation_about(np.cross(pose @ part.front, axis), np.full(angle.shape, cant_rad)) @ pose
    return pose


def blocked(parts: list[Part], poses: list[Array | None], own: int, origin: Array, direction: Array) -> Mask:
    """Whether rays (N, 3) from part ``own``, convex, meet any other part; poses (N, 3, 3) or None."""
    stopped = np.zeros(len(origin), bool)
    for index, (part, pose) in enumerate(zip(parts, poses, strict=True)):
        if index == own or part.hit is None:
            continue
        start, along = origin - part.centre, direction
        if pose is not None:
            start = np.einsum("nji,nj->ni", pose, start)
            along = np.einsum("nji,nj->ni", pose, along)
        stopped |= part.hit(start @ part.rotation, along @ part.rotation)
    return stopped
