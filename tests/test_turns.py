"""Swings and jumps of the attitude that are sought by least squares, against ones put into light made up here."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchlc.diagnosis.attitude_search import Target, jumps, swings

ROWS = 240
MINUTES = torch.linspace(0.0, 300.0, ROWS, dtype=torch.float64)


def slopes(seed: int) -> torch.Tensor:
    """Change of light per deg about three axes, (3, T): sums of slow waves."""
    random = np.random.default_rng(seed)
    x = np.linspace(0, 1, ROWS)
    waves = [random.normal() * np.sin(2 * np.pi * k * x + random.uniform(0, 6)) for k in (0.5, 1, 1.7, 2.3)]
    return torch.tensor(np.stack([np.roll(sum(waves), 37 * k) * (1 + 0.3 * k) for k in range(3)])) * 8


def axis_of(lon: float, lat: float) -> np.ndarray:
    lon, lat = np.radians([lon, lat])
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def swung(psi: torch.Tensor, along: torch.Tensor) -> torch.Tensor:
    rows = []
    for deg, period, phase, lon, lat in psi.tolist():
        wave = np.sin(2 * np.pi * MINUTES.numpy() / period + np.radians(phase))
        rows.append(deg * wave * (axis_of(lon, lat) @ along.numpy()))
    return torch.tensor(np.stack(rows))


def absorbed(seed: int) -> torch.Tensor:
    """An orthonormal basis (T + 2, 4) of what a refit with two prior rows takes up."""
    random = np.random.default_rng(seed)
    return torch.tensor(np.linalg.qr(random.normal(size=(ROWS + 2, 4)))[0])


def residual_of(light: torch.Tensor, basis: torch.Tensor, seed: int) -> torch.Tensor:
    noise = torch.tensor(np.random.default_rng(seed).normal(size=ROWS))
    whole = torch.cat([light + noise, torch.zeros(2, dtype=light.dtype)])
    return whole - basis @ (basis.T @ whole)


@pytest.mark.parametrize(
    "truth",
    [(0.6, 41.0, 177.0, 87.0, -4.0), (0.4, 7.3, 20.0, -30.0, 50.0), (1.2, 150.0, 300.0, 120.0, -70.0)],
)
def test_a_swing_is_found_among_noise(truth) -> None:
    along, basis = slopes(1), absorbed(2)
    light = swung(torch.tensor([truth], dtype=torch.float64), along)[0]
    target = Target(residual_of(light, basis, 3), basis, lambda psi: swung(psi, along))
    found = swings(target, MINUTES, 1.25, (1.0, 720.0), 5)
    deg, period, _, lon, lat = found[0].tolist()
    assert period == pytest.approx(truth[1], rel=truth[1] / 300.0 / 3)
    # a descent starts from here: its slope is right within half of the swing
    assert deg == pytest.approx(truth[0], rel=0.25)
    assert abs(axis_of(lon, lat) @ axis_of(truth[3], truth[4])) > 0.9
    again = swung(found[:1], along)[0]
    assert float(((light - again) ** 2).sum()) < 0.1 * float((light**2).sum()), "its phase is right as well"
    assert bool(((found[:, 3] >= -45) & (found[:, 3] <= 135)).all())


def test_a_jump_is_found_among_noise() -> None:
    along, basis = slopes(4), absorbed(5)
    hours = MINUTES / 60
    truth = torch.tensor([0.5, -0.8, 0.3], dtype=torch.float64)

    def jumped(psi: torch.Tensor) -> torch.Tensor:
        return (psi[:, :3] @ along) * (hours > psi[:, 3:])

    light = jumped(torch.tensor([[*truth.tolist(), 3.11]], dtype=torch.float64))[0]
    target = Target(residual_of(light, basis, 6), basis, jumped)
    instants = 0.5 * (hours[1:] + hours[:-1])
    found = jumps(target, hours, instants, 0.2, 4)
    assert abs(float(found[0, 3]) - 3.11) < 2 * float(hours[1])
    torch.testing.assert_close(found[0, :3], truth, atol=0.15, rtol=0)
    gaps = (found[:, None, 3] - found[None, :, 3]).abs() + torch.eye(len(found))
    assert float(gaps.min()) > 0.2


def test_nothing_is_sought_within_no_time() -> None:
    """All rows at one instant, or a range of periods that the cadence leaves empty."""
    target = Target(
        torch.ones(3, dtype=torch.float64), torch.zeros(3, 0, dtype=torch.float64), lambda psi: psi
    )
    none = swings(target, torch.zeros(3, dtype=torch.float64), 1.0, (1.0, 720.0), 5)
    assert none.shape == (0, 5)
    coarse = swings(target, torch.arange(3, dtype=torch.float64) * 400, 400.0, (1.0, 720.0), 5)
    assert coarse.shape == (0, 5)
