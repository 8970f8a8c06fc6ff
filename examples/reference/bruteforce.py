"""A light curve by brute force: the independent truth that torchlc is checked against.

It shares no code with torchlc and never imports it: numpy, SGP4 for the orbit and ERFA for the Sun,
everything else from its definition. What torchlc does in closed form or by a few quadrature nodes is here
sampled: 64 instants in an exposure, 4096 points of the limb-darkened solar disc and as many rays against the
other parts, all drawn together for each row (a shifted additive sequence: errors are small and differ from
row to row).

    from bruteforce import simulate, photometry
    scene = Scene.read("scene.toml").with_materials(true)
    curve = simulate(scene, t, exptime, "weihai", {"finite_sun": {}, "panel_offset": {"deg": 2.5}})
    mag = photometry(curve, scene, {})

``sky`` knows time, orbit, station and Sun; ``body`` reads a scene and knows attitude, parts and rays;
``surface`` reflects; ``earth`` hides the Sun and shines; ``bounces`` sends light between parts;
``observe`` adds noise and writes files; ``circumstances`` and ``gain`` draw and size injections.

Conventions, where more than one reading is possible:
- ``effects`` is the whole truth: name -> parameters; nothing is on by default. Without any: the paper's bare
  model (one instant, the Sun a point, 1 au, no shadow of any kind, no light time).
- time_offset s: object, Sun and station are evaluated at stamp + s. along_track_offset deg: the orbit (not
  the spin or the clock) is read deg/360 of a period later, and the attitude law follows the new position.
- attitude_offset and wobble: R = R0 Rot(w), w in body axes, and the wings find the Sun from the body so
  turned. wobble is deg sin(2 pi (t - first)/period + phase), first being the earliest row.
- panel_offset is a right-handed turn about the drive axis; panel_cant then tilts the front normal p about
  p x axis, towards +axis. normal_dispersion: tilts of deg (standard deviation) about two axes in the face.
- background is a fraction of the median flux; saturation divides by the largest flux; color_term adds mag
  times the component's share; zero_point_drift is relative to the mean time of the rows.
- interreflection: one bounce, Sun's centre, mid-exposure; earthshine: Lambert sphere of 6371 km,
  mid-exposure. An ``appendage`` neither shadows nor is shadowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import sky
from body import Face, Part, Scene, blocked, body_axes, build, number, rotation_about, spin, wing_pose
from bounces import two_bounces
from earth import behind_earth, earth_light, sunlit_fraction
from sampling import additive_sequence, disc_point, limb, tilted
from sky import Array, apply, basis, unit
from surface import reflected

TILES = 8192  # of the Earth's disc
DEFAULTS: dict[str, dict[str, float]] = {
    "earth_shadow": {"h0": 20.0},
    "earthshine": {"albedo": 0.3},
    "interreflection": {"gain": 1.0},
}
PER_MATERIAL = ("lobe_tail", "second_material", "opposition_surge", "normal_dispersion")

Effects = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Curve:
    """What arrives at the telescope before the detector; T rows, C components."""

    t: Array  # (T,) s since 2000-01-01 UTC, as stamped
    flux: Array  # (T,) irradiance over the Sun's at 1 au
    components: tuple[str, ...]
    component_flux: Array  # (T, C)
    sunlit: Array  # (T,) 1 full sunlight, 0 umbra
    range_km: Array
    phase_deg: Array
    elevation_deg: Array
    sun_elevation_deg: Array
    airmass: Array


def scene_effects(scene: Scene) -> dict[str, dict[str, Any]]:
    """The physics that the scene's own list holds, with its parameters' values."""
    out: dict[str, dict[str, Any]] = {}
    for name in scene.effects:
        out[name] = dict(DEFAULTS.get(name, {}))
        for key, value in scene.parameters.items():
            if key.startswith(name + ".") and "[" not in key:
                out[name][key.split(".", 1)[1]] = number(value)
    return out


@dataclass(frozen=True)
class _View:
    """Geometry of rows at K instants (T, K, ...), directions in the body frame."""

    to_sun: Array  # (T, K, 3) unit
    sun_distance_km: Array  # (T, K)
    to_observer: Array  # (T, K, 3) unit
    range_km: Array  # (T, K)
    to_body: Array  # (T, K, 3, 3) from GCRS
    position: Array  # (T, K, 3) GCRS, km
    to_earth_axis: Array  # (T, K, 3, 3) from GCRS, z the axis of date
    poses: list[Array | None]
    zenith: Array  # (T, K, 3) GCRS
    station_to_sun: Array  # (T, K, 3) GCRS

    def _each(self, pick: Callable[[Any], Any]) -> _View:
        """``pick`` applied to every array."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        poses = [None if pose is None else pick(pose) for pose in values.pop("poses")]
        return _View(poses=poses, **{name: pick(value) for name, value in values.items()})

    def rows(self, rows: slice) -> _View:
        return self._each(lambda values: values[rows])

    def at(self, instant: int) -> _View:
        """One instant, without the axis K."""
        return self._each(lambda values: values[:, instant])


