"""A body on a turntable, traced by rays that share nothing with torchlc, and what a diagnosis left alone says of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import torchlc
from tests.rays import blocked
from tests.test_mesh_files import OUTLINES, obj
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Workbench
from torchlc.diagnosis.probes import rescored
from torchlc.diagnosis.run import diagnose

TURN_S, CAMERA_KM, LAMP_KM = 3600.0, 0.3, 1.5e8
AZIMUTHS = (45.0, 90.0, 130.0, 230.0, 290.0)
ROWS, NOISE = 20, 0.01
RADIUS = np.sqrt(1.5**2 + 1.5**2 + 0.5**2)
"""Of the sphere about the body's origin that holds it."""
PER_SIDE = 6
"""Points along each side of a rectangle: shadows' edges fall in one of 36 cells, 0.5 % of the light of the body."""
START = np.datetime64("2026-01-01T00:00:00", "ms")


def rectangles() -> tuple[np.ndarray, np.ndarray]:
    """Corners (N, 4, 3) of rectangles that cover a C-shaped prism outwards, and the triangles (M, 3, 3) in their way."""
    outline = np.array(OUTLINES["C"], dtype=float) - [1.5, 1.5]
    walls = [
        [(*a, -0.5), (*b, -0.5), (*b, 0.5), (*a, 0.5)]
        for a, b in zip(outline, np.roll(outline, -1, 0), strict=True)
    ]
    caps = []
    for x0, x1, y0, y1 in ((-1.5, -0.5, -1.5, 1.5), (-0.5, 1.5, -1.5, -0.5), (-0.5, 1.5, 0.5, 1.5)):
        caps.append([(x0, y0, 0.5), (x1, y0, 0.5), (x1, y1, 0.5), (x0, y1, 0.5)])
        caps.append([(x0, y0, -0.5), (x0, y1, -0.5), (x1, y1, -0.5), (x1, y0, -0.5)])
    faces = np.array([*walls, *caps])
    return faces, np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


