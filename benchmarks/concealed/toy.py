"""An additive toy, in which distortion-driven tests are at home, and what torchlc's statistics make of it at equal false alarms:

    python -m benchmarks.concealed.toy [FILE]

As in the first example of Anau Montel, Alvey & Weniger (2025): bins with unit normal noise about a smooth curve of a few free
parameters, distorted by an additive pattern of random place and width. Here the curve is linear in three parameters, so that
every method's answer is exact. All are given the same patterns. Compared are the paper's largest t_i and sum of t_i; torchlc's
battery (the smallest p-value of its statistics, signatures among them); and its odds, which for patterns of normal amplitude
are the mean over the patterns of exp(a^2 t / (2 (1 + a^2)) ) / sqrt(1 + a^2).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.concealed.case import Array
from benchmarks.concealed.distortions import bumps
from benchmarks.concealed.methods.distortion_snr import statistics, trained
from torchlc.diagnosis.gate import Battery, log_tail

BINS, DRAWS, TRIALS = 100, 4000, 4000
STRENGTHS = (2.0, 3.0, 4.0, 5.0)
"""Signal to noise of the distortions, off what the curve can take up."""
ALARMS = (0.01, 0.05)
AMPLITUDE = 5.0
"""Standard deviation of a pattern's amplitude in the odds, in standard errors: that of the training of the other method."""


def compared(seed: int) -> dict[str, Any]:
    """Share of distorted draws that each statistic calls at each false-alarm rate, by strength."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-1, 1, BINS)
    curve = np.linalg.qr(np.stack([np.ones(BINS), x, np.exp(-0.5 * (x / 0.3) ** 2)], 1))[0]

    def left(rows: Array) -> Array:
        return rows - (rows @ curve) @ curve.T

    patterns = left(bumps(BINS, np.arange(BINS)))
    patterns /= np.linalg.norm(patterns, axis=1, keepdims=True)
    weights = trained(patterns, left(rng.standard_normal((DRAWS, BINS))))
    reference, null = (left(rng.standard_normal((DRAWS, BINS))) for _ in range(2))
    found: dict[str, dict[str, dict[str, float]]] = {}
    battery = Battery(torch.arange(float(BINS), dtype=torch.float64), torch.zeros(BINS, dtype=torch.long),
                      {"time": torch.arange(float(BINS))}, {"patterns": torch.tensor(patterns)}, True)  # fmt: skip
    sorted_null = {name: torch.sort(values).values for name, values in _battery(battery, reference).items()}
    base = _all(battery, sorted_null, weights, patterns, reference, null)
    for strength in STRENGTHS:
        which = rng.integers(len(patterns), size=TRIALS)
        sign = rng.choice([-1.0, 1.0], size=TRIALS)[:, None]
        distorted = left(rng.standard_normal((TRIALS, BINS))) + strength * sign * patterns[which]
        for name, values in _all(battery, sorted_null, weights, patterns, reference, distorted).items():
            limits = {level: np.quantile(base[name], 1 - level) for level in ALARMS}
            found.setdefault(name, {})[f"{strength:g}"] = {
                str(level): float((values > limit).mean()) for level, limit in limits.items()
            }
    return {"seed": seed, "trials": TRIALS, "detected": found}


def _battery(battery: Battery, rows: Array) -> dict[str, torch.Tensor]:
    u = torch.tensor(rows)
    return battery.statistics(u, u[:, :0])


def _all(
    battery: Battery,
    sorted_null: dict[str, torch.Tensor],
    weights: Array,
    patterns: Array,
    reference: Array,
    rows: Array,
) -> dict[str, Array]:
    """Every statistic (N,) of residuals (N, T), large where something is missing."""
    t = statistics(weights, reference, rows)[1]
    smallest = torch.stack(
        [log_tail(sorted_null[name], values) for name, values in _battery(battery, rows).items()]
    ).amin(0)
    exact = (rows @ patterns.T) ** 2
    a2 = AMPLITUDE**2
    odds = np.exp(np.minimum(0.5 * a2 / (1 + a2) * exact, 600)).mean(1)
    return {
        "torchlc, odds": odds,
        "torchlc, battery": -smallest.numpy(),
        "distortions, largest t": t.max(1),
        "distortions, sum of t": t.sum(1),
        "chi-square": (rows**2).sum(1),
    }


def main() -> None:
    content = json.dumps(compared(20261128), indent=1) + "\n"
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(content, encoding="utf-8")
    print(content)


if __name__ == "__main__":
    main()
