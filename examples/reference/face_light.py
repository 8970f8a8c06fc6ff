"""Light that faces send to the observer, straight from the Sun or by way of the Earth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sky
from body import Face, Part, Scene, blocked
from curve import Effects
from earth import behind_earth, earth_light
from sampling import disc_point, limb, tilted
from sky import Array, apply, basis
from surface import reflected
from views import View

DEFAULTS: dict[str, dict[str, float]] = {
    "earth_shadow": {"h0": 20.0},
    "earthshine": {"albedo": 0.3},
    "interreflection": {"gain": 1.0},
}
TILES = 8192  # of the Earth's disc
PER_MATERIAL = ("lobe_tail", "second_material", "opposition_surge", "normal_dispersion")


def sunlight(
    faces: list[Face],
    parts: list[Part],
    scene: Scene,
    effects: Effects,
    view: View,
    scale: Array,
    lit: Array,
    q: Array,
) -> Array:
    """Light (B, faces) straight from the Sun; scale, lit (B, K), q (B, S, 6) with S a multiple of K."""
    per_instant = q.shape[1] // lit.shape[1]

    def each(values: Any) -> Any:
        return np.repeat(values, per_instant, axis=1)

    source, weight = each(view.to_sun), each(scale) / q.shape[1]
    if "finite_sun" not in effects:
        weight = weight * each(lit)
    else:
        source = disc_point(
            source, np.arcsin(sky.SUN_RADIUS_KM / each(view.sun_distance_km)), q[..., 0], q[..., 1]
        )
        disc = limb(q[..., 0])
        weight = weight * disc / disc.mean(axis=1, keepdims=True)
        partly = (lit > 0) & (lit < 1)
        if partly.any():
            to_axis = each(view.to_earth_axis @ np.swapaxes(view.to_body, -1, -2))
            place = each(apply(view.to_earth_axis, view.position))
            h0 = effects["earth_shadow"].get("h0", DEFAULTS["earth_shadow"]["h0"])
            above = ~behind_earth(place, apply(to_axis, source), h0)
            weight = weight * np.where(each(partly), above, each(lit))
        else:
            weight = weight * each(lit)
    poses = [None if p is None else each(p) for p in view.poses]
    return face_light(faces, parts, poses, scene, effects, source, weight, each(view.to_observer), q[..., 2:])


def earthlight(
    faces: list[Face], parts: list[Part], scene: Scene, effects: Effects, view: View, scale: Array, q: Array
) -> Array:
    """Light (B, faces) by way of the Earth; a view of one instant, scale (B,), q (B, TILES, 6)."""
    sun = apply(np.swapaxes(view.to_body, -1, -2), view.to_sun) * view.sun_distance_km[:, None]
    albedo = effects["earthshine"].get("albedo", DEFAULTS["earthshine"]["albedo"])
    tiles, strength = earth_light(view.position, sun + view.position, TILES, albedo)
    tiles = apply(view.to_body[:, None], tiles)
    observer = np.repeat(view.to_observer[:, None], TILES, axis=1)
    poses = [None if p is None else np.repeat(p[:, None], TILES, axis=1) for p in view.poses]
    weight = strength * scale[:, None]
    return face_light(faces, parts, poses, scene, effects, tiles, weight, observer, q[..., 2:])


def face_light(
    faces: list[Face],
    parts: list[Part],
    poses: list[Array | None],
    scene: Scene,
    effects: Effects,
    source: Array,
    weight: Array,
    to_observer: Array,
    q: Array,
) -> Array:
    """Sum over samples of weight A f mu0 mu V for each face, (B, faces).

    source, to_observer (B, S, 3) unit; weight (B, S); poses (B, S, 3, 3); q (B, S, 4): tilt and place of a
    ray.
    """
    shape = weight.shape
    row = np.repeat(np.arange(shape[0]), shape[1])
    source, to_observer, weight = source.reshape(-1, 3), to_observer.reshape(-1, 3), weight.ravel()
    q = q.reshape(-1, q.shape[-1])
    flat = [None if pose is None else pose.reshape(-1, 3, 3) for pose in poses]
    shadows = "self_shadowing" in effects
    out = np.zeros((shape[0], len(faces)))
    for k, face in enumerate(faces):
        pose = flat[face.part] if face.part >= 0 else None
        normal, u = face.normal, face.u
        v = np.cross(normal, u)
        changes = _changes(effects, face.material)
        sigma = np.deg2rad(changes.get("normal_dispersion", {}).get("deg", 0.0))
        if pose is not None:
            normal, u, v = pose @ normal, pose @ u, pose @ v
        else:
            normal, u, v = (np.broadcast_to(x, source.shape) for x in (normal, u, v))
        flat_lit = (normal * source).sum(-1)
        flat_seen = (normal * to_observer).sum(-1)
        through = effects.get("back_transmission", {})
        if through and face.part >= 0 and through.get("component") in (None, parts[face.part].name):
            passed = np.where((flat_lit > 0) & (flat_seen < 0), -flat_lit * flat_seen, 0.0) * weight
            out[:, k] += through["t_d"] / np.pi * face.area * np.bincount(row, passed, shape[0])
        if sigma:
            normal = tilted(normal, u, v, sigma, q[:, 0], q[:, 1])
            flat_lit = (normal * source).sum(-1)
            flat_seen = (normal * to_observer).sum(-1)
        use = np.flatnonzero((flat_lit > 0) & (flat_seen > 0) & (weight > 0))
        if use.size == 0:
            continue
        place = None
        if shadows and face.part >= 0 and len(parts) > 1:
            place = face.points(q[use, 2], q[use, 3])
            held = [None if p is None else p[use] for p in flat]
            if pose is not None:
                centre = parts[face.part].centre
                place = centre + np.einsum("nij,nj->ni", pose[use], place - centre)
            free = ~blocked(parts, held, face.part, place, source[use])
            free &= ~blocked(parts, held, face.part, place, to_observer[use])
            use = use[free]
        material = effects["appendage"] if face.part < 0 else scene.materials[face.material]
        light = reflected(material, changes, normal[use], u[use], v[use], source[use], to_observer[use])
        out[:, k] += face.area * np.bincount(row[use], light * weight[use], shape[0])
    return out


def _changes(effects: Effects, material: str) -> dict[str, Mapping[str, Any]]:
    """The injected surface effects that concern one material."""
    return {
        name: effects[name]
        for name in PER_MATERIAL
        if name in effects and effects[name].get("material", material) == material
    }


def appendage_faces(parameters: Mapping[str, Any]) -> list[Face]:
    """Both sides of the flat plate that nobody modelled."""
    lon, lat = np.deg2rad(parameters["lon"]), np.deg2rad(parameters["lat"])
    normal = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    u = basis(normal)[0]
    side = np.sqrt(float(parameters["area"]))
    e1, e2 = side * u, side * np.cross(normal, u)
    return [
        Face(-1, label, "appendage", sign * normal, u, np.zeros(3), e1, e2)
        for sign, label in ((1.0, "front"), (-1.0, "back"))
    ]
