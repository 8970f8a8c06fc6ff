"""Where the verbs write: the directory of a run, what it has finished, and from what its results were made."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchlc.files.disk import resources
from torchlc.files.steps import Steps
from torchlc.files.writing import STEPS_FILE, OutputDirectory
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.version import __version__


def held(
    stack: ExitStack, out: str | Path | None, writes: Iterable[str], inputs: Iterable[Path]
) -> OutputDirectory | None:
    """The directory for the results of these inputs, held until the stack ends."""
    directory = None
    if out is not None:
        directory = stack.enter_context(OutputDirectory(out, writes, inputs))
    stack.enter_context(resources(None if out is None else Path(out)))
    return directory


def input_files(scene: Scene, recording: Recording | None = None) -> list[Path]:
    """The files that scene and recording were read from, and those that the scene names."""
    sources = [scene.source, None if recording is None else recording.source]
    named = map(scene.file_path, scene.files().values())
    return [*(Path(source) for source in sources if source is not None), *named]


def steps_of(
    directory: OutputDirectory | None, scene: Scene, rows: Recording, settings: str, every_s: float = 0.0
) -> Steps:
    """What a search in a directory has finished; what is there of another scene, recording, setting or version is not known."""
    if directory is None:
        return Steps()
    columns = {
        field.name: value
        for field in fields(rows)
        if isinstance(value := getattr(rows, field.name), np.ndarray | tuple | str | bool)
    }
    first: Any = rows.time[0]
    content = [
        scene.to_toml().encode(),
        repr((first.scale, first.jd1, first.jd2, *columns)).encode(),
        *map(_bytes_of, columns.values()),
        settings.encode(),
        __version__.encode(),
    ]
    key = hashlib.sha256(b"".join(content)).hexdigest()
    return Steps(
        key, directory.path / STEPS_FILE, lambda fill: directory.write(STEPS_FILE, fill), every_s=every_s
    )


def _bytes_of(value: np.ndarray | tuple[str, ...] | str | bool) -> bytes:
    """What tells a value from another one. An array of objects, as of names of bands, has only their addresses among its bytes."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype != object else repr(value.tolist()).encode()
    return repr(value).encode()


def provenance(scene: Scene, recording: Recording, seed: int, command: str | None = None) -> dict[str, Any]:
    """From what, with what and how a result was made: hashes of the bytes that were read of each input,
    versions, seed, command.
    """
    read = {
        "scene": (scene.source, scene.sha256),
        "recording": (recording.source, recording.sha256),
        **{place: (name, scene.hashes.get(name)) for place, name in scene.files().items()},
    }
    inputs = {
        name: {"file": Path(source).name, "sha256": digest}
        for name, (source, digest) in read.items()
        if source is not None and digest is not None
    }
    return made_with(inputs, seed, command)


def made_with(inputs: Mapping[str, Any], seed: int, command: str | None) -> dict[str, Any]:
    """Provenance of a result from these ``inputs``: with which versions, seed and command."""
    import astropy
    import emcee

    return {
        "inputs": dict(inputs),
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
