"""A cone about the angular momentum is what Euler's equations say of a body of revolution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.effects.cases import seen_from, tilted, unit
from tests.effects.turning import INERTIAL, PERIOD_S, SPIN_POLE, rotations, turning
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve


def integrated(
    start: np.ndarray, momentum: np.ndarray, moments: np.ndarray, seconds: np.ndarray
) -> np.ndarray:
    """Rotations (T, 3, 3), body to space, of a free body: dR/dt = R [w]x with w = I^-1 R^T L."""

    def rate(_, flat):
        rotation = flat.reshape(3, 3)
        x, y, z = (rotation.T @ momentum) / moments
        return (rotation @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])).ravel()

    done = solve_ivp(
        rate, (0, seconds[-1]), start.ravel(), t_eval=seconds, rtol=1e-11, atol=1e-12, method="DOP853"
    )
    return done.y.T.reshape(-1, 3, 3)


@pytest.mark.parametrize("across", [0.6, 3.0])
@pytest.mark.parametrize("cone", [2.0, 25.0])
def test_euler_s_equations_of_a_body_of_revolution(tmp_path, cone, across):
    """A flat body (moment across the axis 0.6 of that about it) and a long one."""
    scene = turning(SPIN_POLE)
    recording = seen_from(scene, tmp_path, *np.repeat([[[1.0, 0, 0]], [[0, 1.0, 0]]], 120, 1))
    # Landau and Lifshitz, 33.4 and 33.5: precession L/A about L, turns of the body about its axis on top of it
    precession_plus_spin = 2 * np.pi / PERIOD_S
    share = np.cos(np.radians(cone)) * (1 - 1 / across)
    momentum = precession_plus_spin / (1 / across + share)
    in_the_body = -momentum * share
    found = rotations(
        scene, recording, "nutation", nutation__deg=cone, nutation__phase_deg=70.0,
        nutation__rev_per_hour=in_the_body / (2 * np.pi) * 3600,
    )  # fmt: skip
    along = tilted(90.0 - 25.0, 40.0)
    np.testing.assert_allclose(found[:, :, 2] @ along, np.cos(np.radians(cone)), atol=1e-12)
    expected = integrated(found[0], momentum * along, np.array([across, across, 1.0]), recording.seconds)
    np.testing.assert_allclose(found, expected, atol=1e-8)  # six turns of the integrator


def test_a_spin_about_a_slanting_direction_of_the_body_cones_about_it(tmp_path):
    scene = turning(INERTIAL)
    recording = seen_from(scene, tmp_path, *np.repeat([[[1.0, 0, 0]], [[0, 1.0, 0]]], 120, 1))
    axis = unit([0.3, 0.8, 0.5])
    steady, coning = (
        rotations(scene, recording),
        rotations(
            scene,
            recording,
            "nutation",
            nutation__deg=7.0,
            nutation__rev_per_hour=40.0,
            nutation__phase_deg=0.0,
        ),
    )
    momentum = (steady @ axis)[0]
    np.testing.assert_allclose((coning @ axis) @ momentum, np.cos(np.radians(7.0)), atol=1e-12)
    inside = np.einsum(
        "tji,j->ti", coning, momentum
    )  # in the body the momentum goes round the axis at the rate given
    flat = inside - (inside @ axis)[:, None] * axis
    turn = np.unwrap(np.arctan2(np.cross(flat[0], flat) @ axis, flat @ flat[0]))
    np.testing.assert_allclose(turn, 2 * np.pi * 40.0 * recording.seconds / 3600, atol=1e-9)


def test_which_attitudes_can_cone(tmp_path):
    def why(attitude: str) -> str | None:
        scene = turning(attitude)
        rows = seen_from(scene, tmp_path, [[1.0, 0, 0]] * 2, [[0, 1.0, 0]] * 2)
        return registry()["nutation"]().missing(LightCurve(scene, rows, effects=[]).assembly.context)

    assert why(SPIN_POLE) is None and why(INERTIAL) is None
    assert why('mode = "inertial"\nx_angle = 0.0\n') == "the attitude has no spin"
