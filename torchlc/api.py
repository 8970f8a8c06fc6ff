"""The verbs: load, simulate, predict, visibility, fit, diagnose, rotation. Each takes paths or objects, checks everything before it works,
and returns one object.
"""

from __future__ import annotations

import hashlib
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch
from torch import Tensor

from torchlc.digits import against_freedom
from torchlc.effects import mending_kind
from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.files.reading import sha256_of
from torchlc.files.steps import EVERY_S, Steps
from torchlc.files.writing import (
    CHAIN_FILE,
    DIAGNOSIS_FILES,
    FIT_FILES,
    ROTATION_FILES,
    STEPS_FILE,
    OutputDirectory,
    resources,
    write_whole,
)
from torchlc.geometry.orbit import above_horizon, observation_grid, sun_elevation_deg
from torchlc.inference.budget import Budget
from torchlc.inference.chain import check_origin, input_hashes, read_chain
from torchlc.inference.identifiability import limits
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, fit_map
from torchlc.inference.posterior_draws import Posterior
from torchlc.inference.sampler import sample
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.kind import NoiseKind
from torchlc.readers import Recording, recording_of, too_few_rows
from torchlc.readers.column_limits import LIMITS
from torchlc.results.fit_result import FitResult
from torchlc.results.simulated_curve import SimulatedCurve, simulated_curve
from torchlc.scene import Scene, Station, load_scene
from torchlc.tensors.moving import on_cpu
from torchlc.version import __version__

if TYPE_CHECKING:
    from torchlc.diagnosis.result import Diagnosis
    from torchlc.prediction.result import Prediction
    from torchlc.prediction.visibility import Visibility
    from torchlc.results.rotation_result import RotationResult

Progress = Callable[[str, float], None]
Rows = Any
"""What holds a recording: a path, a Recording, astropy's Table or TimeSeries, a LightCurve of lightkurve, a DataFrame of
pandas, or a mapping of columns (arrays, quantities, instants)."""
Columns = str | Mapping[str, Any] | None
"""Which column is what: "time=JD_UTC,mag=V", or a mapping; over the table [recording] of the scene."""
DOUBTFUL_P = 1e-3
"""Below this probability of chi-square, quoted errors get a jitter added to them."""
SEARCH_SHARE = 0.4
"""Of what is left of a budget, for a search; the chain has the rest."""
DEMO_STEPS = 1000
"""The demo took 66 CPU seconds with these, on a machine that had other work; a chain until it has converged took 13,200 and 282."""
MIN_ROWS = 2


