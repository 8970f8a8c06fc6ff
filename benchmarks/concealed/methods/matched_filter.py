"""Residual patterns: what each cause would leave in the residuals of a refit is matched with what is there.

The score of a pattern is (g.r)^2 / g.g, the gain in twice the log likelihood of its best amplitude; its p-value that of the
largest score of the menu among refits to null draws. Probabilities take Schwarz's price, ln(T) / 2 for the amplitude and as
much for each further parameter that the menu varies as one (two in all), causes alike before the data.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Array, Case
from benchmarks.concealed.linear import LARGE, gain_unseen, p_of_draws

TITLE = "matched filter"
NEEDS: Sequence[str] = ()
NAMES = True
SHARES: Sequence[str] = ("nominal", "menu")
DRAWS = 2000
LEAST = 0.3
"""Root sum of squares below which a pattern is all absorbed."""
WIDTH = 3.0
"""Standard deviation of the amplitude of a pattern in a prediction; patterns are made at typical sizes."""


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    menu = case.menu(without)
    u = case.residual[: case.rows]
    null = case.null_residuals(DRAWS, seed)
    largest = np.zeros(DRAWS)
    scores, patterns, changes = [], [], []
    for cause in menu:
        left = case.left(cause.changes)
        size = np.linalg.norm(left, axis=1)
        kept = size > LEAST
        unit = left[kept] / size[kept, None]
        if not len(unit):
            scores.append(-np.inf)
            patterns.append(np.zeros(case.rows))
            changes.append(np.zeros(case.rows))
            continue
        largest = np.maximum(largest, ((null @ unit.T) ** 2).max(1))
        score = (unit @ u) ** 2
        best = int(score.argmax())
        scores.append(float(score[best]))
        patterns.append(unit[best])
        changes.append(cause.changes[kept][best])
    if not menu or max(scores) <= 0:
        return Answer(1.0, "none")
    names, top = _by_name([one.name for one in menu], np.array(scores))
    p = p_of_draws(max(scores), largest)
    log_odds = 0.5 * top - np.log(case.rows)
    weight = np.exp(np.r_[0.0, log_odds - np.log(len(top))] - max(0.0, float(log_odds.max())))
    share = weight / weight.sum()
    first = int(np.argmax(scores))
    pattern = patterns[first]
    remains = u - (u @ pattern) * pattern
    unexplained = p_of_draws(float(remains @ remains), (null**2).sum(1))
    family = tuple(one for one, w in zip(names, share[1:], strict=True) if w >= 0.1 * share[1])
    verdict = "none" if p >= SURE else ("unlisted" if unexplained < SURE else "named")
    amplitude = (u @ pattern) / max(np.linalg.norm(case.left(changes[first][None])[0]), LEAST)
    return Answer(
        p,
        verdict,
        [(one,) for one in names],
        [family],
        float(
            {"none": share[0], "named": sum(share[1 : 1 + len(family)]), "unlisted": 1 - unexplained}[verdict]
        ),
        np.abs(amplitude * case.left(changes[first][None])[0]) > LARGE if verdict != "none" else None,
        gain_unseen(case, lambda known: _chosen(case, menu, known)),
    )


def _by_name(names: Sequence[str], scores: Array) -> tuple[list[str], Array]:
    """Names, best first, and the best score of each."""
    best: dict[str, float] = {}
    for name, score in zip(names, scores.tolist(), strict=True):
        best[name] = max(score, best.get(name, -np.inf))
    order = sorted(best, key=lambda name: -best[name])
    return order, np.array([best[name] for name in order])


def _chosen(case: Case, menu: Sequence, known: Array) -> Array:
    """Covariance of the cause that scores best on the known rows, if it is worth its price there."""
    u = case.residual[: case.rows][known]
    slopes = np.concatenate([-case.slopes[known], np.eye(case.slopes.shape[1])])
    basis = np.linalg.qr(slopes)[0]
    padded = np.concatenate([u, case.residual[case.rows :]])
    padded = padded - basis @ (basis.T @ padded)
    best, chosen = 2 * np.log(case.rows), np.zeros(case.rows)
    for cause in menu:
        rows = np.concatenate(
            [cause.changes[:, known], np.zeros((len(cause.changes), case.slopes.shape[1]))], 1
        )
        rows = rows - (rows @ basis) @ basis.T
        size = np.linalg.norm(rows, axis=1)
        score = np.where(size > LEAST, (rows @ padded) ** 2 / np.maximum(size, LEAST) ** 2, 0.0)
        if score.max() > best:
            best, chosen = float(score.max()), cause.changes[int(score.argmax())]
    return WIDTH**2 * np.outer(chosen, chosen)
