"""Where results go: one run at a time in a directory, every file whole or not at all, nothing of anybody else
destroyed, a full disk said in words.

A directory of results holds a manifest, which names the files that torchlc wrote there with the hashes of
their contents. Only a regular file whose content is still what the manifest says is replaced or removed.
The manifest is on disk before the file that it names, and keeps the hash of the content before: whenever a
run is killed, what it left is known for its own.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import fcntl
import json
import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from torchlc.errors import BusyError, InputError
from torchlc.files.disk import PARTIAL, resources, unusable
from torchlc.files.reading import kind_of, sha256_of

LOCK_NAME = ".torchlc.lock"
MANIFEST_NAME = "torchlc-manifest.json"
MANIFEST_SCHEMA = "torchlc-manifest/1"
MOST_MANIFEST_BYTES = 1 << 20
"""A manifest holds some 150 bytes a file."""
LONGEST_LOCK = 200
"""Bytes; a process and its start are 60."""
CHAIN_FILE = "chain.h5"
SAMPLED_FILES = frozenset({CHAIN_FILE, "posterior.nc", "corner.png", "traces.png"})
FIT_SCHEMA = "torchlc-fit/1"
FIT_FILES = SAMPLED_FILES | {"fit.json", "report.html", "curve.png", "shares.png", "object.png"}
STEPS_FILE = "search.pt"
"""What a search has finished, as long as it runs."""
DIAGNOSIS_FILES = frozenset({"diagnosis.json", "report.html", "curve.png", "object.png", STEPS_FILE})
PER_PASS_FILE = "scene_per_pass.toml"
"""Written only where passes may have a phase each."""
ROTATION_FILES = frozenset(
    {"rotation.json", "scene.toml", PER_PASS_FILE, "periodogram.png", "poles.png", "folded.png", STEPS_FILE}
)
RESULT_FILES = FIT_FILES | DIAGNOSIS_FILES
"""What a fit or a diagnosis may write; of these a directory holds what one run wrote."""
CHANGED = ".changed"
KEPT_HASHES = 2
"""Of each file, newest first: the content that is about to be put in place, and the one before."""


class OutputDirectory:
    """A directory held by this process from ``with`` to the end of the block.

    ``writes`` are the names of the files that the run may write, ``inputs`` the files that it reads: an
    output that is an input, or not what torchlc wrote, is refused before the block begins. Files that torchlc
    did not write stay.

    The lock is the kernel's (flock on a file that names the process and its start), so that of a killed
    process holds nobody up. A directory made for a run that then writes nothing is taken away again.
    """

    def __init__(self, path: str | Path, writes: Iterable[str] = (), inputs: Iterable[Path] = ()) -> None:
        if not str(path):  # Path("") is the folder one is in
            raise InputError(None, "-o", "an empty name", "the name of a directory")
        self.path = Path(path)
        self._writes, self._inputs = tuple(writes), tuple(inputs)
        self._manifest: dict[str, list[str]] = {}
        self._descriptor = -1
        self._made: list[Path] = []

    def __enter__(self) -> OutputDirectory:
        self._make()
        try:
            self._lock()
            self._manifest = read_manifest(self.path)
            for name in self._writes:
                self.check(name)
        except BaseException:
            self._unlock()
            self._unmake()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._unlock()
        if kind is not None:
            self._unmake()

    def write_text(self, name: str, text: str) -> Path:
        return self.write_bytes(name, text.encode())

    def write_bytes(self, name: str, content: bytes) -> Path:
        return self.write(name, lambda path: path.write_bytes(content))

    def write_json(self, name: str, content: Any) -> Path:
        """NaN and infinity become null."""
        return self.write_text(
            name, json.dumps(without_nan(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )

    def write(self, name: str, writer: Callable[[Path], object]) -> Path:
        """Let ``writer`` fill a file beside ``name`` and put it in place once it is on disk."""
        path = self.path / name
        self.check(name)
        with resources(path), _filled(path, writer) as partial:
            before = self._manifest.get(name, [])
            self._manifest[name] = list(dict.fromkeys([sha256_of(partial), *before]))[:KEPT_HASHES]
            self._write_manifest()
            _replace(partial, path)
        return path

    def write_path(self, path: Path, writer: Callable[[Path], object]) -> Path:
        """:meth:`write`, of a path in this directory."""
        return self.write(path.name, writer)

    def clear(self, names: Iterable[str]) -> None:
        """Remove what earlier runs left under ``names``, so that it is not taken for a result of this one.

        What torchlc did not write, or somebody has changed since, stays, and so do this run's inputs.
        """
        cleared = [n for n in names if self._is_own(n) and not _is_among(self._inputs, self.path / n)]
        for name in cleared:
            (self.path / name).unlink()
            del self._manifest[name]
        if cleared:
            self._write_manifest()

    def set_aside(self) -> None:
        """Give files that have changed since torchlc wrote them another name, ``NAME.changed``."""
        for name in self.names():
            if not self._is_own(name):
                path = self.path / name
                aside = path.with_name(name + CHANGED)
                number = 1
                while os.path.lexists(aside):
                    number += 1
                    aside = path.with_name(f"{name}{CHANGED}-{number}")
                path.rename(aside)

    def names(self) -> list[str]:
        """The files that torchlc wrote here and that are still there, changed or not, in order of name."""
        return [name for name in sorted(self._manifest) if os.path.lexists(self.path / name)]

    def _is_own(self, name: str) -> bool:
        """Whether ``name`` is a regular file with content that torchlc wrote."""
        path = self.path / name
        return _is_regular(path) and sha256_of(path) in self._manifest.get(name, ())

    def check(self, name: str) -> None:
        """Raise InputError unless ``name`` is absent or a file that torchlc wrote, and no input."""
        path = self.path / name
        check_replaceable(path, self._inputs)
        if os.path.lexists(path):
            expected, away = "a file that torchlc wrote, or none", "Move it away, or give another directory"
            if name not in self._manifest:
                hint = f"{away}; where an earlier version left it, which kept no manifest, remove it"
                raise InputError(path, None, f"there, but not in {MANIFEST_NAME}", expected, hint)
            with resources(path):
                if not self._is_own(name):
                    raise InputError(path, None, "changed since torchlc wrote it", expected, away)

    def _write_manifest(self) -> None:
        content = {"schema": MANIFEST_SCHEMA, "files": dict(sorted(self._manifest.items()))}
        text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
        write_whole(self.path / MANIFEST_NAME, lambda path: path.write_text(text, encoding="utf-8"))

    def _make(self) -> None:
        try:
            missing = [p for p in (self.path, *self.path.parents) if not p.exists()]
            self.path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise InputError(None, "-o", f"{self.path} is a file", "a directory") from None
        except ValueError:
            raise InputError(None, "-o", "a name with a null byte", "the name of a directory") from None
        except OSError as error:
            raise unusable(self.path, error) from None
        self._made = missing

    def _unmake(self) -> None:
        if self._made and not self.names():
            (self.path / MANIFEST_NAME).unlink(missing_ok=True)
        for path in self._made:
            with contextlib.suppress(OSError):
                path.rmdir()

    def _lock(self) -> None:
        lock = self.path / LOCK_NAME
        while True:
            try:
                descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
            except OSError as error:
                if os.path.lexists(lock) and not _is_regular(lock):
                    raise _strange(lock) from None
                raise unusable(self.path, error) from None
            try:
                holder = _holder(lock, descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _same_file(descriptor, lock):
                    self._take(descriptor, _holder(lock, descriptor))
                    return
                os.close(descriptor)  # its owner finished between our open and our lock
            except BlockingIOError:
                os.close(descriptor)
                raise BusyError(f"{self.path} is in use by another run{_named(holder)}") from None
            except BaseException as error:
                if self._descriptor < 0:
                    os.close(descriptor)
                raise unusable(self.path, error) if isinstance(error, OSError) else error from None

    def _take(self, descriptor: int, before: Mapping[str, Any]) -> None:
        """Make the lock this process's, and remove what the process that held it before left half-written."""
        self._descriptor = descriptor
        if before:
            half_written = re.compile(rf"\..+\.{before['pid']}(-\d+)?{re.escape(PARTIAL)}")
            for path in self.path.iterdir():
                if half_written.fullmatch(path.name) and _is_regular(path):
                    path.unlink()
        started = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps({"pid": os.getpid(), "started": started}).encode(), 0)

    def _unlock(self) -> None:
        if self._descriptor >= 0:
            if _same_file(self._descriptor, self.path / LOCK_NAME):
                (self.path / LOCK_NAME).unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = -1


