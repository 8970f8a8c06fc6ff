"""A campaign from its manifest to its summary."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchlc.campaigns.cluster import connected, require_dask, spread
from torchlc.campaigns.manifest import Job, check_manifest, read_manifest
from torchlc.campaigns.objects import record_failure, run_object
from torchlc.campaigns.processes import Tell
from torchlc.campaigns.summary import OBJECTS, PAGE, PARQUET, TABLE, summary_rows, write_summary
from torchlc.digits import number_of
from torchlc.errors import BusyError, InputError, option
from torchlc.files.disk import resources
from torchlc.files.reading import kind_of
from torchlc.files.writing import OutputDirectory, without_nan
from torchlc.version import __version__

if TYPE_CHECKING:
    import pandas

SCHEMA = "torchlc-campaign/1"
SUMMARY = "campaign.json"
FAILURES_TOLD = 20
"""A screen holds them; campaign.json has all."""


@dataclass(frozen=True)
class CampaignResult:
    """What a campaign came to: how many objects there are, are done (``skipped``: of these, before this run)
    and failed, and ``directory``, where the rest is.

    The rows stay on disk; ``failures`` holds (id, reason) of the first that failed.
    """

    directory: Path
    objects: int
    done: int
    skipped: int
    failed: int
    failures: tuple[tuple[str, str], ...]
    seconds: float
    provenance: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"CampaignResult({self.headline()})"

    def headline(self) -> str:
        """The campaign in one sentence."""
        before = f" ({self.skipped} of them before)" if self.skipped else ""
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.done} of {number_of(self.objects, 'object')} done{before}{failed}"

    def rows(self) -> Iterator[dict[str, Any]]:
        """Each object's row of the summary, in the manifest's order."""
        return summary_rows(self.directory / PARQUET)

    def to_pandas(self) -> pandas.DataFrame:
        """The summary, one row an object; ``explode("parameters")`` gives one a parameter."""
        import pandas

        return pandas.read_parquet(self.directory / PARQUET)

    def to_json(self) -> dict[str, Any]:
        """The content of campaign.json."""
        return without_nan(
            {
                "schema": SCHEMA,
                **{key: getattr(self, key) for key in ("objects", "done", "skipped", "failed")},
                "failures": [{"id": name, "reason": reason} for name, reason in self.failures],
                "seconds": self.seconds,
                "provenance": dict(self.provenance),
            }
        )


def campaign(
    manifest: str | Path,
    *,
    out: str | Path,
    scheduler: str | None = None,
    workers: int | None = None,
    threads: int = 1,
    seed: int = 0,
    budget: float | None = None,
    progress: Callable[[str, float], None] | None = None,
    command: str | None = None,
) -> CampaignResult:
    """Fit or diagnose many objects on Dask; one directory each in ``out``, a summary and a page of all.

    ``manifest`` is a CSV file with the columns scene, recording, task (fit or diagnose) and, if wanted, id
    and options (as typed after the command). Work is done by ``workers`` processes started here, by default
    one a core, or by those of the ``scheduler`` at an address, which must see the same files; each uses
    ``threads`` threads. ``budget`` bounds the search of each object, in CPU seconds, after which the best so far is its result;
    an object whose options have --budget or --quick keeps its own. An object that fails is recorded with its reason; those finished from the same
    inputs are not done again. Each has a seed of its own made from ``seed`` and its id, so its result is
    that of :func:`fit` or :func:`diagnose` with that seed, whoever did it. Worker processes import the main
    script: guard it by ``if __name__ == "__main__"``.
    """
    require_dask()
    manifest, out = Path(manifest), Path(out)
    began, started = time.monotonic(), datetime.now(UTC).isoformat()
    if scheduler is not None and workers is not None:
        raise InputError(
            None,
            option("workers"),
            f"given with {option('scheduler')}",
            "one of the two",
            "A cluster brings its own",
        )
    objects = check_manifest(manifest)
    jobs = partial(read_manifest, manifest, seed=seed, threads=threads, budget=budget)
    with OutputDirectory(out, [PARQUET, TABLE, PAGE, SUMMARY], [manifest]) as directory, resources(directory.path):  # fmt: skip
        root = _folder_of_objects(directory)
        tally = _Tally(objects, progress)
        with connected(scheduler, workers, threads) as client:
            hearing = None if progress is None else tally.heard
            for job, outcome in spread(client, partial(_run_in, root, started), jobs(), hearing):
                tally.ended(job, outcome, root)
        facts = tally.facts()
        made = {
            "started": started,
            "manifest": str(manifest),
            "torchlc": __version__,
            "seed": seed,
            "command": command,
        }
        write_summary(jobs(), tally.held, directory, manifest.name, {**facts, **made})
        result = CampaignResult(
            directory=directory.path,
            **facts,
            failures=_failures(directory.path),
            seconds=time.monotonic() - began,
            provenance=made,
        )
        directory.write_json(SUMMARY, result.to_json())
    return result


def _folder_of_objects(directory: OutputDirectory) -> Path:
    """Where the directories of objects are; InputError where something else has that name."""
    root = directory.path.resolve() / OBJECTS
    if os.path.lexists(root) and not root.is_dir():
        raise InputError(root, None, kind_of(root.lstat().st_mode), "a directory, or none", "Move it away")
    return root


class _Tally:
    """What has become of the objects so far: counts by outcome, and ``held``, by directory why no record of an object could be
    written there. ``progress`` is told the share of all work that is done."""

    def __init__(self, objects: int, progress: Callable[[str, float], None] | None) -> None:
        self.objects, self.progress = objects, progress
        self.held: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self._running: dict[str, float] = {}

    def heard(self, job: Job, share: float) -> None:
        """An object is done to this share, or was before its worker died."""
        self._running[job.directory] = max(share, self._running.get(job.directory, 0.0))
        self._tell()

    def ended(self, job: Job, outcome: str | Exception, root: Path) -> None:
        """An object has come to an outcome; of one that raised, the record is written in its stead."""
        self._running.pop(job.directory, None)
        if isinstance(outcome, BusyError | InputError):
            self.held[job.directory] = str(outcome)
        elif not isinstance(outcome, str):
            try:
                record_failure(job, root / job.directory, str(outcome))
            except (BusyError, InputError) as error:
                self.held[job.directory] = str(error)
        self._counts[outcome if isinstance(outcome, str) else "failed"] += 1
        self._tell()

    def facts(self) -> dict[str, int]:
        counts = self._counts
        return {
            "objects": self.objects,
            "done": counts["done"] + counts["skipped"],
            "skipped": counts["skipped"],
            "failed": counts["failed"],
        }

    def _tell(self) -> None:
        if self.progress is not None:
            # a copy: workers are heard in another thread
            shares = sum(list(self._running.values()))
            self.progress("objects", (self._counts.total() + shares) / self.objects)


def _run_in(root: Path, campaign: str, job: Job, tell: Tell | None = None) -> str:
    """One object, on a worker; what its libraries could hand back to the cluster they do where they are."""
    import dask.config

    with dask.config.set(scheduler="synchronous"):
        return run_object(job, root / job.directory, campaign, tell)


def _failures(directory: Path) -> tuple[tuple[str, str], ...]:
    """(id, reason) of the first that failed."""
    failures = []
    for row in summary_rows(directory / PARQUET, ["id", "status", "reason"]):
        if row["status"] == "failed":
            failures.append((row["id"], row["reason"] or ""))
        if len(failures) == FAILURES_TOLD:
            break
    return tuple(failures)
