"""The chain on disk: emcee's HDF5 layout, with hashes of what it was made from and of every block of its steps, so
that only a chain that is whole, and of the very same problem, is continued.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import stat
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from astropy.time import Time

from torchlc.digits import number_of
from torchlc.errors import InputError, option
from torchlc.files.reading import kind_of
from torchlc.files.writing import write_whole
from torchlc.inference.likelihood import Likelihood
from torchlc.readers import Recording
from torchlc.scene import Scene

if TYPE_CHECKING:
    import emcee

BACKEND_NAME = "mcmc"
ORIGIN, SEAL, BLOCKS = "torchlc_origin", "torchlc_seal", "torchlc_blocks"
"""Attributes with what decides the chain (JSON) and the hash of all but the steps; dataset with the steps' hashes."""
WRITE_EVERY_S = 30.0
"""What a run that is killed loses at most."""
BLOCK_STEPS = 100
"""Steps hashed together: 150 kB of a chain of 32 walkers over 6 parameters."""
STATE_PARTS = 5
"""Of NumPy's random state: name, key, position, whether it holds a second normal number, and that number."""
ANEW = "Remove it to start anew"
NOT_OF_CONTENT = frozenset(
    {"meta", "dropped", "dropped_at", "place", "placed_by", "warnings", "source", "sha256"}
)
"""Fields of a recording that do not enter the likelihood."""
Write = Callable[[Path, Callable[[Path], object]], object]
"""Puts a file in place: its path, and what fills it."""


@dataclass(frozen=True)
class StoredChain:
    """A chain as read: ``steps`` (N, W, P) in straight coordinates, ``log_prob`` (N, W), ``accepted`` (W,)."""

    origin: Mapping[str, Any]
    steps: np.ndarray
    log_prob: np.ndarray
    accepted: np.ndarray
    random_state: tuple[Any, ...]


def chain_origin(likelihood: Likelihood, walkers: int, seed: int) -> dict[str, Any]:
    """What decides a chain: hashes of scene and recording, effects, parameters, walkers and seed."""
    model = likelihood.model
    return {
        **input_hashes(model.scene, model.recording),
        "effects": [str(effect.entry) for effect in model.effects],
        "parameters": list(model.names),
        "walkers": walkers,
        "seed": seed,
    }


def input_hashes(scene: Scene, recording: Recording) -> dict[str, str]:
    """Hashes of what enters the model: the scene's content with that of the files it names, and the rows used.

    Comments and blank lines of a scene file do not count, nor do the names of files.
    """
    named = {place: scene.hashes.get(name) for place, name in scene.files().items()}
    return {
        "scene": _hash_of_json([scene.to_toml(), named]),
        "recording": _hash_of_recording(recording),
    }


def write_chain(
    path: Path, backend: emcee.backends.Backend, origin: Mapping[str, Any], write: Write = write_whole
) -> None:
    """The chain so far in emcee's HDF5 layout (straight coordinates), whole or not at all."""
    import emcee

    stream = io.BytesIO()
    steps, log_prob = (getattr(backend, name)[: backend.iteration] for name in ("chain", "log_prob"))
    blocks = _block_hashes(steps, log_prob)
    with h5py.File(stream, "w") as file:
        group = file.create_group(BACKEND_NAME)
        walkers, dimensions = backend.shape
        group.attrs.update(
            version=emcee.__version__, nwalkers=walkers, ndim=dimensions, has_blobs=False,
            iteration=backend.iteration, parameters=origin["parameters"], seed=origin["seed"],
        )  # fmt: skip
        for index, part in enumerate(backend.random_state or ()):
            group.attrs[f"random_state_{index}"] = part
        group.attrs[ORIGIN] = json.dumps(origin)
        group.attrs[SEAL] = _seal(origin, backend.accepted, tuple(backend.random_state or ()), blocks)
        group["accepted"] = backend.accepted
        group[BLOCKS] = blocks
        for name, data in (("chain", steps), ("log_prob", log_prob)):
            group.create_dataset(name, data=data, maxshape=(None, *data.shape[1:]))
    write(path, lambda partial: partial.write_bytes(stream.getbuffer()))