def read_manifest(folder: Path) -> dict[str, list[str]]:
    """Hashes of the contents that torchlc wrote, newest first, by the name of the file; empty without a
    manifest.
    """
    path = folder / MANIFEST_NAME
    expected = f"a manifest of torchlc ({MANIFEST_SCHEMA}), or none"
    hint = "Move it away, or give another directory"
    try:
        mode = path.lstat().st_mode
        if not stat.S_ISREG(mode):
            raise InputError(path, None, kind_of(mode), expected, hint)
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as stream:
            text = stream.read(MOST_MANIFEST_BYTES + 1)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise unusable(path, error) from None
    try:
        content = json.loads(text)
        files = content["files"]
        sound = content["schema"] == MANIFEST_SCHEMA and all(
            Path(name).name == name and all(isinstance(digest, str) for digest in hashes)
            for name, hashes in files.items()
        )
        if sound:
            return {name: list(hashes) for name, hashes in files.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise InputError(path, None, "not readable as a manifest", expected, hint)


def without_nan(value: Any) -> Any:
    """The same structure with None for numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def check_replaceable(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Raise InputError unless ``path`` is absent, or a regular file and none of ``inputs``, by whatever name."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise unusable(path, error) from None
    away = "Move it away, or write elsewhere"
    if not stat.S_ISREG(mode):
        raise InputError(path, None, kind_of(mode), "a regular file, or none", away)
    if _is_among(inputs, path):
        raise InputError(path, None, "an input of this run", "outputs apart from the inputs", away)


def write_whole(path: Path, writer: Callable[[Path], object]) -> Path:
    """Write through a file of another name in the same directory, flushed to disk before it takes the place
    of ``path``. Raises InputError where ``path`` is no regular file: links, pipes and devices stay.
    """
    check_replaceable(path)
    with resources(path), _filled(path, writer) as partial:
        _replace(partial, path)
    return path


@contextlib.contextmanager
def _filled(path: Path, writer: Callable[[Path], object]) -> Iterator[Path]:
    """A new file beside ``path``, filled by ``writer`` and flushed to disk; gone after the block unless moved."""
    partial = _new_file(path)
    try:
        writer(partial)
        with partial.open("rb") as stream:
            os.fsync(stream.fileno())
        yield partial
    finally:
        partial.unlink(missing_ok=True)


def _new_file(path: Path) -> Path:
    """An empty file of this process beside ``path``, whose name nobody had."""
    number = 0
    while True:
        more = f"-{number}" if number else ""
        partial = path.with_name(f".{path.name}.{os.getpid()}{more}{PARTIAL}")
        try:
            os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
        except FileExistsError:
            number += 1
            continue
        return partial


def _replace(partial: Path, path: Path) -> None:
    """Rename, and have the directory flushed to disk: the new name outlives a loss of power."""
    partial.replace(path)
    descriptor = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that cannot flush a directory
            raise
    finally:
        os.close(descriptor)


def _is_regular(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _is_among(files: Iterable[Path], path: Path) -> bool:
    """Whether ``path`` is one of these files, under its own name, by a hard link or at the end of a link."""
    for file in files:
        with contextlib.suppress(OSError):
            if os.path.samestat(path.lstat(), file.stat()):
                return True
    return False


def _same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


def _holder(path: Path, descriptor: int) -> dict[str, Any]:
    """Process and start that a lock names; empty where it has none yet. Raises InputError if it is no lock."""
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_nlink <= 1 and status.st_size <= LONGEST_LOCK:
        text = os.pread(descriptor, LONGEST_LOCK, 0)
        if not text:
            return {}
        with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
            content = json.loads(text)
            return {"pid": int(content["pid"]), "started": str(content["started"])}
    raise _strange(path)


def _strange(lock: Path) -> InputError:
    return InputError(
        lock, None, "not a lock of torchlc", "a lock file, or none", "Move it away, or give another directory"
    )


def _named(holder: Mapping[str, Any]) -> str:
    return f": process {holder['pid']}, started {holder['started']}" if holder else ""
