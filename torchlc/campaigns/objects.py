"""One object of a campaign, done by whichever worker gets it: a directory of its own with the files of the
verb and ``object.json``, written last, which says from what it was made and what came out.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torchlc.campaigns.manifest import Job
from torchlc.digits import stated
from torchlc.errors import BusyError, InputError, TorchlcError, at_a_shell
from torchlc.files.reading import changed, readable_file, sha256_of
from torchlc.files.writing import OutputDirectory, read_manifest
from torchlc.scene import content_of_scene
from torchlc.version import __version__

RECORD = "object.json"
SCHEMA = "torchlc-object/1"
RESULTS = {"fit": "fit.json", "diagnose": "diagnosis.json"}
MOST_RECORDING_BYTES = 5_000_000_000
"""1,000 for each of the 5,000,000 rows that are read at most; hashed in some 5 s."""
STAGES = {"Adam": (0.0, 0.3), "emcee": (0.3, 0.9), "report": (0.9, 1.0)}
"""Shares of a fit's time that its stages begin and end at, roughly; a diagnosis tells its own."""
MOST_TOLD = 4
"""Parameters that the one line on an object holds."""


def run_object(
    job: Job, folder: Path, campaign: str = "", tell: Callable[[float], None] | None = None
) -> str:
    """Do one object in ``folder``: "skipped" where its whole result is there from another ``campaign``, else
    "done" or "failed", with the reason in its record. ``tell`` is called with the share that is done.

    Raises BusyError if a live run holds the directory, and whatever keeps the record itself from being
    written, such as a full disk or a file of that name that torchlc did not write. Files of an earlier result
    that have changed since are kept under another name.
    """
    with at_a_shell():  # the options of an object are typed into the manifest
        return _run_object(job, folder, campaign, tell)


def _run_object(job: Job, folder: Path, campaign: str, tell: Callable[[float], None] | None) -> str:
    from torchlc.terminal import one_line, quiet_libraries

    began = time.monotonic()
    origin: dict[str, Any] = {}
    try:
        origin = origin_of(job)
        record = finished(folder, origin)
        if record is not None:
            return "done" if record["campaign"] == campaign else "skipped"
        with OutputDirectory(folder, [RECORD], [job.scene, job.recording]) as directory:
            directory.set_aside()
            directory.clear([RECORD])
        with quiet_libraries():
            outcome = _outcome(job, folder, origin, tell)
    except BusyError:
        raise
    except TorchlcError as error:
        return record_failure(job, folder, str(error), origin, time.monotonic() - began)
    except MemoryError:
        return record_failure(job, folder, "out of memory", origin, time.monotonic() - began)
    except Exception as error:
        said = one_line(f"{type(error).__name__}: {error}")
        reason = f"a defect of torchlc, please report it: {said}"
        return record_failure(job, folder, reason, origin, time.monotonic() - began)
    files = {name: (folder / name).stat().st_size for name in _results_in(folder)}
    seconds = time.monotonic() - began
    return _record(
        job, folder, "done", campaign=campaign, seconds=seconds, origin=origin, files=files, outcome=outcome
    )


def record_failure(
    job: Job, folder: Path, reason: str, origin: Mapping[str, Any] | None = None, seconds: float | None = None
) -> str:
    return _record(job, folder, "failed", reason=reason, seconds=seconds, origin=origin or {})