def read_chain(path: Path) -> StoredChain | None:
    """A chain that is what torchlc wrote; None if there is no file. Raises InputError at the first thing wrong,
    before it reads, or makes room for, more than the file can hold."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, None, kind_of(status.st_mode), "a chain in a regular file", ANEW)
    try:
        with h5py.File(path, "r") as file:
            return _stored(path, file, status.st_size)
    except InputError:
        raise
    except Exception as error:  # h5py raises whatever the broken bytes make it raise
        raise _refused(path, f"not readable as a chain ({error})"[:300]) from None


def check_origin(path: Path, chain: StoredChain, origin: Mapping[str, Any]) -> None:
    """Raise InputError where the chain was made from something else than ``origin`` says: all of
    :func:`chain_origin`, or scene, recording and seed, which are known before the search.
    """
    made = chain.origin
    if "walkers" in origin and any(made[key] != origin[key] for key in ("walkers", "parameters")):
        found, expected = (
            f"{number_of(settings['walkers'], 'walker')} over {', '.join(settings['parameters'])}"
            for settings in (made, origin)
        )
        hint = f"{ANEW}, or give the scene and {option('walkers')} it was made with"
        raise InputError(path, None, f"a chain of {found}", expected, hint)
    for key, found in (("scene", "another scene"), ("recording", "other data: another recording")):
        if made[key] != origin[key]:
            hint = f"{ANEW}, or give the {key} it was made with"
            raise InputError(path, None, f"a chain of {found}", f"one of this {key}", hint)
    if made["seed"] != origin["seed"]:
        hint = f"{ANEW}, or go on with {option('seed', made['seed'])}"
        raise InputError(path, None, f"a chain of seed {made['seed']}", f"one of seed {origin['seed']}", hint)
    if "effects" in origin and made["effects"] != origin["effects"]:
        found, expected = (", ".join(settings["effects"]) or "none" for settings in (made, origin))
        raise InputError(path, None, f"a chain with the effects {found}", expected, ANEW)


def _refused(path: Path, found: str) -> InputError:
    return InputError(path, None, found, "a chain as torchlc wrote it", ANEW)


def _stored(path: Path, file: h5py.File, size: int) -> StoredChain:
    group: Any = _member(file, BACKEND_NAME)
    if not isinstance(group, h5py.Group) or ORIGIN not in group.attrs or SEAL not in group.attrs:
        raise _refused(path, "no record of what it was made from")
    origin = _origin(path, group.attrs[ORIGIN])
    count = _whole(path, "iteration", group.attrs.get("iteration"))
    walkers, names = origin["walkers"], origin["parameters"]
    if _whole(path, "nwalkers", group.attrs.get("nwalkers")) != walkers:
        raise _refused(path, "walkers that contradict its record")
    blocks = -(-count // BLOCK_STEPS)
    chain = _dataset(path, group, "chain", np.float64, (count, walkers, len(names)), size)
    log_prob = _dataset(path, group, "log_prob", np.float64, (count, walkers), size)
    accepted = _dataset(path, group, "accepted", np.float64, (walkers,), size)[:]
    hashes = _dataset(path, group, BLOCKS, np.uint8, (blocks, hashlib.sha256().digest_size), size)[:]
    state = _random_state(path, group.attrs)
    if group.attrs[SEAL] != _seal(origin, accepted, state, hashes):
        raise _refused(path, "settings, random state or hashes that are not those written with its steps")
    pieces: list[tuple[np.ndarray, np.ndarray]] = []
    for index in range(blocks):
        rows = slice(index * BLOCK_STEPS, min((index + 1) * BLOCK_STEPS, count))
        piece = (chain[rows], log_prob[rows])
        if (_block_hashes(*piece) != hashes[index]).any():
            spoilt = (
                "not a number" if any(np.isnan(values).any() for values in piece) else "not what was written"
            )
            raise _refused(path, f"steps {rows.start + 1} to {rows.stop} are {spoilt}")
        pieces.append(piece)
    steps, densities = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return StoredChain(origin, steps, densities, accepted, state)


def _origin(path: Path, text: Any) -> dict[str, Any]:
    content = json.loads(text)
    lists = all(
        isinstance(content[key], list) and all(isinstance(name, str) for name in content[key])
        for key in ("effects", "parameters")
    )
    numbers = all(type(content[key]) is int and content[key] >= 0 for key in ("walkers", "seed"))
    hashes = all(isinstance(content[key], str) for key in ("scene", "recording"))
    if not (lists and numbers and hashes and content["walkers"] and content["parameters"]):
        raise _refused(path, "an unreadable record of what it was made from")
    return content


def _whole(path: Path, name: str, value: Any) -> int:
    if not isinstance(value, np.integer) or value < 1:
        raise _refused(path, f"{name} {str(value)[:40]}")
    return int(value)


def _member(group: Any, name: str) -> Any:
    """What a group holds under ``name``; None where that is a link, which may lead to another file."""
    return group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None


def _dataset(path: Path, group: Any, name: str, kind: Any, shape: tuple[int, ...], size: int) -> h5py.Dataset:
    """The dataset if it lies in this file, plainly, and is no larger than ``size`` bytes."""
    data = _member(group, name)
    if not isinstance(data, h5py.Dataset):
        raise _refused(path, f"no dataset {name}")
    if data.dtype != np.dtype(kind) or data.shape != shape:
        declared = f"{name} of {data.dtype} and shape {data.shape}"
        raise _refused(path, f"{declared}, where {np.dtype(kind)} and {shape} belong")
    filtered = data.id.get_create_plist().get_nfilters() > 0
    if filtered or data.is_virtual or data.external or data.nbytes > size:
        raise _refused(path, f"{name} of {data.nbytes:,} bytes, which a file of {size:,} does not hold")
    return data


def _random_state(path: Path, attributes: Any) -> tuple[Any, ...]:
    """NumPy's, as emcee stores it, if a generator takes it."""
    state = tuple(attributes.get(f"random_state_{index}") for index in range(STATE_PARTS))
    if any(part is None for part in state):
        raise _refused(path, "no random state to go on with")
    np.random.RandomState().set_state(state)
    return state


