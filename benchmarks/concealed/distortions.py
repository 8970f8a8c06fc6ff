"""Distortion-driven tests of misspecification (Anau Montel, Alvey & Weniger 2025, Phys. Rev. D 111, 083013), written from the
paper: many alternatives H_i, each the base simulator distorted, with t_i = -2 ln p(x|H0) / p(x|H_i), their sum, and a global
p-value by simulation. Here x is the whitened residual of a refit, and distortions are what each value of each cause of the
menu leaves of it, and bumps in time at many places and of some widths.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from benchmarks.concealed.case import Array, Case

LEAST = 0.3
"""Root sum of squares below which a distortion is all absorbed."""
WIDTHS = (0.0, 0.02, 0.08)
"""Of the bumps, in shares of the rows; 0 is a single row."""
PLACES = 60


@dataclass(frozen=True)
class Basis:
    """Unit patterns (K, T) of distortions, and the ``owner`` (K,) of each: a place in ``names``, -1 of a bump."""

    patterns: Array
    owner: Array
    names: list[str]

    @property
    def menu(self) -> Array:
        """Which patterns are those of the menu, (K,)."""
        return self.owner >= 0


def basis(case: Case, without: Collection[str]) -> Basis:
    menu = case.menu(without)
    names = sorted({one.name for one in menu})
    changes = [one.changes for one in menu] + [bumps(case.rows, np.argsort(case.seconds))]
    owner = [np.full(len(one.changes), names.index(one.name)) for one in menu] + [
        np.full(len(changes[-1]), -1)
    ]
    left, whose = case.left(np.concatenate(changes)), np.concatenate(owner)
    size = np.linalg.norm(left, axis=1)
    kept = size > LEAST
    return Basis(left[kept] / size[kept, None], whose[kept], names)


def bumps(rows: int, order: Array) -> Array:
    """Normal curves (K, T) along the rows in order of time, of unit sum of squares."""
    place = np.empty(rows)
    place[order] = np.arange(rows)
    centres = np.linspace(0, rows - 1, min(PLACES, rows))
    some = [
        np.exp(-0.5 * ((place - centre) / max(width * rows, 0.3)) ** 2)
        for width in WIDTHS
        for centre in centres
    ]
    found = np.array(some)
    return found / np.linalg.norm(found, axis=1, keepdims=True)
