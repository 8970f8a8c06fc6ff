"""The list of a campaign: a CSV file, one object a row, read as a stream so that a long one needs no more
memory than a short one.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import math
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

import numpy as np

from torchlc.errors import InputError
from torchlc.files.decimals import decimal
from torchlc.files.encodings import wide_encoding_of
from torchlc.files.reading import readable_file
from torchlc.scene.reading import reading_of
from torchlc.suggest import did_you_mean

COLUMNS = ("scene", "recording", "task", "id", "options")
REQUIRED = COLUMNS[:3]
TASKS = ("fit", "diagnose")
FORMAT = "a CSV file with the columns scene, recording, task and, if wanted, id and options"
LONGEST_NAME = 120
"""Characters of a directory's name; file systems allow 255."""
MOST_SEED = 2**32 - 1
"""The largest that NumPy's and emcee's generators take."""


@dataclass(frozen=True)
class Job:
    """One object: its name in the manifest, its files (absolute), what to do with them, and how.

    ``options`` are keywords of the verb; ``seed`` is the object's own, whatever its place in the manifest.
    """

    name: str
    scene: Path
    recording: Path
    task: str
    seed: int
    options: Mapping[str, Any] = field(default_factory=dict)
    threads: int = 1

    @property
    def directory(self) -> str:
        """Name of its directory: that of the object, with what file systems may refuse written as %XX."""
        plain = quote(self.name, safe=" +,=@()[]")
        if plain.startswith("."):
            plain = f"%2E{plain[1:]}"
        if len(plain) > LONGEST_NAME:
            plain = f"{plain[:LONGEST_NAME]}~{_digest(self.name)[:16]}"
        return plain

    @property
    def command(self) -> str:
        """The command that does this object alone, to the same result."""
        words = ["torchlc", self.task, str(self.scene), str(self.recording), "-o", self.directory]
        for name, value in self.options.items():
            words += [f"--{name}"] if value is True else [f"--{name}", _typed(value)]
        return shlex.join([*words, "--seed", str(self.seed), "--threads", str(self.threads)])


def check_manifest(path: Path) -> int:
    """Number of objects; every row is checked. Raises InputError with file and line at the first defect.

    Holds some 50 bytes an object, to find names that come twice.
    """
    keys = np.fromiter((_key(job) for _, job in _rows(path)), dtype=np.uint64)
    if not len(keys):
        raise InputError(path, None, "no rows below the header", "at least one object")
    unique, counts = np.unique(keys, return_counts=True)
    repeated = set(unique[counts > 1].tolist())
    first: dict[str, int] = {}
    for line, job in _rows(path) if repeated else ():
        if _key(job) in repeated and first.setdefault(job.directory, line) != line:
            raise InputError(
                path,
                f"line {line}",
                f"object {job.name!r} again, as in line {first[job.directory]}",
                "a row of its own for each object, or an id that differs",
            )
    return len(keys)


def read_manifest(
    path: Path, *, seed: int = 0, threads: int = 1, budget: float | None = None
) -> Iterator[Job]:
    """The objects in the manifest's order; ``seed`` enters that of each object, and those whose options say nothing about their
    time have the ``budget``, CPU s."""
    for _, job in _rows(path, seed, threads):
        bounded = budget is None or "budget" in job.options or "quick" in job.options
        yield job if bounded else replace(job, options={**job.options, "budget": budget})


def _rows(path: Path, seed: int = 0, threads: int = 1) -> Iterator[tuple[int, Job]]:
    """(line, object) of every row."""
    readable_file(path, FORMAT)
    with path.open(encoding=wide_encoding_of(path) or "utf-8-sig", newline="") as stream:
        reader = csv.reader(stream, strict=True)
        try:
            header = next(reader, None)
            if header is None:
                raise InputError(path, None, "the file is empty", FORMAT)
            names = [name.strip() for name in header]
            _check_header(path, names)
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, _job(path, reader.line_num, names, cells, seed, threads)
        except UnicodeDecodeError as error:
            place = f"after line {reader.line_num}" if reader.line_num else None
            raise InputError(path, place, f"not UTF-8 text: {error.reason}", FORMAT) from None
        except csv.Error as error:
            raise InputError(path, f"line {reader.line_num}", str(error), FORMAT) from None


