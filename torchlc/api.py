"""The verbs: load, simulate, fit, diagnose, rotation. Each takes paths or objects, checks everything before it works,
and returns one object.
"""

from __future__ import annotations

import platform
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch

from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.files.writing import (
    CHAIN_FILE,
    DIAGNOSIS_FILES,
    FIT_FILES,
    ROTATION_FILES,
    OutputDirectory,
    resources,
    write_whole,
)
from torchlc.geometry.orbit import above_horizon, observation_grid
from torchlc.inference.chain import check_origin, input_hashes, read_chain
from torchlc.inference.identifiability import limits
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, fit_map
from torchlc.inference.sampler import sample
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, counted, load_recording
from torchlc.readers.reader import LIMITS
from torchlc.results.fit_result import FitResult
from torchlc.results.simulated_curve import SimulatedCurve, simulated_curve
from torchlc.scene import Scene, load_scene
from torchlc.version import __version__

if TYPE_CHECKING:
    from torchlc.diagnosis.result import Diagnosis
    from torchlc.results.rotation_result import RotationResult

Progress = Callable[[str, float], None]
DOUBTFUL_P = 1e-3
"""Below this probability of chi-square, quoted errors get a jitter added to them."""
MIN_ROWS = 2


@overload
def load(
    scene: str | Path, recording: None = None, *, use: str | None = None, trust: bool = False
) -> Scene: ...
@overload
def load(
    scene: str | Path | Scene, recording: str | Path, *, use: str | None = None, trust: bool = False
) -> tuple[Scene, Recording]: ...
def load(
    scene: str | Path | Scene,
    recording: str | Path | None = None,
    *,
    use: str | None = None,
    trust: bool = False,
) -> Scene | tuple[Scene, Recording]:
    """Read a scene, or a scene and a recording, and check them.

    ``use`` picks "mag" or "flux" of a recording that has both. ``trust`` lets the scene name files outside
    its own folder.
    """
    read = _scene(scene, trust)
    return read if recording is None else (read, load_recording(recording, read, use=use))


def simulate(
    scene: str | Path | Scene,
    recording: str | Path | Recording | None = None,
    *,
    start: str | float | None = None,
    hours: float | None = None,
    cadence: float | None = None,
    noise: float | None = None,
    seed: int = 0,
    trust: bool = False,
) -> SimulatedCurve:
    """The light curve of a scene at a recording's rows, or for ``hours`` from ``start`` (ISO UTC or JD)
    every ``cadence`` seconds.

    Free numbers have their scene's values. ``noise`` (mag) makes a recording of it: normal errors, quoted,
    and on top what noise effects of the scene say (jitter, red_noise, outliers), unquoted.
    """
    scene = _scene(scene, trust)
    if recording is None:
        if start is None or hours is None or cadence is None:
            raise InputError(
                None, None, "no recording, and not all of --start, --hours and --cadence", "one or the other"
            )
        rows = observation_grid(scene, start, hours, cadence)
    elif start is not None or hours is not None or cadence is not None:
        raise InputError(None, None, "a recording and --start, --hours or --cadence", "one or the other")
    else:
        rows = recording if isinstance(recording, Recording) else load_recording(recording, scene)
    low, high = LIMITS["mag_err"]
    if noise is not None and not low <= noise <= high:
        raise InputError(None, "--noise", f"{noise:g} mag", f"> 0: {low:g} to {high:g} mag")
    return simulated_curve(scene, rows, noise, seed)


