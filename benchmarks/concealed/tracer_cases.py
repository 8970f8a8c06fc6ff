"""Cases by path tracing: Mitsuba 3 renders meshes under lamps, and whatever light does there is in the recording.

Nothing is put in by a formula of an effect. Shadows and light between parts come out of the paths; an appendage is one more
mesh, a canted panel is a turned one, a wrong size a scaled one, and what no library has is a second lamp. The nominal scene
is the same body without. Bodies are of Lambert and of bare rough metal (GGX), laws that torchlc has too: where nothing is
missing the two agree to the tracer's noise, some 0.3 %; Fresnel's rise is absent from the metal, at most 1 % of it at a phase
angle of 100 degrees. Where a cause shows (``where``) is told by the nominal model's refit to the noiseless curve.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path[:0] = [str(EXAMPLES / one) for one in ("calibration", "reference")]

import observe  # noqa: E402
import sky  # noqa: E402
from body import Scene, body_axes, build, spin, wing_pose  # noqa: E402
from circumstances import Setup, draw  # noqa: E402
from concealed import Rng, kinds  # noqa: E402
from rivals import ENOUGH  # noqa: E402
from scene_files import toml, uniform_prior  # noqa: E402

from benchmarks.concealed.case import Array, Case, left_by  # noqa: E402
from benchmarks.concealed.reference_cases import SEEN  # noqa: E402

ROWS = 120
PIXELS, SAMPLES, DEPTH = 48, 36, 8
SEEN_SIGMA = 2.0
PIT = "pit.obj"
OPENING, FLOOR, FINE = 0.75, -0.6, 4
"""Of a cube of half edge 1: half the opening in its +Z face, where its floor lies, and squares along an inner edge."""


@dataclass(frozen=True)
class World:
    """What the tracer sees beside the scene's parts: ``sizes``, factors by part; ``cant_deg`` of the wings; ``extra`` boxes
    (centre, half edges, albedo); ``lamp``, a direction in GCRS and its share of sunlight."""

    sizes: Mapping[str, float] = field(default_factory=dict)
    cant_deg: float = 0.0
    extra: tuple[tuple[Array, Array, float], ...] = ()
    lamp: tuple[Array, float] | None = None


def make(kind: str, number: int, seed: int, folder: Path) -> str:
    """Case ``number`` of a class, made into ``folder``; returns a line about it. What is concealed is drawn until it shows."""
    name = f"tracer-{kind}-{number}"
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    folder.mkdir(parents=True, exist_ok=True)
    while True:
        setup, effects, world = _composed(kind, 71001 + number, rng)
        if any("file" in one for one in setup.tree["components"]):
            (folder / PIT).write_text(pit(), encoding="utf-8")
        mag = traced(setup, world, seed, folder)
        error = observe.errors(mag, setup.floor)
        (folder / "scene.toml").write_text(toml(setup.tree), encoding="utf-8")
        answer = {
            "key": name,
            "class": kind,
            "generator": "tracer",
            "kind": setup.kind,
            "effects": effects,
        }
        _write(folder, setup, mag, error)  # the noiseless curve first, for the answer
        observe.write_answer(folder / "answer.json", answer)
        case = Case(folder)
        gain = float(np.linalg.norm(case.residual))
        if kind == "none" or gain >= SEEN:
            break
    rows = np.abs(case.residual[: len(mag)]) > SEEN_SIGMA
    answer |= {
        "family": [effects, *_fewer(case, effects)] if effects else [],
        "gain": round(gain, 2),
        "where": {"intervals": observe.intervals(setup.t, rows)} if kind != "none" else None,
    }
    _write(folder, setup, mag + error * rng.standard_normal(len(mag)), error)
    observe.write_answer(folder / "answer.json", answer)
    return f"{name}: {setup.kind}, {len(mag)} rows, gain {gain:.1f}, {effects}"


def _fewer(case: Case, effects: list[str]) -> list[list[str]]:
    """Some of several effects whose refit leaves too little of the noiseless curve to ask for the others."""
    some = [names for size in range(1, len(effects)) for names in combinations(effects, size)]
    return [list(names) for names in some if float((left_by(case.fitted(names)) ** 2).sum()) < ENOUGH]


def _write(folder: Path, setup: Setup, mag: Array, error: Array) -> None:
    rows = len(mag)
    observe.write_recording(
        folder / "recording.ecsv",
        setup.t,
        mag,
        error,
        np.full(rows, setup.exptime),
        np.full(rows, setup.station),
    )


# ------------------------------------------------------------------------------------------ what there is


def _composed(kind: str, number: int, rng: Rng) -> tuple[Setup, list[str], World]:
    """The scene as handed out, names of what it leaves out, and the world."""
    if kind == "none":
        return _body(number, rng, "box", []), [], World()
    if kind == "unlisted":
        lamp = sky.unit(rng.standard_normal(3))
        return _body(number, rng, "box", []), [], World(lamp=(lamp, draw(rng, 0.15, 0.3)))
    if kind == "nominal scene":
        return _body(number, rng, "box", []), [], World(sizes={"body": draw(rng, 1.1, 1.2)})
    choice = int(rng.integers(5 if kind == "one" else 2))
    if kind == "one":
        if choice == 0:  # dark wings send little light back
            return _body(number, rng, "wing", [], panel=0.05), ["self_shadowing"], World()
        if choice == 1:
            return _body(number, rng, "wing", ["self_shadowing"], panel=0.8), ["interreflection"], World()
        if choice == 2:
            return _body(number, rng, "box", []), ["appendage"], World(extra=(_plate(rng),))
        if choice == 3:
            return _hollow(_body(number, rng, "box", ["self_shadowing"])), ["interreflection"], World()
        return (
            _body(number, rng, "geo", ["self_shadowing"]),
            ["panel_cant"],
            World(cant_deg=draw(rng, 2.0, 4.0) * float(rng.choice([-1, 1]))),
        )
    if choice == 0:
        return _body(number, rng, "wing", [], panel=0.8), ["interreflection", "self_shadowing"], World()
    return (
        _body(number, rng, "geo", []),
        ["panel_cant", "self_shadowing"],
        World(cant_deg=draw(rng, 2.0, 4.0)),
    )


def _body(number: int, rng: Rng, kind: str, effects: list[str], panel: float | None = None) -> Setup:
    """A box, with fixed wings ("wing") or wings that follow the Sun ("geo"): Lambert, the following ones of bare metal."""
    setup = kinds(number)[kind](rng)
    tree = deepcopy(setup.tree)
    true: dict[str, dict[str, Any]] = {"body": {"model": "lambert", "albedo": draw(rng, 0.3, 0.8)}}
    if kind == "wing":
        true["panel"] = {"model": "lambert", "albedo": panel or 0.2}
    if kind == "geo":
        true["panel"] = {
            "model": "ggx",
            "alpha": draw(rng, 0.1, 0.25),
            "f0": draw(rng, 0.2, 0.6),
            "r_diff": 0.0,
        }
    free = {
        "albedo": uniform_prior(0.5),
        "f0": uniform_prior(0.5),
        "alpha": {"value": 0.15, "low": 0.01, "high": 1.0, "prior": "loguniform"},
    }
    tree["materials"] = {
        name: {key: free.get(key, value) for key, value in values.items()} for name, values in true.items()
    }
    tree["model"]["effects"] = effects
    some = np.linspace(0, len(setup.t) - 1, min(ROWS, len(setup.t))).round().astype(int)
    return replace(setup, tree=tree, true_materials=true, t=setup.t[some], exptime=0.0)


def _hollow(setup: Setup) -> Setup:
    """The body a bright cube with a pit, light going to and fro in it."""
    tree = deepcopy(setup.tree)
    tree["components"] = [
        {"name": "body", "shape": "mesh", "file": PIT, "centre": [0.0, 0.0, 0.0], "material": "body"}
    ]
    return replace(setup, tree=tree, true_materials={"body": {"model": "lambert", "albedo": 0.8}})


def pit() -> str:
    """A cube of half edge 1 m with a square pit in its +Z face, as an OBJ file; normals outwards."""
    a, z = OPENING, FLOOR
    patches = [  # corner, two edges whose cross product is the normal, squares along an edge
        ((-1, -1, -1), (0, 2, 0), (2, 0, 0), 1),
        ((1, -1, -1), (0, 2, 0), (0, 0, 2), 1),
        ((-1, -1, -1), (0, 0, 2), (0, 2, 0), 1),
        ((-1, 1, -1), (0, 0, 2), (2, 0, 0), 1),
        ((-1, -1, -1), (2, 0, 0), (0, 0, 2), 1),
        ((-1, -1, 1), (2, 0, 0), (0, 1 - a, 0), 1),
        ((-1, a, 1), (2, 0, 0), (0, 1 - a, 0), 1),
        ((-1, -a, 1), (1 - a, 0, 0), (0, 2 * a, 0), 1),
        ((a, -a, 1), (1 - a, 0, 0), (0, 2 * a, 0), 1),
        ((-a, -a, z), (2 * a, 0, 0), (0, 2 * a, 0), FINE),
        ((a, -a, z), (0, 0, 1 - z), (0, 2 * a, 0), FINE),
        ((-a, -a, z), (0, 2 * a, 0), (0, 0, 1 - z), FINE),
        ((-a, a, z), (2 * a, 0, 0), (0, 0, 1 - z), FINE),
        ((-a, -a, z), (0, 0, 1 - z), (2 * a, 0, 0), FINE),
    ]
    points, faces = [], []
    for corner, first, second, count in patches:
        origin, e1, e2 = np.array(corner, float), np.array(first) / count, np.array(second) / count
        for i in range(count):
            for j in range(count):
                at = origin + i * e1 + j * e2
                base = len(points) + 1
                points += [at, at + e1, at + e1 + e2, at + e2]
                faces += [(base, base + 1, base + 2), (base, base + 2, base + 3)]
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    return "\n".join([*lines, *(f"f {one} {two} {three}" for one, two, three in faces)]) + "\n"


def _plate(rng: Rng) -> tuple[Array, Array, float]:
    """A bright flat box that stands off the body."""
    centre = 2.2 * sky.unit(rng.standard_normal(3))
    half = np.array([0.5, 0.5, 0.5]) * draw(rng, 0.9, 1.3)
    half[int(rng.integers(3))] = 0.01
    return centre, half, 0.8


# ------------------------------------------------------------------------------------------ light


def traced(setup: Setup, world: World, seed: int, folder: Path) -> Array:
    """Magnitudes (T,) at the setup's rows; ``folder`` has the meshes."""
    import drjit
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    drjit.set_thread_count(1)
    scene = setup.true_scene()
    to_sun, to_observer, to_body, range_m = view(scene, setup.t, setup.station)
    cant = np.deg2rad(world.cant_deg)
    poses = [
        None if one["shape"] == "mesh" else wing_pose(build([one], 8)[0][0], to_sun, 0.0, cant)
        for one in scene.components
    ]
    intensity = np.empty(len(setup.t))
    for row in range(len(setup.t)):
        meshes = []
        for one, pose in zip(scene.components, poses, strict=True):
            bsdf = _bsdf(scene.materials[one["material"]])
            meshes.append(_mesh(one, bsdf, None if pose is None else pose[row], world, folder))
        meshes += [
            _box(centre, half, np.eye(3), _bsdf({"albedo": albedo})) for centre, half, albedo in world.extra
        ]
        lamps = [(to_sun[row], 1.0)]
        if world.lamp is not None:
            lamps.append((to_body[row] @ world.lamp[0], world.lamp[1]))
        intensity[row] = rendered(meshes, lamps, to_observer[row], seed + row)
    magnitude = scene.parameters["band_sun_magnitude"]
    return magnitude - 2.5 * np.log10(np.maximum(intensity, 1e-12) / range_m**2)


