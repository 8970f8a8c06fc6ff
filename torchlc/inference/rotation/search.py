"""From a scene and a recording to rotation states: the periods to look at, a grid of poles, least squares, the counts of
turns between passes, and the model with everything in it. What turns about no axis fixed in it is looked for where that leaves
structure.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.files.steps import Steps
from torchlc.geometry.rotation.matrices import rotation_of
from torchlc.inference.likelihood import MAG_PER_LN
from torchlc.inference.rotation import pole_grid, tumble_grid
from torchlc.inference.rotation.connect import Connection, Connections, connections, differences
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.model_fit import (
    Candidate,
    Count,
    Trial,
    alike,
    epoch_seconds,
    fitted,
    loose_trial,
    sharpened,
    steady_trial,
    tumbling_trial,
)
from torchlc.inference.rotation.modes import (
    ALIKE_DEG,
    CHANGED,
    KEPT_CHI2,
    NOISY,
    SAME_DEG,
    SAME_PERIOD,
    RotationSearch,
    apart_deg,
    fits_the_rows,
    merged,
    verdict,
)
from torchlc.inference.rotation.modes import RotationMode as RotationMode
from torchlc.inference.rotation.passes import Rows, rows_of
from torchlc.inference.rotation.pole_grid import GridState
from torchlc.inference.rotation.refine import Local, Refiner, free_tilts
from torchlc.inference.rotation.tumble_grid import TumbleState
from torchlc.inference.rotation.tumble_refine import Tumble, TumbleRefiner
from torchlc.inference.rotation.two_frequencies import frequency_pairs
from torchlc.inference.rotation.windows import windows
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Free, Scene

POLES = 500
STEPS_A_TURN = 12.0
"""Frequencies of the grid: steps of 1/12 turn over the longest pass."""
STARTS_S, START_S, PAIR_S = 14.0, 0.06, 2.2e-7
"""CPU seconds for the first least squares, of a start, and of each pair of row and facet and coordinate of a start, as measured on one
core."""
LEAST_STARTS, MOST_STARTS = 24, 200
FLOOR, SHARP = 0.05, 0.01
"""Relative error of the light of facets, and where that alone explains the rows."""
LOCALS, JOINED = 4, 3
"""Solutions of different poles, and counts of turns of the best, that the model is fitted to."""
APART = 2
"""Poles at which the model is fitted with a phase for each night too, where counts of turns explain the light already."""
LIKELY = 12
"""Counts of turns that are told of a mode, if its phases leave several."""
TILTED_DEG = 9.0
STRUCTURE = 1.25
"""Chi-square a degree of freedom above which a body is tried with its axes tilted, and then without an axis of its spin."""
UNSTEADY = 150.0
"""Squared distance, in standard deviations, of the phases from any steady spin beyond which the model is not tried on one."""
PAIRS, TUMBLE_STARTS, SECOND_STARTS = 16, 48, 30
"""Pairs of frequencies of a free rotation that are looked at; states of the grid that are refined, first over all bodies and then of
the best body."""
OF_A_BODY = 2
"""States of one body with one pair of frequencies among the first."""
TUMBLES = 2
"""Solutions of free rotation, and counts of turns of each, that the model is fitted to."""
UNLIKE = 0.01
"""Relative difference that the periods of passes may have, from which on these are asked before a free rotation. Nights of two weeks are
below it, so what tumbles is not taken for what changes."""
MOST_HALVES, SIDES = 3, 2
"""Passes up to which all sets of their sides are tried, 7 of three (of more passes each by itself), and how many of them the model is
fitted to."""
MIN_ROWS = 12
MOST_CHANGE = 0.1
"""Relative change of a period between passes up to which the scene's bounds, which are of its epoch, are widened: rocket bodies
change by 5 % in six years."""
Progress = Callable[[str, float], None]


def search_rotation(
    scene: Scene,
    recording: Recording,
    *,
    shortest_s: float | None = None,
    longest_s: float | None = None,
    progress: Progress | None = None,
    steps: Steps | None = None,
) -> RotationSearch:
    """Rotation states of a body: about a direction fixed in it and in space, or, where that leaves structure, free."""
    say = progress or (lambda _text, _share: None)
    kept = steps or Steps()
    if scene.attitude.mode not in ("spin-pole", "rigid-body"):
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}"',
            '"spin-pole" (pole, period, phase, epoch), whose numbers are where the search starts',
        )
    model = LightCurve(scene, recording)
    rows = rows_of(model)
    if len(rows.flux) < MIN_ROWS:
        raise InputError(
            recording.source,
            None,
            f"{len(rows.flux)} measured rows",
            f"at least {MIN_ROWS} to find a rotation",
        )
    if not float(rows.span.max()) > 0:
        raise InputError(recording.source, "column time", "passes of one row each", "a stretch of time")
    body = FacetLight.of(model.assembly)
    low, high, warnings = _range(scene, recording, rows, shortest_s, longest_s)
    warnings += body.notes
    ranges, frequency, power = windows(rows, low, high)
    step = 1 / (STEPS_A_TURN * float(rows.span.max()))
    grid = torch.cat(
        [torch.linspace(a, b, max(2, math.ceil((b - a) / step) + 1), dtype=torch.float64) for a, b in ranges]
    )
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    symmetry = body.symmetry(axis)
    poles = pole_grid.directions(POLES)
    say("poles", 0.0)
    states = kept.of(
        "poles",
        GridState,
        lambda: pole_grid.search(
            rows,
            body,
            poles,
            grid,
            symmetry=_whole_steps(symmetry),
            progress=lambda share: say("poles", share),
        ),
    )
    coordinates = 3 + 2 * rows.passes + sum(body.lobed)
    count = int(STARTS_S / (START_S + PAIR_S * len(body.normal) * len(rows.flux) * coordinates))
    count = max(LEAST_STARTS, min(MOST_STARTS, count))
    still = torch.zeros(3, dtype=torch.float64)
    say("least squares", 0.0)
    refiner = Refiner(rows, body, FLOOR)
    locals_ = kept.of(
        "least squares",
        Local,
        lambda: _distinct(refiner.refined(states[:count], [still] * len(states[:count]))),
    )
    dof = max(1, len(rows.flux) - 2 * rows.passes - 4)
    tilted = "tilt" in scene.attitude.model_fields_set
    if tilted or locals_[0].chi2 / dof > STRUCTURE:
        say("tilted bodies", 0.0)
        slanted = kept.of("tilted", Local, lambda: _tilted(rows, body, poles, grid, states, count, axis))
        if slanted and slanted[0].chi2 < locals_[0].chi2 - CHANGED:
            locals_, tilted, symmetry = slanted, True, 1
    steady = locals_[0].chi2  # the best that a turn about one axis does
    if steady / dof > STRUCTURE and body.symmetry(axis) > 1:
        say("unlike sides", 0.0)
        unlike = kept.of("unlike", Local, lambda: _unlike(rows, body, states, (low, high), count))
        if unlike and unlike[0].chi2 < steady - CHANGED * sum(body.unlike_halves().lobed):
            warnings.append(
                f"sides half a turn apart shine unlike: with paint of their own a turn in {1 / unlike[0].frequency:.6g} s leaves "
                f"chi-square {unlike[0].chi2:.0f} where the scene's materials leave {steady:.0f}; give such faces materials of "
                "their own (sectors and face_materials of a cylinder, face_materials of a box)"
            )
            locals_, steady, symmetry = unlike, unlike[0].chi2, 1
            tilted = "tilt" in scene.attitude.model_fields_set
    tumbles: list[Tumble] = []
    free = scene.attitude.mode == "rigid-body" or steady / dof > STRUCTURE
    if free and _changed(rows, locals_[0]):
        free = False
        least, most = (1 / float(one) for one in (locals_[0].frequencies.max(), locals_[0].frequencies.min()))
        warnings.append(
            f"the passes have turns of {least:.5g} to {most:.5g} s: no one free rotation holds over them, and none was looked for; "
            "search one pass to look for it"
        )
    if free:
        tumbles = kept.of("free", Tumble, lambda: _tumbling(rows, body, low, high, dof, steady, say))
        if not tumbles:
            warnings.append("no pair of frequencies of a free rotation explains the light")
        tumbles = [one for one in tumbles if one.chi2 < steady - CHANGED]
    if rows.passes > 1 and symmetry % 2 and not tilted:
        say("sides of each pass", 0.0)
        wide = (low * (1 - 1e-9), high * (1 + 1e-9))
        locals_ = [*_sides_taken(rows, refiner, locals_[0], symmetry, wide), *locals_[1:]]
    say("model", 0.0)
    found = [fitted(tumbling_trial(scene, recording, rows, one), recording) for one in tumbles]
    if not any(_explains(one, rows) for one in found):
        more, told = _fitted(scene, recording, rows, locals_, symmetry, tilted, (low, high), say)
        found += more
        warnings += told
    found = [one for one in found if math.isfinite(one.chi2)]
    modes, loose = merged(found, rows), []
    if len(np.unique(recording.night[rows.index.numpy()])) > 1 and _unjoined(found, rows):
        apart, sharp = _apart(scene, recording, rows, locals_, found, tilted, say)
        if sharp:
            joined, told = _fitted(
                scene, recording, rows, sharp, symmetry, tilted, (low, high), say, changing=True
            )
            found = joined + [one for one in found if not any(_one_turn(one, other) for other in joined)]
            warnings += told
            modes = merged(found, rows)
        loose = merged(apart, rows)
        if loose and _one_rate_fails(apart, found, rows):
            if modes:
                warnings.append(
                    f"no one rotation holds over the nights: the best leaves {modes[0].rms:.3g} mag rms, that with "
                    f"{' and '.join(loose[0].apart)} of each night for itself {loose[0].rms:.3g} mag"
                )
            modes, loose = loose, []
    if not modes:
        raise InputError(
            recording.source,
            None,
            f"no rotation of {1 / high:.6g} to {1 / low:.6g} s a turn that joins the passes and that the model can fit",
            "a wider range of periods (--shortest, --longest), or passes nearer to each other",
        )
    left = len(rows.flux) - len(modes[0].theta)
    noise = None if rows.noise is None else MAG_PER_LN * rows.noise
    decided, words = verdict(modes, left, rows.passes, float(rows.span.max()), noise)
    order = {tuple(one.pole.tolist()): one.misfit for one in states}
    misfits = np.array([order[tuple(one.tolist())] for one in poles])
    connected = rows.passes == 1 or (modes[0].possible == 1 and not modes[0].apart)
    return RotationSearch(
        modes, len(rows.flux), left, rows.passes, symmetry, (1 / high, 1 / low), frequency, power,
        (poles.numpy(), misfits), connected, decided, words, recording, tuple(dict.fromkeys(warnings)), loose,
    )  # fmt: skip


def _changed(rows: Rows, best: Local) -> bool:
    """Whether passes are so far apart that their periods may differ by UNLIKE, and those of the best turn do: free of torques the
    frequencies of a body are the same in every pass."""
    return pole_grid.DRIFT_SD * float(rows.drift.max()) > UNLIKE and not alike(best)


def _explains(one: Candidate, rows: Rows) -> bool:
    """Whether a fit leaves little enough that no other kind of rotation is asked for. Errors that are fitted bring chi-square to
    the count of rows whatever is left, so there the rms is held against the noise of successive rows."""
    if rows.noise is None:
        return one.chi2 <= 2 * len(rows.flux)
    return one.rms <= NOISY * MAG_PER_LN * rows.noise


def _unjoined(found: Sequence[Candidate], rows: Rows) -> bool:
    """Whether the best of the rotations that join the passes takes one of several counts for granted, or leaves structure."""
    best = min(found, key=lambda one: one.deviance, default=None)
    if best is None or not _fits(best, rows):
        return True
    return "nutation" not in best.numbers and (best.trial.possible > 1 or not best.trial.complete)


def _fits(one: Candidate, rows: Rows) -> bool:
    noise = None if rows.noise is None else MAG_PER_LN * rows.noise
    return fits_the_rows(one.chi2, one.rms, len(rows.flux) - len(one.theta), noise)


def _apart(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    locals_: Sequence[Local],
    found: Sequence[Candidate],
    tilted: bool,
    say: Progress,
) -> tuple[list[Candidate], list[Local]]:
    """The model fitted at the leading poles with a phase for each night; where the passes have unlike periods, or one for all leaves
    structure, with a period for each too. Where a count of turns explains the light, also the solutions with the phases and periods of
    the passes as the model has them, by which fewer counts are possible than by the light of facets."""
    explained = any(_fits(one, rows) for one in found)
    fits: list[Candidate] = []
    sharp: list[Local] = []
    tried = locals_[: APART if explained else LOCALS]
    for number, local in enumerate(tried):
        if number and local.chi2 > 1.5 * locals_[0].chi2 + 200:
            break
        enough = False
        for periods in (False, True):
            if (not periods and not alike(local)) or (enough and not explained):
                continue
            trial = loose_trial(scene, recording, rows, local, periods=periods, tilted=tilted)
            one = fitted(trial, recording)
            if not math.isfinite(one.chi2):
                continue
            if not enough:
                fits.append(one)
                enough = _fits(one, rows)
            better = sharpened(recording, rows, local, one) if periods and explained else None
            sharp += [] if better is None else [better]
        say("nights apart", (number + 1) / len(tried))
    return fits, sharp


def _one_turn(one: Candidate, other: Candidate) -> bool:
    """Whether two fits of a turn about an axis are of one pole and period."""
    return (
        "nutation" not in one.numbers
        and apart_deg(one.pole, other.pole) < SAME_DEG
        and abs(one.numbers["period"] / other.numbers["period"] - 1) < SAME_PERIOD
    )


def _one_rate_fails(apart: Sequence[Candidate], found: Sequence[Candidate], rows: Rows) -> bool:
    """Whether nights by themselves are so much better than joined that no rotation joins them: where that leaves structure, by
    CHANGED for each further number."""
    if not found or not apart:
        return not found
    best = min(found, key=lambda one: one.deviance)
    loose = min(apart, key=lambda one: one.deviance)
    further = max(1, len(loose.theta) - len(best.theta))
    return not _fits(best, rows) and loose.deviance < best.deviance - CHANGED * further


def _whole_steps(symmetry: int) -> int:
    """The part of a turn that the grid searches: one of which its steps are a multiple."""
    return max(m for m in range(1, symmetry + 1) if symmetry % m == 0 and (pole_grid.STEPS // 2) % m == 0)


def _range(
    scene: Scene, recording: Recording, rows: Rows, shortest: float | None, longest: float | None
) -> tuple[float, float, list[str]]:
    """Lowest and highest frequency of turns, 1/s."""
    for name, value in (("--shortest", shortest), ("--longest", longest)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(None, name, f"{value:g} s", "a number > 0")
    period = scene.attitude.period
    bounds = (period.low, period.high) if isinstance(period, Free) else (None, None)
    cadence = float(np.median(np.diff(np.unique(rows.seconds.numpy()))))
    warnings = []
    first = shortest or (3600 * bounds[0] if bounds[0] else 2 * cadence)
    last = longest or (3600 * bounds[1] if bounds[1] else float(rows.span.max()))
    change = min(MOST_CHANGE, pole_grid.DRIFT_SD * float(rows.drift.max()))
    if bounds[0] and shortest is None:
        first /= 1 + change
    if bounds[1] and longest is None:
        last *= 1 + change
    if not isinstance(period, Free) and shortest is None and longest is None:
        warnings.append(
            f"the scene's period is fixed: all from {first:.4g} to {last:.4g} s were looked at, not only that"
        )
    if not first < last:
        raise InputError(
            recording.source,
            "--shortest, --longest",
            f"periods from {first:.4g} to {last:.4g} s",
            "a range of periods",
        )
    return 1 / last, 1 / first, warnings


def _tilted(
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
    tilts = [sign * angle * eye[one] for sign in (1.0, -1.0) for one in free]
    generator = torch.Generator().manual_seed(0)
    ways = torch.nn.functional.normalize(
        torch.randn(2, 40, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    exponent = torch.full((40, sum(body.lobed)), 3.0, dtype=torch.float64)
    plain = body.light(ways[0], ways[1], exponent)
    near = torch.stack([one.pole for one in states[: max(12, count // 4)]])
    best = torch.tensor([one for state in states[:3] for one in state.frequencies], dtype=torch.float64)
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
    return _distinct(
        Refiner(rows, body, FLOOR, tilted=free_tilts(body)).refined(starts, turned, iterations=40)
    )


def _unlike(
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
    poles = torch.stack([one.pole for one in states])  # all: a body of one paint may have liked other poles
    known = [one * part for state in states[:3] for one in state.frequencies for part in (1.0, 0.5, 2.0)]
    around = (torch.tensor(known, dtype=torch.float64)[:, None] + offsets).reshape(-1)
    around = torch.unique((around / step).round()) * step
    around = around[(around >= bounds[0]) & (around <= bounds[1])]
    starts = pole_grid.search(rows, painted, poles, around)[: max(8, count // 4)]
    still = torch.zeros(3, dtype=torch.float64)
    found = _distinct(Refiner(rows, painted, FLOOR).refined(starts, [still] * len(starts)))

    def mean(values: Tensor) -> Tensor:
        return values.reshape(2, -1).mean(0)

    diffuse = len(painted.names)
    return [
        replace(
            one,
            exponents=mean(one.exponents),
            weights=torch.cat([mean(one.weights[:diffuse]), mean(one.weights[diffuse:])]),
        )
        for one in found
    ]


def _sides_taken(
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
        one
        for one in refiner.refined(starts, [best.tilt] * len(starts))
        if one.chi2 < best.chi2 + KEPT_CHI2 and apart_deg(one.pole, best.pole) < ALIKE_DEG
    ]

    def joins(one: Local) -> float:
        steady, drifting = (
            min(
                (
                    way.distance
                    for way in connections(rows, one, symmetry, changing=changing, bounds=bounds).found
                ),
                default=math.inf,
            )
            for changing in (False, True)
        )
        return one.chi2 + min(steady, drifting + CHANGED)

    return sorted([best, *others], key=joins)[:SIDES] if others else [best]


def _distinct(found: Sequence[Local]) -> list[Local]:
    """Solutions of different poles or periods, best first."""
    kept: list[Local] = []
    for one in found:
        if not math.isfinite(one.chi2):
            continue
        if all(
            apart_deg(one.pole, other.pole) > SAME_DEG or abs(one.frequency / other.frequency - 1) > 1e-3
            for other in kept
        ):
            kept.append(one)
    return kept


def _tumbling(
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
    found = refiner.refined(
        _spread_out(first, TUMBLE_STARTS), progress=lambda share: say("their bodies", share)
    )
    if found and found[0][0].chi2 < about_an_axis - CHANGED:
        # the bodies are known now, but for which axis is which; with them the grid tells directions of the angular momentum apart
        for state in _distinct_tumbles(found, TUMBLES):
            axes = torch.tensor(list(itertools.permutations(range(3))))
            moments = state.moments[axes]
            states = tumble_grid.search(
                rows, body, [state.pair], moments / moments[:, 2:], kept=SECOND_STARTS // 3
            )
            found += refiner.refined(states[:SECOND_STARTS], progress=lambda share: say("their poles", share))
    found.sort(key=lambda one: one[0].chi2)
    kept: list[tuple[Tumble, Tensor, Tensor]] = []
    for one in found:
        if len(kept) < TUMBLES and all(not _same(one[0], other[0]) for other in kept):
            kept.append(one)
    joined = []
    for one in kept:
        if one[0].chi2 < 1.5 * kept[0][0].chi2 + 200:
            # light of flat facets is that of the model, but for shadows, which a good fit says there are none of
            last = TumbleRefiner(rows, body, SHARP if one[0].chi2 < dof else FLOOR)
            joined += last.joined(last.settled(one))[:TUMBLES]
    joined.sort(key=lambda one: one.chi2)
    return [one for one in joined if one.chi2 < joined[0].chi2 + 2 * KEPT_CHI2]


def _spread_out(states: Sequence[TumbleState], most: int) -> list[TumbleState]:
    """The best states, OF_A_BODY of each body with each pair of frequencies."""
    kept: list[TumbleState] = []
    count: Counter[tuple[float, ...]] = Counter()
    for one in states:
        key = (one.long, one.nutation, *one.moments.tolist())
        if len(kept) < most and count[key] < OF_A_BODY:
            count[key] += 1
            kept.append(one)
    return kept


def _distinct_tumbles(found: Sequence[tuple[Tumble, Tensor, Tensor]], most: int) -> list[Tumble]:
    """The best solutions of different bodies."""
    kept: list[Tumble] = []
    for one, _, _ in found:
        if len(kept) < most and all(
            bool(((one.moments - other.moments).abs() > 0.05).any()) for other in kept
        ):
            kept.append(one)
    return [one for one in kept if one.chi2 < 2 * kept[0].chi2]


def _same(one: Tumble, other: Tumble) -> bool:
    """Whether two solutions are one: of a pole, a body and periods."""
    return (
        apart_deg(one.pole, other.pole) < SAME_DEG
        and abs(one.long / other.long - 1) < 1e-3
        and bool(((one.moments - other.moments).abs() < 0.02).all())
    )


def _fitted(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    locals_: Sequence[Local],
    symmetry: int,
    tilted: bool,
    bounds: tuple[float, float],
    say: Progress,
    *,
    changing: bool = False,
) -> tuple[list[Candidate], list[str]]:
    """The model fitted at the solutions and counts of turns that may be right, and what there is to say. ``changing``: a change of the
    period is tried even where a steady turn explains the light."""
    told: list[str] = []
    rate = scene.attitude.period_rate
    may_change = isinstance(rate, Free) or rows.passes > 2
    always = changing or isinstance(rate, Free)
    wide = (bounds[0] * (1 - 1e-9), bounds[1] * (1 + 1e-9))
    epoch = epoch_seconds(scene, recording)[1]
    tasks: list[Trial] = []
    for number, local in enumerate(locals_[:LOCALS]):
        if number and local.chi2 > 1.5 * locals_[0].chi2 + 200:
            break
        changes = connections(rows, local, symmetry, changing=True, bounds=wide) if rows.passes > 1 else None
        for drifts in (False, True) if may_change else (False,):
            joined = changes if drifts and changes else connections(
                rows, local, symmetry, changing=False, bounds=wide
            )  # fmt: skip
            if not drifts and may_change and joined.found and joined.found[0].distance > UNSTEADY:
                continue  # no steady spin has these phases
            near = [one for one in joined.found if one.distance < joined.found[0].distance + KEPT_CHI2]
            # of counts that are some of many, one fit tells what any leaves
            tried = JOINED if number == 0 and joined.complete else 1
            for one in near[:tried]:
                trial = steady_trial(
                    scene, recording, rows, local, one, symmetry, changing=drifts, tilted=tilted
                )
                tasks.append(_with_spread(trial, one, near, joined, changes, symmetry, epoch))
    if not tasks:
        told.append(
            "no count of turns between the passes joins their phases to one rotation within its bounds"
        )
    found: list[Candidate] = []
    for number, trial in enumerate(tasks):
        if trial.changing and not always and found and not _wanting(found, rows):
            continue
        found.append(fitted(trial, recording))
        say("model", (number + 1) / len(tasks))
    if found and not found[0].trial.complete:
        told.append(
            "the passes are too far apart for their phases to be connected: the counts of turns between them that are "
            "told are some of many"
        )
    return found, told


def _with_spread(
    trial: Trial,
    one: Connection,
    near: Sequence[Connection],
    joined: Connections,
    changes: Connections | None,
    symmetry: int,
    epoch: float,
) -> Trial:
    """A trial with what the counts of turns that are as possible leave open of its period, at the ``epoch`` in seconds of the rows,
    and of its rate. Where the period is taken as steady, the rate that would not show is that of all counts with one."""
    chances = _chances(near)
    spread: dict[str, float] = {}
    if len(near) > 1:
        periods = np.array([_period_at(other, epoch) for other in near]) / 3600
        spread["period"] = float(np.sqrt(chances @ (periods - _period_at(one, epoch) / 3600) ** 2))
    if changes is not None and changes.found:
        most = [other for other in changes.found if other.distance < changes.found[0].distance + KEPT_CHI2]
        rates = np.array([_rate(other) for other in most])
        spread["period_rate"] = float(np.sqrt(_chances(most) @ (rates - _rate(one)) ** 2))
    base = np.array(differences(one.counts, symmetry))
    likely = tuple(
        Count(
            tuple((np.array(differences(other.counts, symmetry)) - base).tolist()),
            float(chance),
            _period_at(other, epoch),
            _rate(other),
        )
        for other, chance in list(zip(near, chances, strict=True))[:LIKELY]
    )
    return replace(
        trial,
        possible=max(1, len(near)),
        complete=joined.complete or len(near) < len(joined.found),
        spread=spread,
        likely=likely if len(near) > 1 else (),
    )


def _period_at(one: Connection, seconds: float) -> float:
    """Period, s, at a time in seconds of the rows."""
    return 1 / (one.frequency + one.change * (seconds - one.middle))


def _chances(near: Sequence[Connection]) -> np.ndarray:
    """Probabilities of counts of turns by the distances of their phases."""
    weight = np.exp(-0.5 * (np.array([one.distance for one in near]) - near[0].distance))
    return weight / weight.sum()


def _rate(one: Connection) -> float:
    """Change of the period, ms a day."""
    return -one.change / one.frequency**2 * 86400e3


def _wanting(found: Sequence[Candidate], rows: Rows) -> bool:
    """Whether steady spin leaves more than the errors allow: chi-square beyond 3 of its standard deviations."""
    least = (
        min(one.chi2 for one in found if not one.trial.changing)
        if any(not one.trial.changing for one in found)
        else math.inf
    )
    count = len(rows.flux)
    return least > count + 3 * math.sqrt(2 * count)
