"""Files at the door."""

from __future__ import annotations

from pathlib import Path

from torchlc.errors import InputError


def readable_file(path: str | Path, expected: str) -> Path:
    """``path`` if it is a regular file that can be opened; ``expected`` says what should have been in it."""
    path = Path(path)
    try:
        if not path.exists():
            raise InputError(path, None, "no such file", expected)
        if not path.is_file():
            raise InputError(path, None, "not a regular file", expected)
        path.open("rb").close()
    except OSError as error:
        raise InputError(str(path)[:200], None, f"cannot be read: {error.strerror}", expected) from None
    return path