@dataclass(frozen=True)
class Bench:
    """What a laboratory does that its published geometry does not say: ``power`` of the radiance that is recorded, the angle, deg,
    by which each curve begins late, and how ``near`` the camera is, in half diagonals of the body over its distance. ``effects`` are
    those of the scene that is given."""

    power: float = 1.0
    late_deg: tuple[float, ...] = (0.0,) * len(AZIMUTHS)
    near: float = 0.0
    effects: str = '"self_shadowing"'

    def recording(self, folder: Path) -> tuple[torchlc.Scene, torchlc.Recording]:
        faces, obstacles = rectangles()
        step = (np.arange(PER_SIDE) + 0.5) / PER_SIDE
        a, b = (one.ravel()[:, None] for one in np.meshgrid(step, step))
        rng = np.random.default_rng(4)
        lines = ["time,flux,flux_err,curve,sun_x,sun_y,sun_z,obs_x,obs_y,obs_z"]
        to_lamp = np.array([-1.0, 0, 0])
        for azimuth, late in zip(AZIMUTHS, self.late_deg, strict=True):
            around, up = np.radians(180 + azimuth), np.radians(20.0)
            to_camera = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
            light = []
            for angle in np.arange(ROWS) * 360 / ROWS:
                turn = np.radians(angle + late)
                back = np.array(
                    [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
                )
                lamp, camera = back @ to_lamp, back @ to_camera
                total = 0.0
                for corner in faces:
                    u, v = corner[1] - corner[0], corner[3] - corner[0]
                    normal = np.cross(u, v)
                    area = np.linalg.norm(normal)
                    points = corner[0] + a * u + b * v + 1e-6 * normal
                    to_eye = camera - self.near / RADIUS * points
                    distance = np.linalg.norm(to_eye, axis=1)
                    to_eye = to_eye / distance[:, None]
                    cosines = normal @ lamp / area, to_eye @ normal / area
                    if cosines[0] <= 0 or cosines[1].max() <= 0:
                        continue
                    clear = ~blocked(points, lamp, obstacles) & ~blocked(points, to_eye, obstacles)
                    seen = clear * cosines[1].clip(min=0) / distance**2
                    total += area * cosines[0] ** self.power * seen.mean()
                light.append(total)
            flux = np.array(light) / np.mean(light) + NOISE * rng.normal(size=ROWS)
            for k, value in enumerate(flux):
                time = START + np.timedelta64(round(1000 * TURN_S * k / ROWS), "ms")
                place = ",".join(f"{one:.9f}" for one in (*LAMP_KM * to_lamp, *CAMERA_KM * to_camera))
                lines.append(f"{time},{value:.6f},{NOISE},az{azimuth:.0f},{place}")
        (folder / "rows.csv").write_text("\n".join(lines) + "\n")
        outline = np.array(OUTLINES["C"], dtype=float) - [1.5, 1.5]
        many = len(outline)
        corners = [(*point, z) for z in (-0.5, 0.5) for point in outline]
        walls = [(k + 1, (k + 1) % many + 1, (k + 1) % many + many + 1, k + many + 1) for k in range(many)]
        caps = [tuple(range(many, 0, -1)), tuple(range(many + 1, 2 * many + 1))]
        (folder / "body.obj").write_text(obj(corners, [*caps, *walls]))
        scene = torchlc.Scene.from_toml(
            'format = "torchlc-scene/1"\nname = "body"\n[orbit]\nvectors = "icrs"\n[attitude]\nmode = "inertial"\n'
            f'x_angle = 0.0\nspin_axis = [0, 0, 1]\nspin_rate = {3600 / TURN_S}\nspin_epoch = "{START}"\n'
            '[[components]]\nname = "body"\nshape = "mesh"\nfile = "body.obj"\ncentre = [0, 0, 0]\nmaterial = "white"\n'
            '[materials.white]\nmodel = "lambert"\nalbedo = 0.8\n[model]\n'
            f"effects = [{self.effects}]\n",
            folder,
            "body",
        )
        return torchlc.load(scene, folder / "rows.csv")


@pytest.fixture
def one_late(tmp_path) -> tuple[torchlc.Scene, torchlc.Recording]:
    return Bench(late_deg=(0.0, 0.0, -60.0, 0.0, 0.0)).recording(tmp_path)


def test_a_curve_that_begins_elsewhere_is_found_with_its_angle(one_late):
    """60 deg are farther than any descent from 0 comes; the scene's own turn is the others'."""
    bench = Workbench(*one_late)
    bench.entries = bench.candidates(None)
    search = Search(bench, Clock(None), 0)
    search.null()
    at = search.visited[search.best().hypothesis.under(*search.robust)]
    entry = "start_phase@curve"
    known = search.probe_all(at, [entry])[entry]
    found = search.extend(at, entry, known)
    values = dict(zip(found.names, found.theta.tolist(), strict=True))
    late = [values[f"start_phase.deg[az{azimuth:.0f}]"] for azimuth in AZIMUTHS]
    assert late == pytest.approx(
        [0.0, 0.0, -60.0, 0.0, 0.0], abs=1.0
    )  # edges of shadows fall in cells of 3 deg
    assert (
        search.log_odds(found.hypothesis) > search.log_odds(at.hypothesis) + 50.0
    )  # 20 rows, no outliers any more
    # the same changes of the light promise no less beside the scene's own model, and no more than noise beside what holds them
    before = rescored(known, at, at).together
    assert before >= known.together > 0
    assert rescored(known, at, found).together < len(AZIMUTHS) < 0.5 * before


def test_every_member_for_laboratories_is_asked(one_late):
    """None needs to be told, and an offset of two numbers a curve is probed as one of one is."""
    bench = Workbench(*one_late)
    bench.entries = bench.candidates(None)
    members = {
        "near_field", "radiance_power", "radiance_threshold", "radiance_pedestal", "convex_hull[body]",
        "camera_direction@curve", "start_phase@curve", "camera_direction", "start_phase",
    }  # fmt: skip
    assert members <= set(bench.entries)
    search = Search(bench, Clock(None), 0)
    search.null()
    probes = search.probe_all(search.best(), ["camera_direction@curve", "start_phase@curve"])
    assert probes["camera_direction@curve"].visible
    begin = probes["start_phase@curve"].begin
    assert begin is not None
    assert begin.tolist() == pytest.approx([0.0, 0.0, -60.0, 0.0, 0.0], abs=7.5)  # half a step of the 24


def test_the_size_that_suits_an_effect_is_the_least_squares_of_its_change_and_all_that_is_free(tmp_path):
    """By NumPy, of the probed value that promises most: change and tangent together."""
    scene, recording = Bench(power=0.5).recording(tmp_path)
    bench = Workbench(scene, recording)
    bench.entries = bench.candidates(None)
    search = Search(bench, Clock(None), 0)
    search.null()
    at = search.extend(search.visited[search.best().hypothesis.under(*search.robust)], "near_field", None)
    found = search.probe_all(at, ["radiance_power"])["radiance_power"]
    best = int(found.scores.argmax())
    moved = found.moved[best].numpy()
    tangent = at.tangent.numpy()
    padded = np.concatenate([moved, np.zeros(len(tangent) - len(moved))])
    residual = np.concatenate([(at.delta / at.sigma).numpy(), at.g.numpy()])
    size = np.linalg.lstsq(np.column_stack([padded, tangent]), residual, rcond=None)[0][0]
    assert found.best_size(at) == pytest.approx(size, rel=1e-6)
    np.testing.assert_allclose((found.best_change(at) / at.sigma).numpy(), moved, rtol=1e-12)


@pytest.mark.long
def test_pixels_that_record_a_power_are_named(tmp_path):
    """Among what a detector does, and a camera that stands near."""
    among = [
        "radiance_power",
        "radiance_threshold",
        "radiance_pedestal",
        "near_field",
        "saturation",
        "background",
    ]
    found = diagnose(*Bench(power=0.5).recording(tmp_path), effects=among)
    assert found.named == ("radiance_power",)
    values = dict(zip(found.final.names, found.final.theta.tolist(), strict=True))
    assert values["radiance_power.power"] == pytest.approx(
        0.5, abs=0.05
    )  # shadows' edges are 0.5 % of the light


@pytest.mark.long
def test_four_causes_are_named_and_none_that_is_not_there(tmp_path):
    """Shadows, a near camera, a power of the radiance and one curve that begins elsewhere, none of which the scene has; a threshold, a
    pedestal, a hull and light from all around are not in the recording."""
    bench = Bench(power=0.5, near=0.15, late_deg=(0.0, 0.0, -60.0, 0.0, 0.0), effects="")
    among = [
        "self_shadowing", "near_field", "radiance_power", "radiance_threshold", "radiance_pedestal", "start_phase",
        "convex_hull", "background",
    ]  # fmt: skip
    found = diagnose(*bench.recording(tmp_path), effects=among)
    assert set(found.named) == {"self_shadowing", "near_field", "radiance_power", "start_phase"}
    values = dict(zip(found.final.names, found.final.theta.tolist(), strict=True))
    # shadows' edges fall in cells of 3 deg, and those of torchlc are of a camera far away: off by up to 0.15
    assert values["radiance_power.power"] == pytest.approx(0.5, abs=0.1)
    assert values["near_field.camera"] == pytest.approx(0.15, abs=0.05)
    assert values["start_phase.deg[az130]"] == pytest.approx(-60.0, abs=2.0)
