"""Kinds of rotation beside a turn about an axis fixed in the body: tilted bodies, sides that shine unlike, sides of each pass, and
free rotation."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.inference.rotation import pole_grid, tumble_grid
from torchlc.inference.rotation.connect import connections
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.modes import (
    ALIKE_DEG,
    CHANGED,
    KEPT_CHI2,
    SAME_DEG,
    apart_deg,
)
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.pole_grid import GridState
from torchlc.inference.rotation.refine import Local, Refiner, free_tilts
from torchlc.inference.rotation.tumble_grid import TumbleState
from torchlc.inference.rotation.tumble_refine import Tumble, TumbleRefiner
from torchlc.inference.rotation.two_frequencies import frequency_pairs

STEPS_A_TURN = 12.0
"""Frequencies of the grid: steps of 1/12 turn over the longest pass."""
FLOOR, SHARP = 0.05, 0.01
"""Relative error of the light of facets, and where that alone explains the rows."""
TILTED_DEG = 9.0
"""Axes of a body that is not quite even: within half of MOST_TILT, from where a descent goes either way."""
PAIRS, TUMBLE_STARTS, SECOND_STARTS = 16, 48, 30
"""Pairs of frequencies of a free rotation that are looked at; states of the grid that are refined, first over all bodies and then of
the best body."""
OF_A_BODY = 2
"""States of one body with one pair of frequencies among the first."""
TUMBLES = 2
"""Solutions of free rotation, and counts of turns of each, that the model is fitted to."""
MOST_HALVES, SIDES = 3, 2
"""Passes up to which all sets of their sides are tried, 7 of three (of more passes each by itself), and how many of them the model is
fitted to."""
Progress = Callable[[str, float], None]


def tilted_bodies(
    rows: Rows,
    body: FacetLight,
    poles: Tensor,
    grid: Tensor,
    states: Sequence[GridState],
    count: int,
    axis: Tensor,
) -> list[Local]:
    """Solutions with the body's axes turned against the axis of the spin, from the best of the straight ones turned
    either way, each pass at each of the phases that a straight body cannot tell apart."""
    angle = math.radians(TILTED_DEG)
    eye = torch.eye(3, dtype=torch.float64)
    free = free_tilts(body)
    tilts = [sign * angle * eye[component] for sign in (1.0, -1.0) for component in free]
    generator = torch.Generator().manual_seed(0)
    ways = torch.nn.functional.normalize(
        torch.randn(2, 40, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    exponent = torch.full((40, sum(body.lobed)), 3.0, dtype=torch.float64)
    plain = body.light(ways[0], ways[1], exponent)
    near = torch.stack([start.pole for start in states[: max(12, count // 4)]])
    best = torch.tensor(
        [frequency for state in states[:3] for frequency in state.frequencies], dtype=torch.float64
    )
    close = grid[(grid[:, None] - best).abs().amin(-1) < 2.5 / float(rows.span.max()) / STEPS_A_TURN]
    symmetric = body.symmetry(axis) % 2 == 0
    starts: list[GridState] = []
    turned: list[Tensor] = []
    for number, tilt in enumerate(tilts):
        slanted = body.turned(rotation_of(tilt))
        moved = slanted.light(ways[0], ways[1], exponent)
        if bool(((moved - plain).abs() <= 1e-3 * plain.abs().amax(0)).all()) or (
            symmetric and number >= len(free)
        ):
            continue  # a turn that changes nothing, or the half turn of another
        for state in pole_grid.search(rows, slanted, near, close)[: max(6, count // 8)]:
            starts.append(state)
            turned.append(tilt)
    if not starts:
        return []
    return distinct(
        Refiner(rows, body, FLOOR, tilted=free_tilts(body)).refined(starts, turned, iterations=40)
    )


def unlike_sides(
    rows: Rows,
    body: FacetLight,
    states: Sequence[GridState],
    bounds: tuple[float, float],
    count: int,
) -> list[Local]:
    """Solutions with paint of their own for sides half a turn apart, from the best of the plain body, at their turns, halves and
    doubles of these: light that comes once a turn of such a body comes twice a turn of a plain one, and glints that differ may be taken
    for one kind. Reflectances and exponents are means of the halves."""
    painted = body.unlike_halves()
    step = 1 / STEPS_A_TURN / float(rows.span.max())
    offsets = step * torch.arange(-3, 4, dtype=torch.float64)
    # all: a body of one paint may have liked other poles
    poles = torch.stack([state.pole for state in states])
    known = [
        frequency * part
        for state in states[:3]
        for frequency in state.frequencies
        for part in (1.0, 0.5, 2.0)
    ]
    around = (torch.tensor(known, dtype=torch.float64)[:, None] + offsets).reshape(-1)
    around = torch.unique((around / step).round()) * step
    around = around[(around >= bounds[0]) & (around <= bounds[1])]
    starts = pole_grid.search(rows, painted, poles, around)[: max(8, count // 4)]
    still = torch.zeros(3, dtype=torch.float64)
    solutions = distinct(Refiner(rows, painted, FLOOR).refined(starts, [still] * len(starts)))

    def mean(values: Tensor) -> Tensor:
        return values.reshape(2, -1).mean(0)

    diffuse = len(painted.names)
    return [
        replace(
            solution,
            exponents=mean(solution.exponents),
            weights=torch.cat([mean(solution.weights[:diffuse]), mean(solution.weights[diffuse:])]),
        )
        for solution in solutions
    ]


def sides_taken(
    rows: Rows, refiner: Refiner, best: Local, symmetry: int, bounds: tuple[float, float]
) -> list[Local]:
    """The best solution and those half a turn on in some of the passes that fit about as well, up to SIDES of them, first those whose
    passes join best. A body that but for its paint is its own image after half a turn may shine so much alike from both sides
    that a pass alone does not tell them apart; a wrong one would let the period change to join the passes."""
    if not connections(rows, best, symmetry, changing=True, bounds=bounds).complete:
        return [best]  # passes too far apart to be joined: a side that is taken wrongly changes nothing
    count = rows.passes
    halves = 0.5 * torch.eye(count, dtype=torch.float64)
    if count <= MOST_HALVES:
        sets = list(itertools.product((0.0, 0.5), repeat=count))[1:]
        halves = torch.tensor(sets, dtype=torch.float64)
    starts = [
        GridState(
            best.pole,
            tuple(best.frequencies.tolist()),
            tuple((best.phases + on).tolist()),
            best.chi2,
            best.weights,
        )
        for on in halves
    ]
    others = [
        solution
        for solution in refiner.refined(starts, [best.tilt] * len(starts))
        if solution.chi2 < best.chi2 + KEPT_CHI2 and apart_deg(solution.pole, best.pole) < ALIKE_DEG
    ]

    def joins(turn: Local) -> float:
        steady, drifting = (
            min(
                (
                    way.distance
                    for way in connections(rows, turn, symmetry, changing=changing, bounds=bounds).found
                ),
                default=math.inf,
            )
            for changing in (False, True)
        )
        return turn.chi2 + min(steady, drifting + CHANGED)

    return sorted([best, *others], key=joins)[:SIDES] if others else [best]


def distinct(found: Sequence[Local]) -> list[Local]:
    """Solutions of different poles or periods, best first."""
    kept: list[Local] = []
    for solution in found:
        if not math.isfinite(solution.chi2):
            continue
        if all(
            apart_deg(solution.pole, other.pole) > SAME_DEG
            or abs(solution.frequency / other.frequency - 1) > 1e-3
            for other in kept
        ):
            kept.append(solution)
    return kept


def free_rotations(
    rows: Rows, body: FacetLight, low: float, high: float, dof: int, about_an_axis: float, say: Progress
) -> list[Tumble]:
    """Solutions of free rotation, joined over the passes, best first. ``about_an_axis``: chi-square of a turn about an axis of
    the body."""
    axes = torch.eye(3, dtype=torch.float64)
    halves = all(body.symmetry(axis) % 2 == 0 for axis in axes)
    say("two frequencies", 0.0)
    pairs = frequency_pairs(rows, low, high, halves=halves, most=PAIRS)
    refiner = TumbleRefiner(rows, body, FLOOR)
    first = tumble_grid.search(
        rows, body, pairs, tumble_grid.bodies(), progress=lambda share: say("free rotations", share)
    )
    solutions = refiner.refined(
        _spread_out(first, TUMBLE_STARTS), progress=lambda share: say("their bodies", share)
    )
    if solutions and solutions[0][0].chi2 < about_an_axis - CHANGED:
        # the bodies are known now, but for which axis is which; with them the grid tells directions of the angular momentum apart
        for state in _distinct_tumbles(solutions, TUMBLES):
            axes = torch.tensor(list(itertools.permutations(range(3))))
            moments = state.moments[axes]
            states = tumble_grid.search(
                rows, body, [state.pair], moments / moments[:, 2:], kept=SECOND_STARTS // 3
            )
            solutions += refiner.refined(
                states[:SECOND_STARTS], progress=lambda share: say("their poles", share)
            )
    solutions.sort(key=lambda solution: solution[0].chi2)
    kept: list[tuple[Tumble, Tensor, Tensor]] = []
    for candidate in solutions:
        if len(kept) < TUMBLES and all(not _same(candidate[0], other[0]) for other in kept):
            kept.append(candidate)
    joined = []
    for start in kept:
        if start[0].chi2 < 1.5 * kept[0][0].chi2 + 200:
            # light of flat facets is that of the model, but for shadows, which a good fit says there are none of
            last = TumbleRefiner(rows, body, SHARP if start[0].chi2 < dof else FLOOR)
            joined += last.joined(last.settled(start))[:TUMBLES]
    joined.sort(key=lambda tumble: tumble.chi2)
    return [tumble for tumble in joined if tumble.chi2 < joined[0].chi2 + 2 * KEPT_CHI2]


def _spread_out(states: Sequence[TumbleState], most: int) -> list[TumbleState]:
    """The best states, OF_A_BODY of each body with each pair of frequencies."""
    kept: list[TumbleState] = []
    count: Counter[tuple[float, ...]] = Counter()
    for state in states:
        key = (state.long, state.nutation, *state.moments.tolist())
        if len(kept) < most and count[key] < OF_A_BODY:
            count[key] += 1
            kept.append(state)
    return kept


def _distinct_tumbles(tumbles: Sequence[tuple[Tumble, Tensor, Tensor]], most: int) -> list[Tumble]:
    """The best solutions of different bodies."""
    kept: list[Tumble] = []
    for tumble, _, _ in tumbles:
        if len(kept) < most and all(
            bool(((tumble.moments - other.moments).abs() > 0.05).any()) for other in kept
        ):
            kept.append(tumble)
    return [solution for solution in kept if solution.chi2 < 2 * kept[0].chi2]


def _same(tumble: Tumble, other: Tumble) -> bool:
    """Whether two solutions are one: of a pole, a body and periods."""
    return (
        apart_deg(tumble.pole, other.pole) < SAME_DEG
        and abs(tumble.long / other.long - 1) < 1e-3
        and bool(((tumble.moments - other.moments).abs() < 0.02).all())
    )
