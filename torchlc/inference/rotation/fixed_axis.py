"""Turns about an axis fixed in the body: from a grid of poles and frequencies to solutions by least squares. Where these leave
structure the axis is tilted against the body's, and sides half a turn apart may shine unlike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.course import Course
from torchlc.inference.rotation.kinds import (
    FLOOR,
    STEPS_A_TURN,
    distinct,
    sides_taken,
    tilted_bodies,
    unlike_sides,
)
from torchlc.inference.rotation.modes import ALIKE_DEG, CHANGED, apart_deg
from torchlc.inference.rotation.pole_grid import GridState
from torchlc.inference.rotation.problem import Problem
from torchlc.inference.rotation.refine import Local, Refiner

POLES = 500
"""Directions 9 deg apart: any pole is within 7 deg of one of them."""
STARTS_S, START_S, PAIR_S = 14.0, 0.06, 2.2e-7
"""CPU seconds for the first least squares, of a start, and of each pair of row and facet and coordinate of a start, as measured on one
core."""
LEAST_STARTS, MOST_STARTS = 24, 200
"""Whatever time they take: fewer leave out minima, more of them end where others do."""
STRUCTURE = 1.25
"""Chi-square a degree of freedom above which a body is tried with its axes tilted, and then without an axis of its spin."""
OTHER = 0.1
"""Relative difference from which on two turns are no longer one, a synodic and a sidereal one say, but multiples."""
SAME_REGION = 0.01
"""Relative difference of turns that a pole some degrees off makes over a pass."""
AXIS = (0.0, 0.0, 1.0)
"""Of the spin, in the body."""


@dataclass(frozen=True)
class Turns:
    """``poles`` (D, 3) of the grid and the ``states`` that it gave, the ``best`` solutions first, whether the axis may be tilted against
    the body's, ``symmetry``, how many turns within one look alike, degrees of freedom, and what has to be said. Where the best are
    those of a body whose sides shine unlike, ``of_one_paint`` are those of the scene's own materials."""

    poles: Tensor
    states: list[GridState]
    best: list[Local]
    tilted: bool
    symmetry: int
    dof: int
    told: list[str]
    of_one_paint: Turns | None = None

    @property
    def kinds(self) -> list[Turns]:
        """Itself, and those of one paint beside them: the model, which has the scene's materials, is fitted to both."""
        return [self] if self.of_one_paint is None else [self, self.of_one_paint]

    def other_turn(self, period_s: float) -> float | None:
        """The turn, s, that sides of unlike paint explain better than any of one paint, where it is another than ``period_s``."""
        turn = 1 / self.best[0].frequency
        return None if self.of_one_paint is None or abs(turn / period_s - 1) < OTHER else turn

    @property
    def leaves_structure(self) -> bool:
        return self.best[0].chi2 / self.dof > STRUCTURE

    def leading(self, most: int) -> list[Local]:
        """The first of the solutions that are about as good as the first of all. Where that leaves structure, which the model may see
        otherwise, one of each region of poles comes before a second."""
        enough = 1.5 * self.best[0].chi2 + 200 if self.best else math.inf
        first, more = [], []
        for solution in self.best:
            known = self.leaves_structure and any(_near(solution, other) for other in first)
            (more if known else first).append(solution)
        return [*self.best[:1], *(local for local in [*first[1:], *more] if local.chi2 <= enough)][:most]

    def misfits(self) -> list[float]:
        """Of the grid at each of its poles."""
        known = {tuple(state.pole.tolist()): state.misfit for state in self.states}
        return [known[tuple(pole.tolist())] for pole in self.poles]


def turns(problem: Problem, ranges: Sequence[tuple[float, float]], course: Course) -> Turns:
    """Turns of a frequency within the ``ranges``, 1/s."""
    grid = _frequencies(problem, ranges)
    solved = _straight(problem, grid, course)
    count = _starts(problem)
    # a scene that gives a tilt has it tried whatever the straight body leaves
    given = "tilt" in problem.scene.attitude.model_fields_set
    if given or (solved.leaves_structure and course.allowed("tilted bodies")):
        solved = _tilted(problem, replace(solved, tilted=given), grid, count, course)
    if (
        solved.leaves_structure
        and problem.body.symmetry(_axis()) > 1
        and course.allowed("sides of unlike paint")
    ):
        solved = _unlike(problem, solved, given, count, course)
    return solved


