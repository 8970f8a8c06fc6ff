"""What a disk, a directory or a memory refuses, said in words."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

from torchlc.errors import InputError, ResourceError, option

LONGEST_NAME_TOLD = 200
PARTIAL = ".partial"
FORBIDDEN = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


@contextlib.contextmanager
def resources(path: Path | None = None) -> Iterator[None]:
    """Turn a full disk, a file limit or memory that runs out into ResourceError, whoever reports it."""
    try:
        yield
    except MemoryError:
        raise ResourceError(
            f"out of memory; fewer rows, fewer {option('walkers')} or a coarser mesh need less"
        ) from None
    except (OSError, RuntimeError) as error:
        text = str(error).lower()
        if getattr(error, "errno", None) in FULL or any(os.strerror(code).lower() in text for code in FULL):
            where = path or getattr(error, "filename", None)
            raise ResourceError(
                f"no room on disk{f' for {_final(Path(where))}' if where else ''}; nothing of it was written"
            ) from None
        if "can't allocate memory" in text or "not enough memory" in text:
            raise ResourceError(
                f"out of memory; fewer rows, fewer {option('walkers')} or a coarser mesh need less"
            ) from None
        if isinstance(error, OSError) and error.errno in FORBIDDEN and path is not None:
            raise unusable(_final(path), error, None) from None
        raise


def _final(path: Path) -> Path:
    """Where a file that is being written will be in the end; a path of any other file as it is."""
    match = re.fullmatch(rf"\.(.+)\.\d+(-\d+)?{re.escape(PARTIAL)}", path.name)
    return path.with_name(match[1]) if match else path


def unusable(path: Path, error: OSError, option: str | None = "-o") -> InputError | ResourceError:
    if error.errno in FULL:
        return ResourceError(f"no room on disk for {path}")
    name = str(path) if len(str(path)) <= LONGEST_NAME_TOLD else f"{str(path)[:LONGEST_NAME_TOLD]}..."
    return InputError(
        None, option, f"{name} cannot be written: {error.strerror}", "a directory that can be written"
    )