def _check_header(path: Path, names: list[str]) -> None:
    for name in names:
        if name not in COLUMNS:
            raise InputError(
                path, "line 1", f"unknown column {name[:80]!r}", FORMAT, did_you_mean(name, COLUMNS)
            )
        if names.count(name) > 1:
            raise InputError(path, "line 1", f"column {name!r} appears twice", "distinct column names")
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise InputError(path, "line 1", f"no column {' or '.join(map(repr, missing))}", FORMAT)


def _job(path: Path, line: int, names: list[str], cells: list[str], seed: int, threads: int) -> Job:
    place = f"line {line}"
    if len(cells) != len(names):
        raise InputError(path, place, f"{len(cells)} cells", f"{len(names)}, as the header has")
    row = {name: cell.strip() for name, cell in zip(names, cells, strict=True)}
    for name in REQUIRED:
        if not row[name]:
            raise InputError(path, place, f"{name} is empty", "a task" if name == "task" else "a file")
    task = row["task"]
    if task not in TASKS:
        raise InputError(path, place, f"task {task[:80]!r}", " or ".join(TASKS), did_you_mean(task, TASKS))
    options = _options(path, place, task, row.get("options", ""))
    name = row.get("id") or _default_name(row)
    own_seed = options.pop("seed", int(_digest(f"{seed} {name}")[:8], 16))
    scene, recording = ((path.parent / row[key]).absolute() for key in ("scene", "recording"))
    return Job(name, scene, recording, task, own_seed, options, threads)


def _default_name(row: Mapping[str, str]) -> str:
    """The recording's name, told apart from its namesakes by what the row says, not by where it stands."""
    said = "\n".join(row.get(name, "") for name in (*REQUIRED, "options"))
    return f"{Path(row['recording']).stem}-{_digest(said)[:8]}"


def _options(path: Path, place: str, task: str, text: str) -> dict[str, Any]:
    """Keywords of the verb from options as they are typed after its command."""
    try:
        options = vars(_parser(task).parse_args(shlex.split(text)))
    except ValueError as error:
        raise InputError(
            path, place, f"options {text[:120]!r}: {error}", f"options as torchlc {task} takes them"
        ) from None
    if "effects" in options:
        from torchlc.diagnosis.candidates import check_candidates

        try:
            check_candidates(options["effects"])
        except InputError as error:
            raise InputError(path, f"{place}: --effects", error.found, error.expected, error.hint) from None
    return options


class _Parser(argparse.ArgumentParser):
    """Raises ValueError where argparse would end the process."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


@cache
def _parser(task: str) -> argparse.ArgumentParser:
    """Of the options that an object may have; those not given are absent from what it finds."""
    parser = _Parser(prog="", add_help=False, allow_abbrev=False, argument_default=argparse.SUPPRESS)
    parser.add_argument("--seed", type=_whole(0, MOST_SEED))
    parser.add_argument("--use", choices=("mag", "flux"))
    parser.add_argument("--columns", type=_columns)
    parser.add_argument("--trust", action="store_true")
    parser.add_argument("--budget", type=_seconds)
    if task == "fit":
        parser.add_argument("--steps", type=_whole(1))
        parser.add_argument("--walkers", type=_whole(2))
    else:
        parser.add_argument("--quick", action="store_true")
        parser.add_argument("--effects", type=_entries)
    return parser


def _whole(least: int, most: int | None = None) -> Any:
    def read(text: str) -> int:
        value = int(text) if text.isascii() and text.isdigit() else -1
        if value < least or (most is not None and value > most):
            between = f"at least {least}" if most is None else f"from {least} to {most}"
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number {between}")
        return value

    return read


def _seconds(text: str) -> float:
    try:
        value = decimal(text)
    except ValueError:
        value = math.nan
    if not 1 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of CPU seconds, 1 or more")
    return value


def _columns(text: str) -> str:
    try:
        reading_of(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def _entries(text: str) -> list[str]:
    from torchlc.effects import Entry

    return Entry.split(text)


def _typed(value: Any) -> str:
    return ",".join(value) if isinstance(value, list) else str(value)


def _key(job: Job) -> int:
    return int(_digest(job.directory)[:16], 16)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