@overload
def load(
    scene: str | Path | Scene,
    recording: None = None,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> Scene: ...
@overload
def load(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> tuple[Scene, Recording]: ...
@on_cpu
def load(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
) -> Scene | tuple[Scene, Recording]:
    """Read a scene, or a scene and a recording, and check them.

    A recording is a path, or what holds its rows in memory: astropy's Table or TimeSeries, a LightCurve of lightkurve, a
    DataFrame of pandas, or a mapping of arrays, quantities and instants. ``use`` picks "mag" or "flux" of one that has
    both. ``columns`` says which column is what ("time=JD_UTC,mag=V", or a mapping). ``trust`` lets the scene name files
    outside its own folder.
    """
    read = _scene(scene, trust)
    return read if recording is None else (read, recording_of(recording, read, use=use, columns=columns))


@on_cpu
def simulate(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    start: str | float | None = None,
    hours: float | None = None,
    cadence: float | None = None,
    noise: float | None = None,
    seed: int = 0,
    columns: Columns = None,
    trust: bool = False,
) -> SimulatedCurve:
    """The light curve of a scene at a recording's rows, or for ``hours`` from ``start`` (ISO UTC or JD)
    every ``cadence`` seconds.

    Free numbers have their scene's values. ``noise`` (mag) makes a recording of it: normal errors, quoted,
    and on top what noise effects of the scene say (jitter, say), unquoted.
    """
    scene = _scene(scene, trust)
    rows = _grid_or(scene, recording, start, hours, cadence, columns)
    low, high = LIMITS["mag_err"]
    if noise is not None and not low <= noise <= high:
        raise InputError(None, "--noise", f"{noise:g} mag", f"> 0: {low:g} to {high:g} mag")
    return simulated_curve(scene, rows, noise, seed)


@on_cpu
def predict(
    scene: str | Path | Scene | FitResult,
    *,
    elements: str | Path | None = None,
    stations: Sequence[Station] | None = None,
    date: str | None = None,
    start: str | float | None = None,
    hours: float | None = None,
    cadence: float = 10.0,
    elevation: float = 10.0,
    sun: float = -6.0,
    extinction: float = 0.0,
    scatter: float = 0.0,
    faintest: float | None = None,
    draws: int = 256,
    seed: int = 0,
    out: str | Path | None = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> Prediction:
    """How bright, and when: passes over stations in the dark, with magnitudes and their 68 and 95 % intervals.

    ``scene`` is a scene, whose priors are drawn from, or a fit or its directory, whose posterior is. ``elements``, a file
    of two-line elements of any number of objects, takes the place of the scene's orbit: every object is taken for one of
    the scene's shape and materials. ``stations`` take the place of the scene's. ``date`` is a night by its evening's date;
    or ``hours`` from ``start`` (ISO UTC or JD). Passes are above ``elevation`` deg while the Sun is below ``sun``, deg, on a
    grid of ``cadence`` s.

    ``extinction`` (mag an airmass) gives apparent magnitudes beside those outside the air. ``scatter`` (mag) is the
    standard deviation between objects of one kind, which the intervals hold. Passes fainter than ``faintest`` are left
    out. With ``out`` prediction.json, prediction.ecsv, passes.ecsv, passes.ics and passes.png are written there.
    """
    from torchlc.prediction import run as predicting
    from torchlc.prediction.passes import no_station
    from torchlc.prediction.posterior import read_fit
    from torchlc.prediction.result import PREDICTION_FILES

    wanted = predicting.Wanted(elevation, sun, extinction, scatter, faintest, draws, seed)
    predicting.check(wanted)
    read, posterior, inputs = read_fit(scene, lambda given: _scene(given, trust))
    places = list(read.stations if stations is None else stations)
    if not places:
        raise no_station(read.source)
    inputs += input_files(read) + ([] if elements is None else [Path(elements)])
    with ExitStack() as stack:
        directory = None
        if out is not None:
            directory = stack.enter_context(OutputDirectory(out, PREDICTION_FILES, inputs))
        stack.enter_context(resources(None if out is None else Path(out)))
        span = predicting.span_of(places, date, start, hours, cadence)
        if elements is None:
            orbiters, said = [predicting.orbiter_of(read, span)], []
        else:
            orbiters, said = predicting.orbiters_of(elements, span)
        found = predicting.run(read, orbiters, span, wanted, posterior, progress)
        found = replace(
            found,
            warnings=[*said, *found.warnings],
            provenance=made_with(
                {file.name: sha256_of(file) for file in inputs if file.is_file()}, seed, command
            ),
        )
        if directory is not None:
            found.write_into(directory)
    return found


@on_cpu
def visibility(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    start: str | float | None = None,
    hours: float | None = None,
    cadence: float | None = None,
    values: Mapping[str, Tensor] | None = None,
    towards: Mapping[str, Tensor] | None = None,
    trust: bool = False,
) -> Visibility:
    """Lit, seen, and lit-and-seen shares, and projected areas, of every component, at a recording's rows or for
    ``hours`` from ``start`` (ISO UTC or JD) every ``cadence`` seconds.

    Tensors in, tensors out: ``values`` puts tensors in place of numbers of the scene by full name ("panel.size_u"), and
    gradients reach them. ``towards`` names further directions, vectors (3,) or (T, 3) in GCRS; the velocity is one
    where it is known.
    """
    from torchlc.prediction.visibility import component_visibility

    scene = _scene(scene, trust)
    return component_visibility(scene, _grid_or(scene, recording, start, hours, cadence), values, towards)


@on_cpu
def fit(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    steps: int | None = None,
    walkers: int | None = None,
    budget: float | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> FitResult:
    """Fit the free numbers of a scene to a recording: Adam from many starts, a polish, then emcee.

    ``steps`` fixes the length of the chain, else it runs until long against its autocorrelation time;
    ``walkers`` defaults to 6 a parameter; ``budget`` is in CPU seconds of search and chain, after which the best so far is the
    answer, with a warning. With ``out`` everything is written there (fit.json, posterior.nc,
    chain.h5, figures, report.html), in place of what an earlier run wrote, and ``resume`` continues the chain
    found there. Nothing free: the model is evaluated and nothing is sampled.
    """
    watch = _Watch()
    scene = _scene(scene, trust)
    if resume and out is None:
        raise InputError(None, "--resume", "no output directory", "the directory of the run to continue")
    rows = usable(scene, recording, use=use, columns=columns)
    with ExitStack() as stack:
        later = {CHAIN_FILE} if resume else frozenset()
        directory = _held(stack, out, FIT_FILES - later, scene, rows)
        likelihood = Likelihood(LightCurve(scene, rows))
        _check_sampling(len(likelihood.model.names), steps, walkers)
        if resume and directory is not None:
            _check_chain(directory, scene, rows, seed)
        watch.lap("load")
        allowed = Budget(budget)
        found, warnings = _search(likelihood, rows, seed, allowed, progress)
        watch.lap("search")
        posterior = None
        if found.model.names:
            posterior = sample(
                found,
                walkers=walkers,
                steps=steps,
                seed=seed,
                chain_file=None if directory is None else directory.path / CHAIN_FILE,
                resume=resume,
                progress=progress,
                budget=allowed,
                write=write_whole if directory is None else directory.write_path,
            )
        watch.lap("sample")
        result = FitResult(
            fit=found,
            posterior=posterior,
            seconds=watch.seconds(),
            warnings=_remarks(found, posterior, warnings, kept=directory is not None),
            seed=seed,
            provenance=provenance(scene, rows, seed, command),
        )
        if directory is not None:
            from torchlc.report import fit_page as report

            report.write_fit(result, directory, progress)
    return result


@on_cpu
def diagnose(
    scene: str | Path | Scene,
    recording: Rows,
    *,
    quick: bool = False,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    budget: float | None = None,
    out: str | Path | None = None,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Say whether physics is missing from the scene's model, which, where, and what that changes.

    ``effects`` limits the candidates (noise is always among them); ``budget`` is in CPU seconds, after which the verdict
    says what was not examined; ``quick`` is a budget of 20 s. With ``out`` diagnosis.json, figures and report.html are
    written there, and a run that was killed goes on from what it had finished.
    """
    from torchlc.diagnosis.candidates import check_candidates
    from torchlc.diagnosis.run import diagnose as run

    scene = _scene(scene, trust)
    rows = usable(scene, recording, use=use, columns=columns)
    check_candidates(effects, assemble(scene, rows))
    with ExitStack() as stack:
        directory = _held(stack, out, DIAGNOSIS_FILES, scene, rows)
        steps = _steps(directory, scene, rows, repr((effects, seed)), EVERY_S)
        result = run(
            scene,
            rows,
            quick=quick,
            effects=effects,
            seed=seed,
            budget=budget,
            progress=progress,
            steps=steps,
        )
        if directory is not None:
            from torchlc.report.diagnosis_page import write_diagnosis

            write_diagnosis(result, provenance(scene, rows, seed, command), directory)
            directory.clear([STEPS_FILE])
    return result


@on_cpu
def rotation(
    scene: str | Path | Scene,
    *recordings: str | Path | Recording,
    shortest: float | None = None,
    longest: float | None = None,
    seed: int = 0,
    budget: float | None = None,
    out: str | Path | None = None,
    use: str | None = None,
    columns: Columns = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> RotationResult:
    """Rotation states of a body from one or more recordings: pole, period, phase, with all modes that fit.

    The scene gives shape, materials and, as bounds of its ``period``, where to look, unless ``shortest`` and ``longest``
    (s) do. ``budget`` is in CPU seconds, after which no further stage is begun and the verdict says what was left out. With
    ``out`` rotation.json, scene.toml of the best mode and figures are written there, and a run that was killed goes on from the
    last stage that it had finished. ``columns`` says which column is what in every recording.
    """
    from torchlc.inference.rotation.search import search_rotation
    from torchlc.readers.joining import joined
    from torchlc.results.rotation_result import RotationResult

    began = time.monotonic()
    scene = _scene(scene, trust)
    if not recordings:
        raise InputError(None, None, "no recording", "one or more")
    each = [usable(scene, one, use=use, columns=columns) for one in recordings]
    rows = usable(scene, joined(each))
    with ExitStack() as stack:
        directory = None
        if out is not None:
            inputs = [
                *input_files(scene),
                *(Path(one) for one in recordings if not isinstance(one, Recording)),
            ]
            directory = stack.enter_context(OutputDirectory(out, ROTATION_FILES, inputs))
        stack.enter_context(resources(None if out is None else Path(out)))
        kept = _steps(directory, scene, rows, repr((shortest, longest)))
        search = search_rotation(
            scene,
            rows,
            shortest_s=shortest,
            longest_s=longest,
            progress=progress,
            steps=kept,
            budget_s=budget,
        )
        made = provenance(scene, rows, seed, command)
        made["inputs"] |= {
            f"recording {number}": provenance(scene, one, seed)["inputs"]["recording"]
            for number, one in enumerate(each[1:], 2)
            if one.source is not None and one.sha256 is not None
        }
        result = RotationResult(search, seed, time.monotonic() - began, made)
        if directory is not None:
            result.write(directory)
            directory.clear([STEPS_FILE])
    return result


def demo(
    out: str | Path, *, seed: int = 0, progress: Progress | None = None, command: str | None = None
) -> tuple[Diagnosis, FitResult]:
    """Diagnose the example that comes with the package, then fit it with what was named in the model; one
    report tells both.

    Its two files are put beside the results. The chain has ``DEMO_STEPS`` steps.
    """
    from torchlc.report import fit_page as report
    from torchlc.report.diagnosis_page import context

    source = Path(__file__).parent / "demo"
    files = source / "scene.toml", source / "recording.ecsv"
    copies = (file.name for file in files)
    with (
        OutputDirectory(out, {*FIT_FILES, *DIAGNOSIS_FILES, *copies}, files) as directory,
        resources(directory.path),
    ):
        found = diagnose(*files, quick=True, seed=seed, progress=progress)
        result = fit(
            found.completed, files[1], steps=DEMO_STEPS, seed=seed, progress=progress, command=command
        )
        for file in files:
            directory.write(file.name, lambda partial, file=file: shutil.copyfile(file, partial))
        made = {"provenance": dict(result.provenance)}
        directory.write_json("diagnosis.json", found.to_json() | made)
        report.write_fit(result, directory, progress, context(found))
    return found, result


def _steps(
    directory: OutputDirectory | None, scene: Scene, rows: Recording, settings: str, every_s: float = 0.0
) -> Steps:
    """What a search in a directory has finished; what is there of another scene, recording, setting or version is not known."""
    if directory is None:
        return Steps()
    columns = {
        one.name: value
        for one in fields(rows)
        if isinstance(value := getattr(rows, one.name), np.ndarray | tuple | str | bool)
    }
    first: Any = rows.time[0]
    content = [
        scene.to_toml().encode(),
        repr((first.scale, first.jd1, first.jd2, *columns)).encode(),
        *map(_bytes_of, columns.values()),
        settings.encode(),
        __version__.encode(),
    ]
    key = hashlib.sha256(b"".join(content)).hexdigest()
    return Steps(
        key, directory.path / STEPS_FILE, lambda fill: directory.write(STEPS_FILE, fill), every_s=every_s
    )


def _bytes_of(value: np.ndarray | tuple[str, ...] | str | bool) -> bytes:
    """What tells a value from another one. An array of objects, as of names of bands, has only their addresses among its bytes."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype != object else repr(value.tolist()).encode()
    return repr(value).encode()


def usable(scene: Scene, recording: Rows, *, use: str | None = None, columns: Columns = None) -> Recording:
    """The rows of a recording that a fit may use: at least two, and those below the horizon dropped and
    counted.
    """
    from torchlc.geometry.orbit import make_track

    recording = recording_of(recording, scene, use=use, columns=columns, min_rows=MIN_ROWS)
    with scene.reading():
        track = make_track(scene, recording)
    kept = recording.keep(above_horizon(track), "below the horizon")
    if len(kept) < MIN_ROWS:
        raise too_few_rows(kept.source, len(kept), kept.dropped, MIN_ROWS)
    told = _told_of_day(recording, sun_elevation_deg(track))
    return replace(kept, warnings=(*kept.warnings, told)) if told else kept


IN_DAYLIGHT_MAG = -3.0
"""Fainter than this hardly anybody records objects beside the Sun: Venus and the ISS at its brightest are brighter."""
BY_DAY = "the Sun is above the horizon"


def _told_of_day(recording: Recording, sun_deg: np.ndarray | None) -> str:
    """A warning where most rows were recorded by day, which is told once; else nothing."""
    if sun_deg is None or any(BY_DAY in text for text in recording.warnings):
        return ""
    by_day = int(np.count_nonzero(sun_deg > 0))
    bright = recording.kind == "mag" and np.median(recording.observed) < IN_DAYLIGHT_MAG
    if 2 * by_day <= len(recording) or bright:
        return ""
    return (
        f"{BY_DAY} of the station in {by_day} of {len(recording)} rows, {np.median(sun_deg):.0f} deg high in the middle row: "
        "are the times local or 12 h off, or has the longitude the wrong sign? East is positive"
    )


def provenance(scene: Scene, recording: Recording, seed: int, command: str | None = None) -> dict[str, Any]:
    """From what, with what and how a result was made: hashes of the bytes that were read of each input,
    versions, seed, command.
    """
    read = {
        "scene": (scene.source, scene.sha256),
        "recording": (recording.source, recording.sha256),
        **{place: (name, scene.hashes.get(name)) for place, name in scene.files().items()},
    }
    inputs = {
        name: {"file": Path(source).name, "sha256": digest}
        for name, (source, digest) in read.items()
        if source is not None and digest is not None
    }
    return made_with(inputs, seed, command)


def made_with(inputs: Mapping[str, Any], seed: int, command: str | None) -> dict[str, Any]:
    """Provenance of a result from these ``inputs``: with which versions, seed and command."""
    import astropy
    import emcee

    return {
        "inputs": dict(inputs),
        "versions": {
            "torchlc": __version__,
            "python": platform.python_version(),
            "torch": str(torch.__version__),
            "numpy": np.__version__,
            "astropy": str(astropy.__version__),
            "emcee": emcee.__version__,
        },
        "seed": seed,
        "command": command,
    }


def _held(
    stack: ExitStack, out: str | Path | None, writes: Iterable[str], scene: Scene, recording: Recording
) -> OutputDirectory | None:
    """The directory for the results of these inputs, held until the stack ends."""
    directory = None
    if out is not None:
        directory = stack.enter_context(OutputDirectory(out, writes, input_files(scene, recording)))
    stack.enter_context(resources(None if out is None else Path(out)))
    return directory


def input_files(scene: Scene, recording: Recording | None = None) -> list[Path]:
    """The files that scene and recording were read from, and those that the scene names."""
    sources = [scene.source, None if recording is None else recording.source]
    named = map(scene.file_path, scene.files().values())
    return [*(Path(source) for source in sources if source is not None), *named]


def _grid_or(
    scene: Scene,
    recording: Rows,
    start: str | float | None,
    hours: float | None,
    cadence: float | None,
    columns: Columns = None,
) -> Recording:
    """The rows of a recording, or of a grid of times."""
    if recording is None:
        if start is None or hours is None or cadence is None:
            raise InputError(
                None, None, "no recording, and not all of --start, --hours and --cadence", "one or the other"
            )
        return observation_grid(scene, start, hours, cadence)
    if start is not None or hours is not None or cadence is not None:
        raise InputError(None, None, "a recording and --start, --hours or --cadence", "one or the other")
    return recording_of(recording, scene, columns=columns)


def _scene(scene: str | Path | Scene, trust: bool) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene, trust=trust, known_effects=effect_names())


def _check_sampling(parameters: int, steps: int | None, walkers: int | None) -> None:
    if steps is not None and steps < 1:
        raise InputError(None, "--steps", str(steps), "at least 1")
    if walkers is not None and parameters and walkers < 2 * parameters + 2:
        raise InputError(
            None, "--walkers", str(walkers), f"at least {2 * parameters + 2} for {parameters} free parameters"
        )


def _check_chain(directory: OutputDirectory, scene: Scene, rows: Recording, seed: int) -> None:
    """InputError where the chain in a directory cannot be continued by a fit of these inputs."""
    chain = directory.path / CHAIN_FILE
    if (stored := read_chain(chain)) is not None:  # says more of what is wrong than the manifest can
        check_origin(chain, stored, {**input_hashes(scene, rows), "seed": seed})
    directory.check(CHAIN_FILE)


def _remarks(found: Fit, posterior: Posterior | None, of_search: Sequence[str], kept: bool) -> list[str]:
    """What has to be said of a fit: of its model, its data, its search and its chain, which a run can go on with if it
    is ``kept`` in a directory."""
    said = [*found.model.warnings, *found.warnings, *limits(found.model, found.theta), *of_search]
    said += found.likelihood.remarks(found.theta)
    if posterior is not None and not posterior.converged:
        more = "a longer --budget" if posterior.out_of_time else "more --steps"
        advice = f"run on with --resume and {more}" if kept else f"fit with {more.replace('--', '')}"
        said.append(f"the chain is short: {posterior.reason}: {advice}")
    if not found.converged:
        said.append(f"the search did not converge: {found.reason}")
    return said


class _Watch:
    """Wall-clock seconds of the parts of a run, one after another."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()
        self._parts: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """The part ``name`` ends here."""
        now = time.monotonic()
        self._parts[name], self._last = now - self._last, now

    def seconds(self) -> dict[str, float]:
        """Of each part, and their total."""
        return {**self._parts, "total": self._last - self._began}


def _search(
    likelihood: Likelihood, recording: Recording, seed: int, budget: Budget, progress: Progress | None
) -> tuple[Fit, list[str]]:
    """The maximum a posteriori; with the noise that mends it added to the model where chi-square says that the quoted
    errors are too small.
    """
    found = fit_map(likelihood, seed=seed, progress=progress, budget=budget.part(SEARCH_SHARE))
    effects = [effect.entry for effect in likelihood.model.effects]
    widened = any(isinstance(one, NoiseKind) and one.widens for one in likelihood.model.effects)
    cut = (
        budget.bounded and not found.converged
    )  # chi-square was still falling: it says nothing of the errors yet
    doubtful = recording.error is not None and found.p_value < DOUBTFUL_P and not widened and not cut
    if not doubtful:
        return found, []
    said = f"chi2 is {against_freedom(found.chi2, found.dof)} (p = {found.p_value:.1g})"
    if not likelihood.model.names:
        return found, [f"{said}: the model as it stands does not fit within the errors"]
    assembly = likelihood.model.assembly
    remedy = mending_kind().name
    mended = assemble(assembly.scene, recording, [*effects, remedy], base=assembly)
    model = LightCurve(assembly.scene, recording, assembly=mended)
    allowed = budget.part(SEARCH_SHARE)
    known = None
    if budget.bounded:  # there may be no time to come as far again
        before = dict(zip(found.model.names, found.theta, strict=True))
        start = model.parameter_set.start()
        known = torch.stack(
            [before.get(name, value) for name, value in zip(model.names, start, strict=True)]
        )[None]
    found = fit_map(Likelihood(model), seed=seed, extra_starts=known, progress=progress, budget=allowed)
    warning = f"{said}: a {remedy} was added to the errors; torchlc diagnose looks for what the model lacks"
    return found, [warning]