def _view(scene: Scene, parts: list[Part], t: Array, first: float, station: Array, effects: Effects) -> _View:
    clock = t + effects.get("time_offset", {}).get("s", 0.0)
    site, zenith = np.zeros((*t.shape, 3)), np.zeros((*t.shape, 3))
    for name in np.unique(station):
        rows = station == name
        site[rows], zenith[rows] = sky.station(clock[rows], *scene.stations[str(name)])
    orbit = sky.Orbit(scene.tle)
    ahead = effects.get("along_track_offset", {}).get("deg", 0.0) / 360.0 * orbit.period_s
    emitted = clock
    if "light_time" in effects:
        for _ in range(2):
            emitted = clock - np.linalg.norm(orbit.state(emitted + ahead)[0] - site, axis=-1) / sky.LIGHT_KM_S
    position, velocity = orbit.state(emitted + ahead)
    to_sun = sky.sun(emitted) - position
    to_observer = site - position
    sun_distance, range_km = np.linalg.norm(to_sun, axis=-1), np.linalg.norm(to_observer, axis=-1)
    sun_unit = to_sun / sun_distance[..., None]

    attitude = scene.attitude
    nominal = body_axes(attitude, position, velocity, sun_unit)
    if "spin_axis" in attitude:
        rate = effects.get("spin_rate_offset", {}).get("rev_per_hour", 0.0)
        nominal = nominal @ spin(attitude, emitted, first, rate)
    tilt = np.zeros((*t.shape, 3))
    if "attitude_offset" in effects:
        tilt = tilt + np.deg2rad([effects["attitude_offset"].get(axis, 0.0) for axis in "xyz"])
    if "attitude_jump" in effects:
        jump = effects["attitude_jump"]
        tilt = tilt + (clock > jump["time"])[..., None] * np.deg2rad([jump.get(axis, 0.0) for axis in "xyz"])
    if "wobble" in effects:
        wobble = effects["wobble"]
        turns = (emitted - first) / (60.0 * wobble["period_min"]) + wobble.get("phase_deg", 0.0) / 360.0
        axis = np.eye(3)["xyz".index(wobble["axis"])]
        tilt = tilt + np.deg2rad(wobble["deg"]) * np.sin(2.0 * np.pi * turns)[..., None] * axis
    actual = nominal
    if np.any(tilt):
        angle = np.linalg.norm(tilt, axis=-1)
        axis = np.where(angle[..., None] > 0, tilt, [0.0, 0.0, 1.0])
        actual = nominal @ rotation_about(axis, angle)
    to_body = np.swapaxes(actual, -1, -2)
    body_sun = apply(to_body, sun_unit)

    offset = effects.get("panel_offset", {}).get("deg", 0.0)
    split = effects.get("wing_split", {}).get("deg", 0.0)
    cant = np.deg2rad(effects.get("panel_cant", {}).get("deg", 0.0))
    poses: list[Array | None] = []
    wing = 0
    for part in parts:
        own = offset + (split if wing % 2 == 0 else -split)
        wing += part.axis is not None
        poses.append(wing_pose(part, body_sun, np.deg2rad(own), cant))
    return _View(
        to_sun=body_sun,
        sun_distance_km=sun_distance,
        to_observer=apply(to_body, to_observer / range_km[..., None]),
        range_km=range_km,
        to_body=to_body,
        position=position,
        to_earth_axis=np.swapaxes(sky.teme_to_gcrs(clock), -1, -2),
        poses=poses,
        zenith=zenith,
        station_to_sun=unit(to_sun + position - site),
    )