def view(scene: Scene, t: Array, station: str) -> tuple[Array, Array, Array, Array]:
    """Unit vectors to the Sun and to the observer in the body frame (T, 3), the rotation into it from GCRS (T, 3, 3), and
    the range, m (T,)."""
    position, velocity = sky.Orbit(scene.tle).state(t)
    site, _ = sky.station(t, *scene.stations[station])
    sun = sky.unit(sky.sun(t) - position)
    axes = body_axes(scene.attitude, position, velocity, sun)
    if "spin_axis" in scene.attitude:
        axes = axes @ spin(scene.attitude, t, float(t.min()))
    to_body = np.swapaxes(axes, -1, -2)
    line = site - position
    return (
        sky.apply(to_body, sun),
        sky.apply(to_body, sky.unit(line)),
        to_body,
        1e3 * np.linalg.norm(line, axis=-1),
    )


def rendered(
    meshes: list[dict[str, Any]], lamps: list[tuple[Array, float]], to_observer: Array, seed: int
) -> float:
    """Radiant intensity towards the observer, m2/sr, under lamps (direction towards it, irradiance) at infinity: the mean
    radiance of an orthographic picture times its area."""
    import mitsuba

    reach = 1.01 * max(mesh["reach"] for mesh in meshes)
    up = sky.basis(to_observer)[0]
    transform = mitsuba.ScalarTransform4f
    look = transform().look_at(origin=(3 * reach * to_observer).tolist(), target=[0, 0, 0], up=up.tolist())
    description: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "sensor": {
            "type": "orthographic",
            "near_clip": 0.01 * reach,
            "far_clip": 6 * reach,
            "to_world": look @ transform().scale([reach, reach, 1.0]),
            "film": {
                "type": "hdrfilm",
                "width": PIXELS,
                "height": PIXELS,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
            "sampler": {"type": "stratified", "sample_count": SAMPLES},
        },
    }
    for k, (towards, strength) in enumerate(lamps):
        description[f"lamp{k}"] = {
            "type": "directional",
            "direction": (-towards).tolist(),
            "irradiance": {"type": "rgb", "value": strength},
        }
    for k, mesh in enumerate(meshes):
        description[f"mesh{k}"] = {key: value for key, value in mesh.items() if key != "reach"}
    picture = np.array(mitsuba.render(mitsuba.load_dict(description), seed=seed))
    return float(picture.mean()) * (2 * reach) ** 2


