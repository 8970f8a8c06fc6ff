"""The light curve of the paper's object against its eqs. 1-11, written out a second time."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import torchlc
from tests.test_model import rows

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "paper"))

import setting

C_SUN = 455.0


def facet_irradiance(n, u, v, area, sun, obs, range_m, material):
    """Eqs. 2-6, 8 and 9 for one facet and one epoch, in floats, term by term as printed."""
    n_u, n_v = material.get("n_u", material.get("n")), material.get("n_v", material.get("n"))
    r_spec, r_diff = material["r_spec"], material["r_diff"]
    if n @ sun <= 0 or n @ obs <= 0:
        return 0.0
    h = (sun + obs) / np.linalg.norm(sun + obs)
    z = n_u if n_u == n_v else (n_u * (h @ u) ** 2 + n_v * (h @ v) ** 2) / (1 - (h @ n) ** 2)
    fresnel = r_spec + (1 - r_spec) * (1 - sun @ h) ** 5
    lobe = np.sqrt((n_u + 1) * (n_v + 1)) / (8 * np.pi) * (n @ h) ** z
    f_spec = lobe / ((h @ sun) * max(n @ sun, n @ obs)) * fresnel
    bend = (1 - (1 - n @ sun / 2) ** 5) * (1 - (1 - n @ obs / 2) ** 5)
    f_diff = 28 * r_diff / (23 * np.pi) * (1 - r_spec) * bend
    f_sun = C_SUN * (f_spec + f_diff) * (n @ sun)
    return f_sun * area * (n @ obs) / range_m**2


def unit(vector):
    return vector / np.linalg.norm(vector)


def body_frame(mode, position, velocity, sun, x_angle=0.0, spin_axis=None, turn=0.0):
    """Columns body X, Y, Z in the inertial frame; FORMATS, attitude modes."""
    pole = np.array([0.0, 0.0, 1.0])
    if mode == "nadir":
        z = -unit(position)
        x = unit(velocity - (velocity @ z) * z)
    elif mode == "yaw-steering":
        z = -unit(position)
        x = np.cross(unit(np.cross(z, sun)), z)
    elif mode == "sun":
        z = sun
        x = unit(np.cross(pole, z))
    else:
        z = pole
        x = np.array([np.cos(x_angle), np.sin(x_angle), 0.0])
    rotation = np.stack([x, np.cross(z, x), z], -1)
    if spin_axis is not None:  # Rodrigues' formula, vector by vector
        k = np.asarray(spin_axis, float) / np.linalg.norm(spin_axis)
        turned = [
            np.cos(turn) * e + np.sin(turn) * np.cross(k, e) + (1 - np.cos(turn)) * (k @ e) * k
            for e in np.eye(3)
        ]
        rotation = rotation @ np.stack(turned, -1)
    return rotation


def box_faces(size, material):
    """(normal, u, v, area, material) of the six faces: u is the next body axis cyclically, v = n x u."""
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            n, u = sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
            faces.append((n, u, np.cross(n, u), size[(axis + 1) % 3] * size[(axis + 2) % 3], material))
    return faces


def wing_faces(area, axis, sun_body, material, back):
    """A plate that turns about ``axis`` until its front normal, u x axis, is nearest to the Sun."""
    n = unit(sun_body - (sun_body @ axis) * axis)
    u = np.cross(axis, n)
    return [(n, u, axis, area, material), (-n, u, -axis, area, back)]


def paper_curve(scene, recording, materials, size, wing_area=0.0, mode="nadir", **attitude):
    """Eqs. 7 and 10 with positions taken from torchlc's track and nothing else: W/m2 (T,)."""
    state = torchlc.LightCurve(scene, recording).assembly.track.at(0.0, 0.0, 0.0)
    rate, axis = attitude.pop("rate", 0.0), attitude.pop("spin_axis", None)
    found = []
    for k, t in enumerate(state.time.numpy()):
        turn = 2 * np.pi * rate * t / 3600.0
        sun, obs = unit(state.sun[k].numpy()), unit(state.observer[k].numpy())
        frame = body_frame(
            mode,
            state.position[k].numpy(),
            state.velocity[k].numpy(),
            sun,
            spin_axis=axis,
            turn=turn,
            **attitude,
        )
        faces = box_faces(size, materials["body"])
        if wing_area:
            panel = materials["panel"]
            faces += 2 * wing_faces(wing_area, np.array([0, 1.0, 0]), frame.T @ sun, panel, panel)
        range_m = 1e3 * np.linalg.norm(state.observer[k].numpy())
        total = sum(
            facet_irradiance(frame @ n, frame @ u, frame @ v, area, sun, obs, range_m, material)
            for n, u, v, area, material in faces
        )
        found.append(total)
    return np.array(found)


