"""HDF5 files of others, before anything in them is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from torchlc.errors import InputError


def check_hdf5(path: Path, expected: str) -> None:
    """Raise InputError where a file cannot be opened, holds a link (which may lead to another file), or declares more
    numbers than it has bytes: a few bytes can declare more than any memory holds. What torchlc writes is not compressed.
    """
    size, declared, links = path.stat().st_size, 0, []

    def look(group: Any) -> None:
        nonlocal declared
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                links.append(f"{group.name}/{name}")
                continue
            node = group[name]
            if isinstance(node, h5py.Group):
                look(node)
            elif isinstance(node, h5py.Dataset):
                declared += node.nbytes

    try:
        with h5py.File(path, "r") as file:
            look(file)
    except (
        Exception
    ) as error:  # h5py raises whatever the broken bytes make it raise; RecursionError of a circle too
        raise InputError(path, None, f"cannot be read: {error}"[:200], expected) from None
    if links:
        raise InputError(path, None, f"a link, {links[0][:80]}", expected)
    if declared > size:
        raise InputError(path, None, f"{declared:,} bytes of numbers are declared, in {size:,}", expected)
