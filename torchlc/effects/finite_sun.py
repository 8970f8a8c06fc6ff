"""The Sun is a limb-darkened disc, not a point."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchlc.effects.sun_distance import AU_KM
from torchlc.geometry.orbit.shadow import SUN_RADIUS_KM
from torchlc.geometry.orbit.sunlight import LIMB_DARKENING
from torchlc.stages.effect import Context, Effect
from torchlc.stages.light import Disc
from torchlc.stages.showing import MIRROR, PANEL_GLINT, Shown

RULES: dict[tuple[int, ...], float] = {
    (5,): 0.7,
    (5, 8): 1.9,
    (5, 8, 10): 3.3,
    (5, 8, 10, 12): 4.4,
    (5, 9, 13, 17, 21, 25): 7.4,
    (6, 12, 18, 24, 30, 36, 42, 48): 10.5,
}
"""Points of each ring, from the innermost, and the reach of each rule: the half-width of the disc, seen by the half vector, in
standard deviations of a lobe, up to which it is within 0.3 % of the peak."""
SPOKES = (5, 8, 10, 12)
FEW_SPOKES = (5,)
"""The least for meshes of many facets, and enough for surfaces curved about two axes, which spread the disc themselves."""
CURVED_ONCE_SPOKES = (5, 8, 10)
"""The least for surfaces curved about one axis, which spread the disc across it only: one ring fewer is 5 % off on the flank of a
glint of n = 1e6."""


def disc_in_lobes(n: float, phase_angle_deg: float) -> float:
    """Half-width of the Sun's disc in standard deviations 1 / sqrt(n) of a lobe about the half vector. This turns by half of what
    the Sun does within the plane of Sun and observer, and by half over the cosine of half the phase angle across it."""
    across = max(math.cos(math.radians(phase_angle_deg) / 2), 1e-3)
    return 0.5 * SUN_RADIUS_KM / AU_KM / across * math.sqrt(n)


def enough(least: tuple[int, ...], needed: float) -> tuple[int, ...]:
    """The smallest rule, at least ``least``, whose reach is ``needed``; the largest where none is."""
    rules = list(RULES)
    later = rules[rules.index(least) :]
    return next((rule for rule in later if RULES[rule] >= needed), later[-1])


@functools.cache
def rings(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Radii and weights of the Gauss rule of ``count`` nodes in r^2 whose weight function is the disc's limb-darkened
    brightness."""
    x, w = np.polynomial.legendre.leggauss(64)
    x = 0.5 * (x + 1)
    light = w * (1 - LIMB_DARKENING * (1 - np.sqrt(1 - x)))
    orthonormal, _ = np.linalg.qr(np.sqrt(light)[:, None] * np.polynomial.legendre.legvander(x, count - 1))
    nodes, vectors = np.linalg.eigh(orthonormal.T @ (x[:, None] * orthonormal))
    return np.sqrt(nodes), vectors[0] ** 2


def disc_nodes(like: Tensor, each: Sequence[int] = SPOKES) -> tuple[Tensor, Tensor]:
    """Points (D, 2) on the disc, in radii of it, ``each`` of them on a ring, and their weights (D,), which sum to 1."""
    points, weights = _nodes(tuple(each))
    return torch.as_tensor(points).to(like), torch.as_tensor(weights).to(like)


@functools.cache
def _nodes(each: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    points, weights = [], []
    for number, (radius, weight, spokes) in enumerate(zip(*rings(len(each)), each, strict=True)):
        angle = 2 * math.pi * (np.arange(spokes) + 0.5 * (number % 2)) / spokes
        points.append(radius * np.stack([np.cos(angle), np.sin(angle)], -1))
        weights.append(np.full(spokes, weight / spokes))
    return np.concatenate(points), np.concatenate(weights)


class FiniteSun(Effect):
    """The limb-darkened disc of the Sun lights the object from 35 directions or more: a mirror glint is as wide as the Sun.

    Peak loss 0.13 % at n = 1e3, 1.3 % at 1e4, 12 % at 1e5. How many directions there are follows from the sharpest lobe (of a
    free one the scene's value, at least 1e4) and the largest phase angle of the rows, up to 216: within 0.3 % of the peak up to n = 1e6 and
    155 deg. A side of a cylinder or cone, which spreads the disc along its arc, gets 23 or more, meshes of more than 100 facets 5 or
    more, a sphere or dish 5. Where a fit ends at a lobe that is too sharp for them it is told. Where the geometry is free, pairs of
    facet and row far from a glint get as few as one, to 1e-4 mag. Neglects the softening of shadow edges, 9 mm at 2 m.
    """

    name = "finite_sun"
    title = "the disc of the Sun, which is no point"
    shown = Shown(MIRROR, PANEL_GLINT, materials={"panel.n": 100000.0})
    stage = "light"
    known = True
    widens = True
    order = 1
    nodes = sum(SPOKES)
    spokes = SPOKES
    spokes_curved = CURVED_ONCE_SPOKES

    def missing(self, context):
        if all(context.models[name].additive for name in context.materials):
            return "no material has a lobe that the disc could widen"
        return None

    def prepared(self, context):
        needed = self._needed(context)
        self.spokes = enough(FEW_SPOKES if context.many_facets else SPOKES, needed)
        self.spokes_curved = enough(CURVED_ONCE_SPOKES, needed)
        self.nodes = sum(self.spokes)
        return self

    @staticmethod
    def _needed(context: Context) -> float:
        lobes = [n for name, n in context.lobes.items() if not context.models[name].additive]
        return disc_in_lobes(max(lobes, default=1.0), float(context.track.phase_angle_deg.max()))

    def limits(self, p, context):
        needed = self._needed(context)
        if needed <= RULES[self.spokes]:
            return ()
        return (
            f"finite_sun: {self.nodes} directions do for lobes up to n = {(RULES[self.spokes] / needed) ** 2 * max(context.lobes.values()):.2g} "
            "at these phase angles, and sharper ones are more than 0.3 % off; start the fit there (n = {value = ...}) for more",
        )

    def light(self, lights, view, p, context):
        radius = SUN_RADIUS_KM / torch.linalg.vector_norm(view.state.sun, dim=-1)
        several = dict.fromkeys((FEW_SPOKES, self.spokes_curved, self.spokes))
        rules = [disc_nodes(view.to_sun, spokes) for spokes in several]
        disc = Disc(radius, tuple(rules))
        once, twice, plain = (
            list(several).index(spokes) for spokes in (self.spokes_curved, FEW_SPOKES, self.spokes)
        )

        def lit(light):
            if not light.primary:
                return light
            if view.whole_discs:
                return replace(light, disc=disc)
            return replace(
                disc.spread(light, plain), fewer=(disc.spread(light, once), disc.spread(light, twice))
            )

        return tuple(map(lit, lights))