def agree(scene, recording, irradiance):
    """Flux to 1e-10, and the magnitude of eq. 11 where there is light.

    A face that the Sun grazes to the last bit (+-Y when steering in yaw) may hold light of 1e-48.
    """
    curve = torchlc.simulate(scene, recording)
    np.testing.assert_allclose(curve.flux, irradiance / C_SUN, rtol=1e-10, atol=1e-40)
    lit = irradiance > 0
    np.testing.assert_allclose(
        curve.mag[lit], -26.7 - 2.5 * np.log10(irradiance[lit] / C_SUN), rtol=0, atol=1e-10
    )
    assert lit.any()


@pytest.mark.parametrize("table", [1, 2], ids=["object 1", "object 2"])
def test_box_wings_of_the_paper_against_the_equations(table):
    scene = setting.object_1() if table == 1 else setting.object_2()
    start = "2020-10-17T14:00:00" if table == 1 else "2020-10-11T00:00:00"
    recording = rows(scene, start)
    size = setting.BOX_OBJECT_1 if table == 1 else (2.0, 2.0, 2.0)
    area, mode = (setting.AREA_WING_1, "nadir") if table == 1 else (setting.AREA_WING_2, "yaw-steering")
    expected = paper_curve(scene, recording, setting.TABLE_3[table], size, area, mode)
    agree(scene, recording, expected)


@pytest.mark.parametrize("attitude", [1, 2, 3, 4])
def test_cube_in_every_attitude_against_the_equations(attitude):
    scene = setting.cube(attitude=attitude)
    recording = rows(scene, "2020-10-10T12:00:00", 8.0)
    options = {
        1: {"mode": "nadir", "spin_axis": [0, 1, 0], "rate": 1.0},
        2: {"mode": "inertial", "x_angle": np.deg2rad(30.0)},
        3: {"mode": "sun", "spin_axis": [0, 0, 1], "rate": 1.0},
        4: {"mode": "nadir"},
    }[attitude]
    materials = {"body": {"n": 12_000.0, "r_spec": 0.8, "r_diff": 0.2}}
    expected = paper_curve(scene, recording, materials, (4.0, 4.0, 4.0), **options)
    agree(scene, recording, expected)


@pytest.mark.parametrize("seed", range(6))
def test_random_anisotropic_box_wings_against_the_equations(seed):
    """Lobes of n_u and n_v apart, broad enough to be seen from every side."""
    rng = np.random.default_rng(seed)

    def material():
        n_u, n_v = 10 ** rng.uniform(0, 3, 2)
        r_spec = rng.uniform(0, 1)
        return {"n_u": n_u, "n_v": n_v, "r_spec": r_spec, "r_diff": rng.uniform(0, 1 - r_spec)}

    materials = {"body": material(), "panel": material()}
    scene = setting.object_1(materials)
    recording = rows(scene, "2020-10-16T00:00:00", 24.0, 900.0)
    expected = paper_curve(scene, recording, materials, setting.BOX_OBJECT_1, setting.AREA_WING_1)
    agree(scene, recording, expected)


def test_range_and_area_scale_as_they_must():
    """Twice the edges: 4 times the light, 1.505 mag."""
    small = setting.object_1()
    large = setting.object_1()
    parts = [
        part.model_copy(update={"size": tuple(2 * one for one in part.size)}) for part in large.components
    ]
    large = large.model_copy(update={"components": parts})
    recording = rows(small)
    gain = torchlc.simulate(small, recording).mag - torchlc.simulate(large, recording).mag
    np.testing.assert_allclose(gain, 2.5 * np.log10(4.0), rtol=1e-12)