def read_record(folder: Path) -> dict[str, Any] | None:
    """``object.json``; None if there is none that can be read."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("schema") == SCHEMA else None


def origin_of(job: Job) -> dict[str, Any]:
    """All that a result depends on: version, task, options, seed, and the content of every input file."""
    digest, files = content_of_scene(job.scene, trust=job.options.get("trust", False))
    recording = readable_file(job.recording, "a recording")
    size = recording.stat().st_size
    if size > MOST_RECORDING_BYTES:
        most = f"at most {MOST_RECORDING_BYTES / 1e9:.0f} GB"
        raise InputError(recording, None, f"{size / 1e9:.0f} GB", most, "Split or average it.")
    inputs = {"scene": digest, "recording": sha256_of(recording)}
    inputs |= {name: sha256_of(files[name]) for name in sorted(files)}
    return {
        "torchlc": __version__,
        "task": job.task,
        "options": dict(job.options),
        "seed": job.seed,
        "inputs": inputs,
    }


def finished(folder: Path, origin: Mapping[str, Any]) -> dict[str, Any] | None:
    """The record of a result of this very origin; None unless every file is there, as long as it was
    written.
    """
    record = read_record(folder)
    if record is None or record["status"] != "done" or record["origin"] != origin:
        return None
    try:
        whole = all((folder / name).stat().st_size == size for name, size in record["files"].items())
    except OSError:
        return None
    return record if whole else None


def _results_in(folder: Path) -> list[str]:
    """Names of the files of an object's result: those that torchlc wrote there, but for the record."""
    return [name for name in sorted(read_manifest(folder)) if name != RECORD and (folder / name).is_file()]


def _outcome(
    job: Job, folder: Path, origin: Mapping[str, Any], tell: Callable[[float], None] | None
) -> dict[str, Any]:
    """Run the verb and read back what it wrote. Raises InputError where it read other files than ``origin`` says."""
    import torch

    from torchlc import api

    torch.set_num_threads(job.threads)
    verb = api.fit if job.task == "fit" else api.diagnose

    def progress(stage: str, fraction: float) -> None:
        if tell is not None:
            start, end = STAGES.get(stage, (0.0, 1.0))
            tell(start + (end - start) * fraction)

    verb(
        job.scene, job.recording, seed=job.seed, out=folder, command=job.command, progress=progress, **job.options
    )  # fmt: skip
    content = json.loads((folder / RESULTS[job.task]).read_text(encoding="utf-8"))
    read = {read_file["sha256"] for read_file in content["provenance"]["inputs"].values()}
    if not read <= set(origin["inputs"].values()):
        raise changed(job.scene, "while it was worked on, or its recording or a file that it names")
    return _fitted(content) if job.task == "fit" else _diagnosed(content)


def _fitted(content: Mapping[str, Any]) -> dict[str, Any]:
    """What the summary keeps of fit.json."""
    parameters = content["parameters"]
    informed = [f"{name} = {stated(row)}" for name, row in parameters.items() if row["informed"]]
    more = [f"and {len(informed) - MOST_TOLD} more"] if len(informed) > MOST_TOLD else []
    state = [] if content["converged"] else ["not converged"]
    return {
        "result": "; ".join([*state, *informed[:MOST_TOLD], *more]) or "nothing was free",
        **{key: content[key] for key in ("converged", "rows", "chi2", "dof", "rms_mag")},
        "warnings": len(content["warnings"]),
        "parameters": [_parameter(name, row) for name, row in parameters.items()],
    }


def _diagnosed(content: Mapping[str, Any]) -> dict[str, Any]:
    """What the summary keeps of diagnosis.json: chi2 and materials are those of the final model."""
    named = [" or ".join(family) for family in content["families"]]
    verdict = content["verdict"].replace("_", " ")
    return {
        "result": f"{verdict}: {', '.join(named)}" if named else verdict,
        **{key: content[key] for key in ("verdict", "global_p", "named")},
        "chi2": content["improvement"]["chi2_after"],
        "dof": content["improvement"]["dof"],
        "parameters": [_parameter(name, row) for name, row in content["materials"]["after"].items()],
    }


def _parameter(name: str, row: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("median", "sd", "q05", "q95", "unit", "informed")
    return {"name": name, **{key: row.get(key) for key in keys}}


def _record(job: Job, folder: Path, status: str, **more: Any) -> str:
    content = {
        "schema": SCHEMA,
        "id": job.name,
        "scene": str(job.scene),
        "recording": str(job.recording),
        "task": job.task,
        "status": status,
        "seed": job.seed,
        "command": job.command,
        **more,
    }
    with OutputDirectory(folder, [RECORD], [job.scene, job.recording]) as directory:
        directory.write_json(RECORD, content)
    return status
