"""Visor or none, from 23 magnitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import t
from unseen import DATA, area_under_curve

EXPOSURE_S = 30.0
"""Of the images whose zero points are quoted; a satellite crosses its streak in a fraction of a second."""


def visor() -> dict[str, Any]:
    """Probability of a visor for each of 23 satellites from the other 22: magnitudes at 550 km, linear in the phase angle, with a
    mean for either kind and one spread; and the area under the curve with the 90 % interval of resampled satellites, of these
    probabilities and of the magnitudes themselves, the fainter the likelier."""
    lines = (DATA / "starlink_2021_visor" / "mags-streaks.dat").read_text().splitlines()[1:]
    cells = [line.split() for line in lines if line.strip()]
    zero, counts, streak, rate, range_km, phase = (
        np.array([float(one[k]) for one in cells]) for k in (1, 3, 6, 7, 8, 10)
    )
    fitted_visor = np.array([one[11] == "T" for one in cells])
    mag = zero - 2.5 * np.log10(counts * EXPOSURE_S / (streak / rate))
    reduced = mag - 5 * np.log10(range_km / 550.0)
    basis = np.stack([np.ones(len(mag)), fitted_visor, phase - phase.mean()], 1)
    chance = np.empty(len(mag))
    for k in range(len(mag)):
        rest = np.arange(len(mag)) != k
        log_density = []
        for kind in (0.0, 1.0):
            row = np.array([1.0, kind, phase[k] - phase.mean()])
            inverse = np.linalg.inv(basis[rest].T @ basis[rest])
            best = inverse @ basis[rest].T @ reduced[rest]
            dof = rest.sum() - 3
            variance = ((reduced[rest] - basis[rest] @ best) ** 2).sum() / dof
            width = np.sqrt(variance * (1 + row @ inverse @ row))
            log_density.append(t.logpdf((reduced[k] - row @ best) / width, dof) - np.log(width))
        share = fitted_visor[rest].mean()
        odds = np.log(share / (1 - share)) + log_density[1] - log_density[0]
        chance[k] = 1 / (1 + np.exp(-odds))
    random = np.random.default_rng(0)
    areas, plain = [], []
    while len(areas) < 4000:
        some = random.integers(len(mag), size=len(mag))
        if 0 < fitted_visor[some].sum() < len(some):
            areas.append(area_under_curve(chance[some], fitted_visor[some]))
            plain.append(area_under_curve(reduced[some], fitted_visor[some]))
    best = np.linalg.lstsq(basis, reduced, rcond=None)[0]
    return {
        "satellites": [
            {"name": one[0], "mag": m, "reduced": r, "visor": bool(v), "probability": p}
            for one, m, r, v, p in zip(
                cells, mag.tolist(), reduced.tolist(), fitted_visor, chance.tolist(), strict=True
            )
        ],
        "fainter_with_visor": float(best[1]),
        "sigma": float(np.std(reduced - basis @ best, ddof=3)),
        "auc": area_under_curve(chance, fitted_visor),
        "auc_of_magnitude": area_under_curve(reduced, fitted_visor),
        "auc_of_magnitude_90": np.quantile(plain, (0.05, 0.95)).tolist(),
        "auc_90": np.quantile(areas, (0.05, 0.95)).tolist(),
        "right": int(((chance > 0.5) == fitted_visor).sum()),
        "of": len(mag),
    }