def _changes(effects: Effects, material: str) -> dict[str, Mapping[str, Any]]:
    """The injected surface effects that concern one material."""
    return {
        name: effects[name]
        for name in PER_MATERIAL
        if name in effects and effects[name].get("material", material) == material
    }


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


def _appendage(parameters: Mapping[str, Any]) -> list[Face]:
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


def _sunlight(
    faces: list[Face],
    parts: list[Part],
    scene: Scene,
    effects: Effects,
    view: _View,
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


def _earthlight(
    faces: list[Face], parts: list[Part], scene: Scene, effects: Effects, view: _View, scale: Array, q: Array
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


def simulate(
    scene: Scene,
    t: Array,
    exptime: Array | float,
    station: Array | str,
    effects: Effects,
    *,
    samples: int = 4096,
    instants: int = 64,
    rays: int = 8192,
    cylinder_facets: int = 240,
    seed: int = 0,
) -> Curve:
    """The curve at mid-exposure stamps t (T,) s with the scene's materials and exactly these ``effects``."""
    t = np.asarray(t, float)
    rows_total = len(t)
    exptime = np.broadcast_to(np.asarray(exptime, float), t.shape)
    station = np.broadcast_to(np.asarray(station), t.shape)
    parts, faces = build(scene.components, cylinder_facets)
    if "appendage" in effects:
        faces = faces + _appendage(effects["appendage"])
    sampled = any(name in effects for name in ("finite_sun", "self_shadowing", "normal_dispersion"))
    k = instants if "exposure_smearing" in effects else 1
    per_instant = max(samples // k, 1) if sampled else 1
    count = k * per_instant
    inside = (np.arange(k) + 0.5) / k - 0.5
    first = float(t.min())
    moments = t[:, None] + exptime[:, None] * inside
    sites = np.broadcast_to(station[:, None], (rows_total, k))
    view = _view(scene, parts, moments, first, sites, effects)
    sequence = additive_sequence(count, 6).reshape(per_instant, k, 6).swapaxes(0, 1).reshape(count, 6)
    rng = np.random.default_rng(seed)
    shift = rng.random((rows_total, 1, 6))
    scale = 1.0 / (view.range_km * 1000.0) ** 2
    if "sun_distance" in effects:
        scale = scale * (sky.AU_KM / view.sun_distance_km) ** 2
    lit = np.ones((rows_total, k))
    h0 = effects.get("earth_shadow", {}).get("h0", DEFAULTS["earth_shadow"]["h0"])
    if "earth_shadow" in effects:
        earth_sun = apply(np.swapaxes(view.to_body, -1, -2), view.to_sun) * view.sun_distance_km[..., None]
        lit = sunlit_fraction(
            apply(view.to_earth_axis, view.position), apply(view.to_earth_axis, earth_sun), h0
        )

    light = np.zeros((rows_total, len(faces)))
    mid = k // 2
    widest = max(count, TILES * ("earthshine" in effects), rays * ("interreflection" in effects))
    block = max(1, 200_000 // widest)
    for start in range(0, rows_total, block):
        rows = slice(start, min(start + block, rows_total))
        q = np.mod(sequence + shift[rows], 1.0)
        light[rows] += _sunlight(faces, parts, scene, effects, view.rows(rows), scale[rows], lit[rows], q)
        middle = view.rows(rows).at(mid)
        if "interreflection" in effects:
            twice = two_bounces(
                faces[: len(faces) - 2 * ("appendage" in effects)],
                parts,
                middle.poses,
                scene,
                middle.to_sun,
                middle.to_observer,
                rays,
                rng,
            )
            gain = effects["interreflection"].get("gain", 1.0) * (scale * lit)[rows].mean(1)
            light[rows, : twice.shape[1]] += gain[:, None] * twice
        if "earthshine" in effects:
            q = np.mod(additive_sequence(TILES, 6) + shift[rows], 1.0)
            light[rows] += _earthlight(faces, parts, scene, effects, middle, scale[rows].mean(1), q)

    names = tuple(part.name for part in parts) + (("appendage",) if "appendage" in effects else ())
    component_flux = np.zeros((rows_total, len(names)))
    for index, face in enumerate(faces):
        component_flux[:, face.part] += light[:, index]
    middle = view.at(mid)
    to_station = apply(np.swapaxes(middle.to_body, -1, -2), middle.to_observer)
    elevation = np.rad2deg(np.arcsin(-(to_station * middle.zenith).sum(-1)))
    sun_elevation = np.rad2deg(np.arcsin((middle.station_to_sun * middle.zenith).sum(-1)))
    cos_phase = (middle.to_sun * middle.to_observer).sum(-1)
    return Curve(
        t=t,
        flux=light.sum(1),
        components=names,
        component_flux=component_flux,
        sunlit=lit.mean(1),
        range_km=middle.range_km,
        phase_deg=np.rad2deg(np.arccos(np.clip(cos_phase, -1.0, 1.0))),
        elevation_deg=elevation,
        sun_elevation_deg=sun_elevation,
        airmass=sky.airmass(elevation),
    )


def photometry(curve: Curve, scene: Scene, effects: Effects) -> Array:
    """Noiseless apparent magnitudes (T,) after detector and calibration; inf where no light arrives."""
    flux = curve.flux.copy()
    hours = (curve.t - curve.t.mean()) / 3600.0
    if "flash" in effects:  # outside torchlc's library: a part that turns by itself
        flash = effects["flash"]
        cycle = np.mod((curve.t - curve.t[0]) / 60.0 / flash["period_min"] + 0.5, 1.0) - 0.5
        flux += flash["fraction"] * np.median(curve.flux) * np.exp(-0.5 * (cycle / flash["width"]) ** 2)
    if "star" in effects:  # outside torchlc's library: in the aperture for a while
        star = effects["star"]
        inside = np.abs(curve.t - star["time"]) < 30.0 * star["minutes"]
        flux += star["fraction"] * np.median(curve.flux) * inside
    if "background" in effects:
        flux += effects["background"]["fraction"] * np.median(curve.flux)
    if "saturation" in effects:
        flux *= 1.0 - effects["saturation"]["q"] * flux / flux.max()
    with np.errstate(divide="ignore"):
        mag = -2.5 * np.log10(np.maximum(flux, 0.0))
    mag += number(scene.parameters.get("band_sun_magnitude", -26.7))
    mag += number(scene.parameters.get("zero_point", 0.0))
    if "color_term" in effects:
        color = effects["color_term"]
        chosen = [name.startswith(color["component"]) for name in curve.components]
        mag = mag + color["mag"] * curve.component_flux[:, chosen].sum(1) / np.maximum(curve.flux, 1e-300)
    if "extinction_residual" in effects:
        mag = mag + effects["extinction_residual"]["mag_per_airmass"] * (curve.airmass - 1.0)
    if "zero_point_drift" in effects:
        mag = mag + effects["zero_point_drift"]["mag_per_hour"] * hours
    if "zero_point_step" in effects:
        mag = mag + effects["zero_point_step"]["mag"] * (curve.t > effects["zero_point_step"]["time"])
    if "cloud" in effects:  # outside torchlc's library: it comes quickly and clears slowly
        cloud = effects["cloud"]
        since = (curve.t - cloud["time"]) / 60.0 / cloud["minutes"]
        mag = mag + cloud["mag"] * np.exp(-0.5 * (since / np.where(since < 0, 0.3, 1.0)) ** 2)
    if "cirrus" in effects:  # outside torchlc's library: thin cloud that dims in waves, and never brightens
        cirrus = effects["cirrus"]
        waves = np.random.default_rng(cirrus["seed"])
        depth = np.zeros_like(mag)
        for _ in range(12):
            turns = (curve.t - curve.t[0]) / 60.0 / (2 * np.pi * cirrus["tau_min"] * waves.uniform(0.3, 1.5))
            depth += waves.standard_normal() * np.sin(2 * np.pi * (turns + waves.random()))
        mag = mag + cirrus["mag"] * np.abs(depth) / np.sqrt(6.0)
    return mag
