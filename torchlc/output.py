"""Where results go: one run at a time in a directory, every file whole or not at all, a full disk said in
words.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import fcntl
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from torchlc.errors import BusyError, InputError, ResourceError

LOCK_NAME = ".torchlc.lock"
PARTIAL = ".partial"
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class OutputDirectory:
    """A directory held by this process from ``with`` to the end of the block.

    The lock is the kernel's (flock on a file that names the process and its start), so that of a killed
    process holds nobody up. A directory made for a run that then writes nothing is taken away again.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._descriptor = -1
        self._made: list[Path] = []

    def __enter__(self) -> OutputDirectory:
        self._make()
        try:
            self._lock()
            for left in self.path.glob(f"*{PARTIAL}"):
                left.unlink(missing_ok=True)
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
        return write_whole(self.path / name, writer)

    def _make(self) -> None:
        missing = [p for p in (self.path, *self.path.parents) if not p.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise InputError(None, "-o", f"{self.path} is a file", "a directory") from None
        except OSError as error:
            raise _unusable(self.path, error) from None
        self._made = missing

    def _unmake(self) -> None:
        for path in self._made:
            with contextlib.suppress(OSError):
                path.rmdir()

    def _lock(self) -> None:
        lock = self.path / LOCK_NAME
        while True:
            try:
                descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
            except OSError as error:
                raise _unusable(self.path, error) from None
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _same_file(descriptor, lock):
                    self._descriptor = descriptor
                    started = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, json.dumps({"pid": os.getpid(), "started": started}).encode())
                    return
                os.close(descriptor)  # its owner finished between our open and our lock
            except BlockingIOError:
                holder = os.pread(descriptor, 200, 0).decode(errors="replace")
                os.close(descriptor)
                raise BusyError(f"{self.path} is in use by another run{_named(holder)}") from None
            except OSError as error:
                if self._descriptor < 0:
                    os.close(descriptor)
                raise _unusable(self.path, error) from None

    def _unlock(self) -> None:
        if self._descriptor >= 0:
            (self.path / LOCK_NAME).unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = -1


def without_nan(value: Any) -> Any:
    """The same structure with None for numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_whole(path: Path, writer: Callable[[Path], object]) -> Path:
    """Write through a file of another name in the same directory, flushed to disk before it takes the place
    of ``path``.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")
    with resources(path):
        try:
            writer(partial)
            with partial.open("rb") as stream:
                os.fsync(stream.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    return path


@contextlib.contextmanager
def resources(path: Path | None = None) -> Iterator[None]:
    """Turn a full disk, a file limit or memory that runs out into ResourceError, whoever reports it."""
    try:
        yield
    except MemoryError:
        raise ResourceError(
            "out of memory; fewer rows, fewer --walkers or a coarser mesh need less"
        ) from None
    except (OSError, RuntimeError) as error:
        text = str(error).lower()
        if getattr(error, "errno", None) in FULL or any(os.strerror(code).lower() in text for code in FULL):
            where = path or getattr(error, "filename", None)
            raise ResourceError(
                f"no room on disk{f' for {where}' if where else ''}; nothing of it was written"
            ) from None
        if "can't allocate memory" in text or "not enough memory" in text:
            raise ResourceError(
                "out of memory; fewer rows, fewer --walkers or a coarser mesh need less"
            ) from None
        if isinstance(error, PermissionError) and path is not None:
            raise _unusable(path, error) from None
        raise


def _unusable(path: Path, error: OSError) -> InputError | ResourceError:
    if error.errno in FULL:
        return ResourceError(f"no room on disk for {path}")
    return InputError(
        None, "-o", f"{path} cannot be written: {error.strerror}", "a directory that can be written"
    )


def _same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _named(holder: str) -> str:
    with contextlib.suppress(ValueError, KeyError, TypeError):
        said = json.loads(holder)
        return f": process {said['pid']}, started {said['started']}"
    return ""