def _seal(origin: Mapping[str, Any], accepted: np.ndarray, state: tuple[Any, ...], blocks: np.ndarray) -> str:
    """Hash of all that decides how the chain goes on, but its steps, whose hashes are ``blocks``."""
    digest = hashlib.sha256(_hash_of_json(dict(origin)).encode())
    digest.update(repr([str(part) for part in (state[0], *map(float, state[2:]))] if state else []).encode())
    for array in (np.asarray(state[1] if state else (), np.uint32), np.asarray(accepted, float), blocks):
        digest.update(str(array.shape).encode() + array.tobytes())
    return digest.hexdigest()


def _block_hashes(steps: np.ndarray, log_prob: np.ndarray) -> np.ndarray:
    """SHA-256 of every BLOCK_STEPS steps, (B, 32) bytes."""
    hashes = []
    for start in range(0, len(steps), BLOCK_STEPS):
        digest = hashlib.sha256()
        for array in (steps, log_prob):
            digest.update(np.asarray(array[start : start + BLOCK_STEPS], dtype="<f8").tobytes())
        hashes.append(np.frombuffer(digest.digest(), np.uint8))
    return np.array(hashes, np.uint8).reshape(len(hashes), -1)


def _hash_of_recording(recording: Recording) -> str:
    digest = hashlib.sha256()
    for field in dataclasses.fields(recording):
        if field.name not in NOT_OF_CONTENT:
            digest.update(field.name.encode())
            for part in _parts(getattr(recording, field.name)):
                digest.update(part)
    return digest.hexdigest()


def _parts(value: Any) -> list[bytes]:
    """A field of a recording as bytes."""
    if isinstance(value, Time):
        return [value.scale.encode(), *(np.asarray(part, "<f8").tobytes() for part in (value.jd1, value.jd2))]
    if isinstance(value, np.ndarray) and value.dtype != object:
        return [f"{value.dtype.str} {value.shape}".encode(), np.ascontiguousarray(value).tobytes()]
    return [json.dumps(value.tolist() if isinstance(value, np.ndarray) else value).encode()]


def _hash_of_json(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


class ChainFile:
    """Where a chain is put on disk, whole, each time it has grown by a quarter or WRITE_EVERY_S have passed, and at its end."""

    def __init__(self, path: Path, origin: Mapping[str, Any], write: Write) -> None:
        self.path, self.origin, self.write = path, origin, write
        self._length, self._clock = 0, time.monotonic()

    def resumed(self, sampler: emcee.EnsembleSampler) -> emcee.State | None:
        """The last state of the chain on disk, with which the sampler's backend is filled; None if there is none."""
        stored = read_chain(self.path)
        if stored is None:
            return None
        check_origin(self.path, stored, self.origin)
        backend = sampler.backend
        backend.reset(*stored.steps.shape[1:])
        backend.grow(len(stored.steps), None)
        backend.chain[:] = stored.steps
        backend.log_prob[:] = stored.log_prob
        backend.accepted[:] = stored.accepted
        backend.iteration = len(stored.steps)
        backend.random_state = stored.random_state
        last: Any = backend.get_last_sample()
        if not np.allclose(sampler.log_prob_fn(last.coords), last.log_prob, rtol=1e-6, atol=1e-6):
            raise InputError(
                self.path,
                None,
                "densities that this version of torchlc does not give for its last step",
                "the chain of this version",
                ANEW,
            )
        self._length = backend.iteration
        return last

    def keep(self, chain: emcee.backends.Backend, *, finished: bool) -> None:
        """Write the chain if it is due."""
        grown = chain.iteration >= self._length + max(200, self._length // 4)
        if grown or finished or time.monotonic() > self._clock + WRITE_EVERY_S:
            write_chain(self.path, chain, self.origin, self.write)
            self._length, self._clock = chain.iteration, time.monotonic()
