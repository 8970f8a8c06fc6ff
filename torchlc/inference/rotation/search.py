"""From a scene and a recording to rotation states: the periods to look at, a grid of poles, least squares, the counts of
turns between passes, and the model with everything in it. What turns about no axis fixed in it is looked for where that leaves
structure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.errors import InputError
from torchlc.files.steps import Steps
from torchlc.inference.budget import Budget
from torchlc.inference.likelihood import MAG_PER_LN
from torchlc.inference.rotation import pole_grid
from torchlc.inference.rotation.connect import Connection, Connections, connections, differences
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.kinds import (
    FLOOR,
    STEPS_A_TURN,
    Progress,
    distinct,
    free_rotations,
    sides_taken,
    tilted_bodies,
    unlike_sides,
)
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
from torchlc.inference.rotation.refine import Local, Refiner
from torchlc.inference.rotation.tumble_refine import Tumble
from torchlc.inference.rotation.windows import windows
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Free, Scene

POLES = 500
FITS = "fits of the model to the less likely"
STARTS_S, START_S, PAIR_S = 14.0, 0.06, 2.2e-7
"""CPU seconds for the first least squares, of a start, and of each pair of row and facet and coordinate of a start, as measured on one
core."""
LEAST_STARTS, MOST_STARTS = 24, 200
LOCALS, JOINED = 4, 3
"""Solutions of different poles, and counts of turns of the best, that the model is fitted to."""
APART = 2
"""Poles at which the model is fitted with a phase for each night too, where counts of turns explain the light already."""
LIKELY = 12
"""Counts of turns that are told of a mode, if its phases leave several."""
STRUCTURE = 1.25
"""Chi-square a degree of freedom above which a body is tried with its axes tilted, and then without an axis of its spin."""
UNSTEADY = 150.0
"""Squared distance, in standard deviations, of the phases from any steady spin beyond which the model is not tried on one."""
UNLIKE = 0.01
"""Relative difference that the periods of passes may have, from which on these are asked before a free rotation. Nights of two weeks are
below it, so what tumbles is not taken for what changes."""
MIN_ROWS = 12
MOST_CHANGE = 0.1
"""Relative change of a period between passes up to which the scene's bounds, which are of its epoch, are widened: rocket bodies
change by 5 % in six years."""


def search_rotation(
    scene: Scene,
    recording: Recording,
    *,
    shortest_s: float | None = None,
    longest_s: float | None = None,
    progress: Progress | None = None,
    steps: Steps | None = None,
    budget_s: float | None = None,
) -> RotationSearch:
    """Rotation states of a body: about a direction fixed in it and in space, or, where that leaves structure, free.

    ``budget_s``: CPU seconds after which no further stage is begun; then nothing is decided, and what was left out is said.
    """
    say = progress or (lambda _text, _share: None)
    allowed = _Allowed(budget_s)
    kept = steps or Steps()
    model = LightCurve(*_checked(scene, recording))
    rows = _enough(rows_of(model), recording)
    body = FacetLight.of(model.assembly)
    low, high, warnings = _range(scene, recording, rows, shortest_s, longest_s)
    warnings += body.notes
    ranges, frequency, power = windows(rows, low, high)
    step = 1 / (STEPS_A_TURN * float(rows.span.max()))
    grid = torch.cat(
        [torch.linspace(a, b, max(2, math.ceil((b - a) / step) + 1), dtype=torch.float64) for a, b in ranges]
    )
    poles = pole_grid.directions(POLES)
    refiner = Refiner(rows, body, FLOOR)
    turns = _turns(scene, rows, body, poles, grid, (low, high), refiner, kept, allowed, say)
    locals_, tilted, symmetry = turns.best, turns.tilted, turns.symmetry
    warnings += turns.told
    steady, dof = locals_[0].chi2, turns.dof  # the best that a turn about one axis does
    tumbles: list[Tumble] = []
    free = scene.attitude.mode == "rigid-body" or steady / dof > STRUCTURE
    if free and _changed(rows, locals_[0]):
        free = False
        least, most = (1 / float(one) for one in (locals_[0].frequencies.max(), locals_[0].frequencies.min()))
        warnings.append(
            f"the passes have turns of {least:.5g} to {most:.5g} s: no one free rotation holds over them, and none was looked for; "
            "search one pass to look for it"
        )
    if free and allowed("free rotations"):
        tumbles = kept.of("free", Tumble, lambda: free_rotations(rows, body, low, high, dof, steady, say))
        if not tumbles:
            warnings.append("no pair of frequencies of a free rotation explains the light")
        tumbles = [one for one in tumbles if one.chi2 < steady - CHANGED]
    if rows.passes > 1 and symmetry % 2 and not tilted:
        say("sides of each pass", 0.0)
        wide = (low * (1 - 1e-9), high * (1 + 1e-9))
        locals_ = [*sides_taken(rows, refiner, locals_[0], symmetry, wide), *locals_[1:]]
    say("model", 0.0)
    found: list[Candidate] = []
    for one in tumbles:
        if not _any_finite(found) or allowed(FITS):
            found.append(fitted(tumbling_trial(scene, recording, rows, one), recording))
    if not any(_explains(one, rows) for one in found):
        more, told = _fitted(scene, recording, rows, locals_, symmetry, tilted, (low, high), allowed, say)
        found += more
        warnings += told
    found = [one for one in found if math.isfinite(one.chi2)]
    modes, loose = merged(found, rows), []
    several = len(np.unique(recording.night[rows.index.numpy()])) > 1 and _unjoined(found, rows)
    if several and allowed("each night for itself"):
        apart, sharp = _apart(scene, recording, rows, locals_, found, tilted, say)
        if sharp:
            joined, told = _fitted(
                scene, recording, rows, sharp, symmetry, tilted, (low, high), allowed, say, changing=True
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
            "a wider range of periods (--shortest, --longest), or passes nearer to each other"
            + (", or a longer --budget" if allowed.omitted else ""),
        )
    left = len(rows.flux) - len(modes[0].theta)
    noise = None if rows.noise is None else MAG_PER_LN * rows.noise
    decided, words = verdict(modes, left, rows.passes, float(rows.span.max()), noise)
    if allowed.omitted:
        decided, words = False, allowed.told(words)
    order = {tuple(one.pole.tolist()): one.misfit for one in turns.states}
    misfits = np.array([order[tuple(one.tolist())] for one in poles])
    connected = rows.passes == 1 or (modes[0].possible == 1 and not modes[0].apart)
    return RotationSearch(
        modes, len(rows.flux), left, rows.passes, symmetry, (1 / high, 1 / low), frequency, power,
        (poles.numpy(), misfits), connected, decided, words, recording, tuple(dict.fromkeys(warnings)), loose,
    )  # fmt: skip


def _checked(scene: Scene, recording: Recording) -> tuple[Scene, Recording]:
    """The same; InputError where the scene's attitude is none that a search can begin at."""
    if scene.attitude.mode not in ("spin-pole", "rigid-body"):
        raise InputError(
            scene.source,
            "attitude.mode",
            f'"{scene.attitude.mode}"',
            '"spin-pole" (pole, period, phase, epoch), whose numbers are where the search starts',
        )
    return scene, recording