def with_sides(problem: Problem, found: Turns, course: Course) -> Turns:
    """The turns, the best with the sides of each pass that join the passes best, where a pass alone does not tell them apart."""
    if problem.rows.passes < 2 or found.symmetry % 2 == 0 or found.tilted:
        return found
    course.say("sides of each pass", 0.0)
    refiner = Refiner(problem.rows, problem.body, FLOOR)
    sides = sides_taken(problem.rows, refiner, found.best[0], found.symmetry, problem.wide)
    return replace(found, best=[*sides, *found.best[1:]])


def _near(solution: Local, other: Local) -> bool:
    """Whether two solutions are of one region of poles and one turn."""
    return (
        apart_deg(solution.pole, other.pole) < ALIKE_DEG
        and abs(solution.frequency / other.frequency - 1) < SAME_REGION
    )


def _axis() -> Tensor:
    return torch.tensor(AXIS, dtype=torch.float64)


def _frequencies(problem: Problem, ranges: Sequence[tuple[float, float]]) -> Tensor:
    step = 1 / (STEPS_A_TURN * problem.longest_pass_s)
    return torch.cat(
        [torch.linspace(a, b, max(2, math.ceil((b - a) / step) + 1), dtype=torch.float64) for a, b in ranges]
    )


def _starts(problem: Problem) -> int:
    """States of the grid that the first least squares begin at: as many as STARTS_S are enough for."""
    rows, body = problem.rows, problem.body
    coordinates = 3 + 2 * rows.passes + sum(body.lobed)
    count = int(STARTS_S / (START_S + PAIR_S * len(body.normal) * len(rows.flux) * coordinates))
    return max(LEAST_STARTS, min(MOST_STARTS, count))


def _straight(problem: Problem, grid: Tensor, course: Course) -> Turns:
    """Turns about the body's own axis."""
    rows, body = problem.rows, problem.body
    poles = pole_grid.directions(POLES)
    symmetry = body.symmetry(_axis())
    course.say("poles", 0.0)
    states = course.kept.of(
        "poles",
        GridState,
        lambda: pole_grid.search(
            rows,
            body,
            poles,
            grid,
            symmetry=_whole_steps(symmetry),
            progress=lambda share: course.say("poles", share),
        ),
    )
    starts = states[: _starts(problem)]
    still = torch.zeros(3, dtype=torch.float64)
    course.say("least squares", 0.0)
    best = course.kept.of(
        "least squares",
        Local,
        lambda: distinct(Refiner(rows, body, FLOOR).refined(starts, [still] * len(starts))),
    )
    dof = max(1, len(rows.flux) - 2 * rows.passes - 4)
    return Turns(poles, states, best, tilted=False, symmetry=symmetry, dof=dof, told=[])


def _whole_steps(symmetry: int) -> int:
    """The part of a turn that the grid searches: one of which its steps are a multiple."""
    return max(m for m in range(1, symmetry + 1) if symmetry % m == 0 and (pole_grid.STEPS // 2) % m == 0)


def _tilted(problem: Problem, straight: Turns, grid: Tensor, count: int, course: Course) -> Turns:
    """The turns of tilted bodies where these are better, else the straight ones."""
    course.say("tilted bodies", 0.0)
    slanted = course.kept.of(
        "tilted",
        Local,
        lambda: tilted_bodies(
            problem.rows, problem.body, straight.poles, grid, straight.states, count, _axis()
        ),
    )
    if slanted and slanted[0].chi2 < straight.best[0].chi2 - CHANGED:
        return replace(straight, best=slanted, tilted=True, symmetry=1)
    return straight


def _unlike(problem: Problem, plain: Turns, given: bool, count: int, course: Course) -> Turns:
    """The turns of a body whose sides half a turn apart shine unlike, where these are better by CHANGED for each further number, else
    the plain ones. ``given``: the scene gives a tilt."""
    course.say("unlike sides", 0.0)
    rows, body, steady = problem.rows, problem.body, plain.best[0].chi2
    unlike = course.kept.of(
        "unlike",
        Local,
        lambda: unlike_sides(rows, body, plain.states, (problem.low, problem.high), count),
    )
    if not unlike or unlike[0].chi2 >= steady - CHANGED * sum(body.unlike_halves().lobed):
        return plain
    sentence = (
        f"sides half a turn apart shine unlike: with paint of their own a turn in {1 / unlike[0].frequency:.6g} s leaves "
        f"chi-square {unlike[0].chi2:.0f} where the scene's materials leave {steady:.0f}; give such faces materials of "
        "their own (sectors and face_materials of a cylinder, face_materials of a box)"
    )
    return replace(plain, best=unlike, symmetry=1, tilted=given, told=[sentence], of_one_paint=plain)
