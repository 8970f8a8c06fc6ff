"""Files at the door: what may be read, and the hash of what was read."""

from __future__ import annotations

import contextlib
import hashlib
import stat
from collections.abc import Iterator
from pathlib import Path

from torchlc.errors import InputError

KINDS = (
    (stat.S_ISLNK, "a symbolic link"),
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def readable_file(path: str | Path, expected: str) -> Path:
    """``path`` if it is a regular file that can be opened; ``expected`` says what should have been in it."""
    path = Path(path)
    try:
        if not path.exists():
            raise InputError(path, None, "no such file", expected)
        if path.is_dir():
            inside = [file for file in (path / "scene.toml", path / "curve.ecsv") if file.is_file()]
            hint = f"Did you mean {inside[-1]}?" if len(inside) == 1 else ""
            raise InputError(path, None, "a folder", expected, hint)
        if not path.is_file():
            raise InputError(path, None, "not a regular file", expected)
        path.open("rb").close()
    except OSError as error:
        raise InputError(str(path)[:200], None, f"cannot be read: {error.strerror}", expected) from None
    return path


def sha256_of(path: Path) -> str:
    """Hash of a file's content, hexadecimal; holds a little of it at a time."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextlib.contextmanager
def unchanged(*paths: Path) -> Iterator[None]:
    """Read files in the block, and hash them at its end: the hash is that of the bytes that were read.

    A reader may go through a file more than once, and finds out itself whether it is of a bearable size.
    Raises InputError where size, times or inode of a file are not at the end what they were at the beginning.
    """
    before = [_stamp(path) for path in paths]
    yield
    for path, stamp in zip(paths, before, strict=True):
        if _stamp(path) != stamp:
            raise changed(path, "while it was read")


def changed(path: Path, when: str) -> InputError:
    """The error of an input that another program wrote to meanwhile."""
    return InputError(path, None, f"changed {when}", "a file that stays as it is", "Run the command again")


def kind_of(mode: int) -> str:
    """What a directory entry with this ``st_mode`` is, in words."""
    return next((words for is_kind, words in KINDS if is_kind(mode)), "a file")


def _stamp(path: Path) -> tuple[int, ...] | None:
    """What changes whenever a file's content does; None where there is no file, which its reader will say."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
