"""Whether anything is missing: tests of residuals against draws, and tails against their closed forms."""

from __future__ import annotations

import math

import numpy as np
import torch

from tests.noisy_rows import changed
from torchlc.diagnosis.gate import Battery, gate, log_tail, runs


def test_gate_is_uniform_when_nothing_is_missing(demo_refit) -> None:
    """Residuals drawn off the baseline's tangent: p-values uniform by Kolmogorov and Smirnov at 1 %."""
    refit = demo_refit
    context = refit.model.assembly.context
    battery = Battery(context.seconds, context.curve, {"time": context.seconds}, {}, True)
    generator = torch.Generator().manual_seed(1)
    q = torch.linalg.qr(refit.slopes / refit.sigma[:, None])[0]
    found = []
    for number in range(60):
        z = torch.randn(len(refit.delta), generator=generator, dtype=torch.float64)
        z = z - q @ (q.T @ z)
        found.append(gate(changed(refit, z), battery, seed=number, draws=400).global_p)
    ordered = np.sort(found)
    steps = np.arange(1, 61) / 60
    distance = max(np.abs(ordered - steps).max(), np.abs(ordered - steps + 1 / 60).max())
    assert distance < 1.63 / math.sqrt(60)


def test_gate_sees_a_short_dip_that_chi_square_does_not(demo_refit) -> None:
    refit = demo_refit
    context = refit.model.assembly.context
    battery = Battery(context.seconds, context.curve, {}, {}, True)
    generator = torch.Generator().manual_seed(4)
    z = torch.randn(len(refit.delta), generator=generator, dtype=torch.float64)
    quiet = gate(changed(refit, z), battery)
    dipped = z.clone()
    dipped[100:112] += 1.5
    loud = gate(changed(refit, dipped), battery)
    assert loud.marginal["chi2"] > 0.001
    assert loud.global_p < 0.01 < quiet.global_p
    assert any(a <= 112 and b >= 100 for a, b, _ in loud.windows)


def test_tail_of_exponential_draws_is_the_exponential() -> None:
    draws = torch.sort(
        torch.distributions.Exponential(torch.tensor(1.0, dtype=torch.float64)).sample((40000,))
    ).values
    value = torch.tensor([0.5, 2.0, 8.0, 20.0], dtype=torch.float64)
    assert torch.allclose(log_tail(draws, value), -value, rtol=0.08, atol=0.02)


def test_runs_of_a_mask() -> None:
    assert runs(torch.tensor([1, 1, 0, 0, 1, 0, 1], dtype=torch.bool)) == [(0, 1), (4, 4), (6, 6)]
    assert runs(torch.zeros(3, dtype=torch.bool)) == []