def _bsdf(material: Mapping[str, Any]) -> dict[str, Any]:
    if material.get("model", "lambert") == "lambert":
        inner: dict[str, Any] = {
            "type": "diffuse",
            "reflectance": {"type": "rgb", "value": material["albedo"]},
        }
    else:
        inner = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": material["alpha"],
            "material": "none",
            "specular_reflectance": {"type": "rgb", "value": material["f0"]},
        }
    return {"type": "twosided", "bsdf": inner}


def _box(
    centre: Array, half: Array, turn: Array, bsdf: dict[str, Any], shape: str = "cube"
) -> dict[str, Any]:
    """A box, or a rectangle of its first two axes, with the distance of its farthest corner from 0 as ``reach``."""
    import mitsuba

    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * half, centre
    reach = float(np.linalg.norm(centre) + np.linalg.norm(half))
    return {"type": shape, "to_world": mitsuba.ScalarTransform4f(matrix), "bsdf": bsdf, "reach": reach}


def _mesh(
    component: Mapping[str, Any], bsdf: dict[str, Any], pose: Array | None, world: World, folder: Path
) -> dict[str, Any]:
    """A part of the scene where it stands, the first edge of a box or plate scaled as the world has it."""
    if component["shape"] == "mesh":
        file = str(folder / component["file"])
        return {"type": "obj", "filename": file, "face_normals": True, "bsdf": bsdf, "reach": np.sqrt(3.0)}
    size = np.array(component["size"], float)
    size[0] *= world.sizes.get(component["name"], 1.0)
    centre = np.array(component["centre"], float)
    turn = np.eye(3) if pose is None else pose
    if component["shape"] == "box":
        return _box(centre, size / 2, turn, bsdf)
    return _box(centre, np.r_[size / 2, 1.0], turn, bsdf, "rectangle")