def _enough(rows: Rows, recording: Recording) -> Rows:
    """The same; InputError where they are too few, or a pass is of one row."""
    if len(rows.flux) < MIN_ROWS:
        raise InputError(
            recording.source,
            None,
            f"{len(rows.flux)} measured rows",
            f"at least {MIN_ROWS} to find a rotation",
        )
    if not float(rows.span.max()) > 0:
        raise InputError(recording.source, "column time", "passes of one row each", "a stretch of time")
    return rows


class _Allowed:
    """Whether a stage may begin within a budget of CPU seconds, and which ones that were due did not."""

    def __init__(self, seconds: float | None) -> None:
        self.budget = Budget(seconds)
        self.omitted: list[str] = []

    def __call__(self, stage: str) -> bool:
        if self.budget.left():
            return True
        if stage not in self.omitted:
            self.omitted.append(stage)
        return False

    def told(self, words: str) -> str:
        """The verdict of what was looked at, after what was not."""
        seen = words.removeprefix("cannot tell: ")
        return f"cannot tell: the budget of {self.budget.seconds:g} CPU s left out {', '.join(self.omitted)}; of what was looked at: {seen}"


@dataclass(frozen=True)
class _Turns:
    """Turns about an axis fixed in the body: what the grid of poles gave, the solutions, best first, whether the axis may be tilted
    against the body's, how many turns within one look alike, degrees of freedom, and what has to be said."""

    states: list[GridState]
    best: list[Local]
    tilted: bool
    symmetry: int
    dof: int
    told: list[str]


def _turns(
    scene: Scene,
    rows: Rows,
    body: FacetLight,
    poles: Tensor,
    grid: Tensor,
    bounds: tuple[float, float],
    refiner: Refiner,
    kept: Steps,
    allowed: _Allowed,
    say: Progress,
) -> _Turns:
    """From a grid of poles and frequencies to solutions by least squares; where these leave structure, of tilted bodies and of bodies
    whose sides shine unlike too."""
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    symmetry = body.symmetry(axis)
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
    best = kept.of(
        "least squares",
        Local,
        lambda: distinct(refiner.refined(states[:count], [still] * len(states[:count]))),
    )
    told: list[str] = []
    dof = max(1, len(rows.flux) - 2 * rows.passes - 4)
    given = "tilt" in scene.attitude.model_fields_set
    tilted = given
    if tilted or (best[0].chi2 / dof > STRUCTURE and allowed("tilted bodies")):
        say("tilted bodies", 0.0)
        slanted = kept.of(
            "tilted", Local, lambda: tilted_bodies(rows, body, poles, grid, states, count, axis)
        )
        if slanted and slanted[0].chi2 < best[0].chi2 - CHANGED:
            best, tilted, symmetry = slanted, True, 1
    steady = best[0].chi2
    if steady / dof > STRUCTURE and body.symmetry(axis) > 1 and allowed("sides of unlike paint"):
        say("unlike sides", 0.0)
        unlike = kept.of("unlike", Local, lambda: unlike_sides(rows, body, states, bounds, count))
        if unlike and unlike[0].chi2 < steady - CHANGED * sum(body.unlike_halves().lobed):
            told.append(
                f"sides half a turn apart shine unlike: with paint of their own a turn in {1 / unlike[0].frequency:.6g} s leaves "
                f"chi-square {unlike[0].chi2:.0f} where the scene's materials leave {steady:.0f}; give such faces materials of "
                "their own (sectors and face_materials of a cylinder, face_materials of a box)"
            )
            best, symmetry, tilted = unlike, 1, given
    return _Turns(states, best, tilted, symmetry, dof, told)


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


def _any_finite(found: Sequence[Candidate]) -> bool:
    """Whether a fit has a chi-square; one whose light is nowhere has none."""
    return any(math.isfinite(one.chi2) for one in found)


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


def _fitted(
    scene: Scene,
    recording: Recording,
    rows: Rows,
    locals_: Sequence[Local],
    symmetry: int,
    tilted: bool,
    bounds: tuple[float, float],
    allowed: _Allowed,
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
        if _any_finite(found) and not allowed(FITS):
            break
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