def fit(
    scene: str | Path | Scene,
    recording: str | Path | Recording,
    *,
    steps: int | None = None,
    walkers: int | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = False,
    use: str | None = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> FitResult:
    """Fit the free numbers of a scene to a recording: Adam from many starts, a polish, then emcee.

    ``steps`` fixes the length of the chain, else it runs until long against its autocorrelation time;
    ``walkers`` defaults to 6 a parameter. With ``out`` everything is written there (fit.json, posterior.nc,
    chain.h5, figures, report.html), in place of what an earlier run wrote, and ``resume`` continues the chain
    found there. Nothing free: the model is evaluated and nothing is sampled.
    """
    began = time.monotonic()
    scene = _scene(scene, trust)
    if resume and out is None:
        raise InputError(None, "--resume", "no output directory", "the directory of the run to continue")
    rows = usable(scene, recording, use=use)
    with ExitStack() as stack:
        later = {CHAIN_FILE} if resume else frozenset()
        directory = _held(stack, out, FIT_FILES - later, scene, rows)
        likelihood = Likelihood(LightCurve(scene, rows))
        _check_sampling(len(likelihood.model.names), steps, walkers)
        chain = None if directory is None else directory.path / CHAIN_FILE
        if resume and directory is not None and chain is not None:
            if (stored := read_chain(chain)) is not None:  # says more of what is wrong than the manifest can
                check_origin(chain, stored, {**input_hashes(scene, rows), "seed": seed})
            directory.check(CHAIN_FILE)
        seconds = {"load": time.monotonic() - began}
        clock = time.monotonic()
        found, warnings = _search(likelihood, rows, seed, progress)
        seconds["search"] = time.monotonic() - clock
        clock = time.monotonic()
        posterior = None
        if found.model.names:
            posterior = sample(
                found,
                walkers=walkers,
                steps=steps,
                seed=seed,
                chain_file=chain,
                resume=resume,
                progress=progress,
                write=write_whole if directory is None else directory.write_path,
            )
        seconds["sample"] = time.monotonic() - clock
        seconds["total"] = time.monotonic() - began
        warnings += found.likelihood.remarks(found.theta)
        if posterior is not None and not posterior.converged:
            warnings.append(f"the chain is short: {posterior.reason}")
        if not found.converged:
            warnings.append(f"the search did not converge: {found.reason}")
        result = FitResult(
            fit=found,
            posterior=posterior,
            seconds=seconds,
            warnings=[
                *found.model.warnings,
                *found.warnings,
                *limits(found.model, found.theta),
                *warnings,
            ],
            seed=seed,
            provenance=provenance(scene, rows, seed, command),
        )
        if directory is not None:
            from torchlc.report import fit_page as report

            report.write_fit(result, directory, progress)
    return result


def diagnose(
    scene: str | Path | Scene,
    recording: str | Path | Recording,
    *,
    quick: bool = False,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    use: str | None = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Say whether physics is missing from the scene's model, which, where, and what that changes.

    ``effects`` limits the candidates (noise is always among them); ``quick`` does without the sampler and
    most refits. With ``out`` diagnosis.json, figures and report.html are
    written there.
    """
    from torchlc.diagnosis.candidates import check_candidates
    from torchlc.diagnosis.run import diagnose as run

    scene = _scene(scene, trust)
    rows = usable(scene, recording, use=use)
    check_candidates(effects, assemble(scene, rows))
    with ExitStack() as stack:
        directory = _held(stack, out, DIAGNOSIS_FILES, scene, rows)
        result = run(scene, rows, quick=quick, effects=effects, seed=seed, progress=progress)
        if directory is not None:
            from torchlc.report.diagnosis_page import write_diagnosis

            write_diagnosis(result, provenance(scene, rows, seed, command), directory)
    return result


def rotation(
    scene: str | Path | Scene,
    *recordings: str | Path | Recording,
    shortest: float | None = None,
    longest: float | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    use: str | None = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> RotationResult:
    """Rotation states of a body from one or more recordings: pole, period, phase, with all modes that fit.

    The scene gives shape, materials and, as bounds of its ``period``, where to look, unless ``shortest`` and ``longest``
    (s) do. With ``out`` rotation.json, scene.toml of the best mode and figures are written there.
    """
    from torchlc.inference.rotation.search import search_rotation
    from torchlc.readers.joining import joined
    from torchlc.results.rotation_result import RotationResult

    began = time.monotonic()
    scene = _scene(scene, trust)
    if not recordings:
        raise InputError(None, None, "no recording", "one or more")
    each = [usable(scene, one, use=use) for one in recordings]
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
        search = search_rotation(
            scene, rows, shortest_s=shortest, longest_s=longest, seed=seed, progress=progress
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
    return result


def demo(
    out: str | Path, *, seed: int = 0, progress: Progress | None = None, command: str | None = None
) -> tuple[Diagnosis, FitResult]:
    """Diagnose the example that comes with the package, then fit it with what was named in the model; one
    report tells both.

    Its two files are put beside the results.
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
        result = fit(found.completed, files[1], seed=seed, progress=progress, command=command)
        for file in files:
            directory.write(file.name, lambda partial, file=file: shutil.copyfile(file, partial))
        made = {"provenance": dict(result.provenance)}
        directory.write_json("diagnosis.json", found.to_json() | made)
        report.write_fit(result, directory, progress, context(found))
    return found, result


def usable(scene: Scene, recording: str | Path | Recording, *, use: str | None = None) -> Recording:
    """The rows of a recording that a fit may use: at least two, and those below the horizon dropped and
    counted.
    """
    from torchlc.geometry.orbit import make_track

    if not isinstance(recording, Recording):
        recording = load_recording(recording, scene, use=use, min_rows=MIN_ROWS)
    with scene.reading():
        track = make_track(scene, recording)
    kept = recording.keep(above_horizon(track), "below the horizon")
    if len(kept) < MIN_ROWS:
        found = f"{len(kept)} usable row" + (f" ({counted(kept.dropped)})" if kept.dropped else "")
        raise InputError(kept.source, None, found, f"at least {MIN_ROWS}")
    return kept


def provenance(scene: Scene, recording: Recording, seed: int, command: str | None = None) -> dict[str, Any]:
    """From what, with what and how a result was made: hashes of the bytes that were read of each input,
    versions, seed, command.
    """
    import astropy
    import emcee

    read = {
        "scene": (scene.source, scene.sha256),
        "recording": (recording.source, recording.sha256),
        **{place: (name, scene.hashes.get(name)) for place, name in scene.files().items()},
    }
    return {
        "inputs": {
            name: {"file": Path(source).name, "sha256": digest}
            for name, (source, digest) in read.items()
            if source is not None and digest is not None
        },
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


def _scene(scene: str | Path | Scene, trust: bool) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene, trust=trust, known_effects=effect_names())


def _check_sampling(parameters: int, steps: int | None, walkers: int | None) -> None:
    if steps is not None and steps < 1:
        raise InputError(None, "--steps", str(steps), "at least 1")
    if walkers is not None and parameters and walkers < 2 * parameters + 2:
        raise InputError(
            None, "--walkers", str(walkers), f"at least {2 * parameters + 2} for {parameters} free parameters"
        )


def _search(
    likelihood: Likelihood, recording: Recording, seed: int, progress: Progress | None
) -> tuple[Fit, list[str]]:
    """The maximum a posteriori; with a jitter added to the model where chi-square says that the quoted
    errors are too small.
    """
    found = fit_map(likelihood, seed=seed, progress=progress)
    effects = [effect.entry for effect in likelihood.model.effects]
    doubtful = recording.error is not None and found.p_value < DOUBTFUL_P and "jitter" not in effects
    if not doubtful:
        return found, []
    said = f"chi2 is {found.chi2:.1f} for {found.dof} degrees of freedom (p = {found.p_value:.1g})"
    if not likelihood.model.names:
        return found, [f"{said}: the model as it stands does not fit within the errors"]
    assembly = likelihood.model.assembly
    with_jitter = assemble(assembly.scene, recording, [*effects, "jitter"], base=assembly)
    model = LightCurve(assembly.scene, recording, assembly=with_jitter)
    found = fit_map(Likelihood(model), seed=seed, progress=progress)
    warning = f"{said}: a jitter was added to the errors; torchlc diagnose looks for what the model lacks"
    return found, [warning]
