"""A light curve by brute force: the independent truth that torchlc is checked against.

It shares no code with torchlc and never imports it: numpy, SGP4 for the orbit and ERFA for the Sun,
everything else from its definition. What torchlc does in closed form or by a few quadrature nodes is here
sampled: 64 instants in an exposure, 4096 points of the limb-darkened solar disc and as many rays against the
other parts, all drawn together for each row (a shifted additive sequence: errors are small and differ from
row to row).

    from bruteforce import simulate
    from detector import photometry
    scene = Scene.read("scene.toml").with_materials(true)
    curve = simulate(scene, t, exptime, "weihai", {"finite_sun": {}, "panel_offset": {"deg": 2.5}})
    mag = photometry(curve, scene, {})

``sky`` knows time, orbit, station and Sun; ``body`` reads a scene and knows attitude, parts and rays; ``views`` brings them
together; ``face_light`` adds up what faces send, and ``detector`` makes magnitudes of it;
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

from dataclasses import dataclass
from typing import Any

import numpy as np
import sky
from body import Face, Part, Scene, build, number
from bounces import two_bounces
from curve import Curve, Effects
from earth import sunlit_fraction
from face_light import DEFAULTS, TILES, appendage_faces, earthlight, sunlight
from sampling import additive_sequence
from sky import Array, apply
from views import View, view_of


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
class Placed:
    """Parts and faces, and where they are: what does not depend on the materials."""

    parts: list[Part]
    faces: list[Face]
    view: View


def placed(
    scene: Scene,
    t: Array,
    exptime: Array | float,
    station: Array | str,
    effects: Effects,
    instants: int = 64,
    cylinder_facets: int = 240,
) -> Placed:
    """Where all is at mid-exposure stamps t (T,) s, and at ``instants`` of each exposure if these are asked for."""
    exptime = np.broadcast_to(np.asarray(exptime, float), t.shape)
    station = np.broadcast_to(np.asarray(station), t.shape)
    parts, faces = build(scene.components, cylinder_facets)
    if "appendage" in effects:
        faces = faces + appendage_faces(effects["appendage"])
    k = instants if "exposure_smearing" in effects else 1
    inside = (np.arange(k) + 0.5) / k - 0.5
    moments = t[:, None] + exptime[:, None] * inside
    sites = np.broadcast_to(station[:, None], (len(t), k))
    return Placed(parts, faces, view_of(scene, parts, moments, float(t.min()), sites, effects))


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
    known: Placed | None = None,
) -> Curve:
    """The curve at mid-exposure stamps t (T,) s with the scene's materials and exactly these ``effects``. ``known`` is where all is, if a
    curve of other materials had that."""
    t = np.asarray(t, float)
    rows_total = len(t)
    if known is None:
        known = placed(scene, t, exptime, station, effects, instants, cylinder_facets)
    parts, faces, view = known.parts, known.faces, known.view
    sampled = any(name in effects for name in ("finite_sun", "self_shadowing", "normal_dispersion"))
    k = view.to_sun.shape[1]
    per_instant = max(samples // k, 1) if sampled else 1
    count = k * per_instant
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
        light[rows] += sunlight(faces, parts, scene, effects, view.rows(rows), scale[rows], lit[rows], q)
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
            light[rows] += earthlight(faces, parts, scene, effects, middle, scale[rows].mean(1), q)

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
