"""Torque-free rotation against Euler's equations integrated by SciPy, limits with closed forms, and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from torchlc.geometry.rotation.rigid_body import FreeRotation, free_rotation, frequencies

STATES = {
    "short-axis mode": ([0.48, 0.82, 1.0], 20.0),
    "long-axis mode": ([0.48, 0.82, 1.0], 70.0),
    "axes in another order": ([0.82, 1.0, 0.48], 35.0),
    "left-handed order": ([1.0, 0.6, 0.8], 10.0),
    "oblate": ([0.6, 0.6, 1.0], 30.0),
    "prolate": ([0.3, 1.0, 1.0], 40.0),
    "about the short axis": ([0.5, 0.9, 1.0], 0.0),
    "about the long axis": ([0.5, 0.9, 1.0], 90.0),
    "near the short axis": ([0.7, 0.9, 1.0], 1e-4),
}


def scalar(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def rotation(elapsed: Tensor, moments: list[float], nutation_deg: float, period: float = 100.0) -> Tensor:
    return free_rotation(
        elapsed,
        torch.tensor(moments, dtype=torch.float64),
        scalar(math.radians(nutation_deg)),
        scalar(period),
        scalar(0.3),
        scalar(0.17),
    )


def state(moments: list[float], nutation_deg: float, period: float = 100.0) -> FreeRotation:
    angle = torch.tensor(math.radians(nutation_deg), dtype=torch.float64)
    return frequencies(torch.tensor(moments, dtype=torch.float64), angle, torch.full_like(angle, period))


def integrated(
    moments: np.ndarray, start: np.ndarray, angular_momentum: float, times: np.ndarray
) -> np.ndarray:
    """Body-to-space rotations (T, 3, 3) by Euler's equations and those of the matrix, DOP853 at 1e-13."""
    rate = start.T @ np.array([0.0, 0.0, angular_momentum]) / moments

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        turned, w = y[:9].reshape(3, 3), y[9:]
        cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(turned @ cross).ravel(), -np.cross(w, moments * w) / moments])

    begin = np.concatenate([start.ravel(), rate])
    found = solve_ivp(slope, (0, times[-1]), begin, t_eval=times, method="DOP853", rtol=1e-13, atol=1e-13)
    return found.y[:9].T.reshape(-1, 3, 3)


@pytest.mark.parametrize("name", STATES)
def test_it_is_what_eulers_equations_integrate_to(name: str) -> None:
    """Fifty turns; the integrator itself is good to 1e-10 over these."""
    moments, nutation = STATES[name]
    times = torch.linspace(0, 5000.0, 200, dtype=torch.float64)
    ours = rotation(times, moments, nutation).numpy()
    slope = torch.func.jacfwd(lambda t: rotation(t, moments, nutation)[0])(
        torch.zeros(1, dtype=torch.float64)
    )
    turn = ours[0].T @ slope[..., 0].numpy()
    rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
    momentum = float(np.linalg.norm(np.array(moments) * rate))
    np.testing.assert_allclose(ours[0] @ (np.array(moments) * rate), [0, 0, momentum], atol=1e-12)
    np.testing.assert_allclose(
        integrated(np.array(moments), ours[0], momentum, times.numpy()), ours, atol=1e-8
    )


def test_a_thousand_turns_keep_their_phase() -> None:
    """The attitude after whole periods of the way of L round the body is that of the start turned about L by the mean
    rate, to 1e-8 rad: nothing accumulates."""
    moments, nutation = STATES["short-axis mode"]
    rates = state(moments, nutation)
    ways = torch.arange(0, 600, dtype=torch.float64)  # over 1,600 turns of the long axis
    times = ways / rates.polhode
    ours = rotation(times, moments, nutation)
    angle = (2 * math.pi * rates.precession_long * times).numpy()
    turns = np.stack([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    expected = np.tile(np.eye(3), (600, 1, 1))
    expected[:, :2, :2] = turns
    assert float(times[-1]) > 1000 * 100
    np.testing.assert_allclose(ours.numpy(), expected @ ours[0].numpy(), atol=1e-8)


def test_turning_about_the_short_axis_is_uniform_spin() -> None:
    times = torch.linspace(0, 1e5, 50, dtype=torch.float64)
    ours = rotation(times, [0.5, 0.9, 1.0], 0.0)
    angle = 2 * math.pi * (0.3 + times / 100.0)
    torch.testing.assert_close(ours[:, 0, 0], torch.cos(angle), rtol=0, atol=1e-9)
    torch.testing.assert_close(ours[:, 1, 0], torch.sin(angle), rtol=0, atol=1e-9)
    torch.testing.assert_close(ours[:, 2, 2], torch.ones(50, dtype=torch.float64), rtol=0, atol=1e-14)


@pytest.mark.parametrize("transverse", [0.6, 1.7])
def test_a_symmetric_top_precesses_as_textbooks_say(transverse: float) -> None:
    """Moments (A, A, C): L / A about L, and (1 - A / C) cos(angle) L / A round the body (Landau & Lifshitz 33, 36)."""
    axis_angle = math.radians(25.0)
    long_symmetry = transverse > 1  # the symmetry axis has the smallest moment
    nutation = 90.0 - 25.0 if long_symmetry else 25.0
    rates = state([transverse, transverse, 1.0], nutation)
    precession = rates.precession_long if long_symmetry else rates.precession_short
    round_body = abs(1 - transverse) * math.cos(axis_angle) * float(precession)
    assert float(rates.polhode) == pytest.approx(round_body, rel=1e-12)


def test_gradients_of_every_number_are_those_of_finite_differences() -> None:
    """At a state of each mode; steps of 1e-6 leave 1e-9 of truncation and 1e-9 of round-off."""
    times = torch.linspace(3.0, 900.0, 7, dtype=torch.float64)
    weight = torch.linspace(-1, 1, 63, dtype=torch.float64).reshape(7, 3, 3)
    for nutation in (0.4, 1.2):
        start = torch.tensor([0.5, 0.83, 1.0, nutation, 97.0, 0.2, 0.6], dtype=torch.float64)

        def total(x: Tensor) -> Tensor:
            return (free_rotation(times, x[:3], x[3:4], x[4:5], x[5:6], x[6:7]) * weight).sum()

        ours = torch.func.grad(total)(start)
        for k in range(7):
            step = torch.zeros(7, dtype=torch.float64)
            step[k] = 1e-6 * float(start[k])
            slope = (total(start + step) - total(start - step)) / (2 * step[k])
            assert float(ours[k]) == pytest.approx(float(slope), rel=1e-6, abs=1e-6)


def test_a_batch_is_its_members() -> None:
    times = torch.linspace(0.0, 900.0, 5, dtype=torch.float64)
    moments = torch.tensor([[0.5, 0.83, 1.0], [0.9, 0.4, 1.0]], dtype=torch.float64)
    nutation = torch.tensor([[0.4], [1.2]], dtype=torch.float64)
    rest = (torch.tensor([[97.0], [55.0]], dtype=torch.float64), scalar(0.2), scalar(0.6))
    both = free_rotation(times, moments, nutation, *rest)
    for k in range(2):
        alone = free_rotation(times, moments[k], nutation[k], rest[0][k], *rest[1:])
        torch.testing.assert_close(both[k], alone, rtol=0, atol=1e-12)
    mapped = torch.vmap(lambda a, b, c: free_rotation(times, a, b, c, *rest[1:]))(moments, nutation, rest[0])
    torch.testing.assert_close(mapped, both, rtol=0, atol=1e-12)
