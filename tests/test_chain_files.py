"""Chains that are not to be trusted, or not of the same inputs: refused in one line."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np
import pytest
import torch
from astropy.table import Table

import torchlc
from tests.small_case import write_case
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.inference.chain import read_chain


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with scene.toml, recording.ecsv and a fit of 250 steps in ``out``."""
    folder = tmp_path_factory.mktemp("fitted")
    scene, recording = write_case(folder, rows=9)
    torchlc.fit(scene, recording, steps=250, walkers=10, out=folder / "out")
    return folder


def test_the_chain_is_an_emcee_backend(fitted: Path):
    backend = emcee.backends.HDFBackend(str(fitted / "out" / "chain.h5"), read_only=True)
    assert backend.get_chain().shape == (250, 10, 4) and backend.iteration == 250
    assert np.isfinite(backend.get_log_prob()).all() and backend.random_state[0] == "MT19937"
    assert (backend.accepted > 0).all() and backend.get_autocorr_time(quiet=True).shape == (4,)


def overwritten(file: Any) -> None:
    file["mcmc/chain"][10:235] = 0.5


def one_bit(file: Any) -> None:
    steps = file["mcmc/chain"]
    steps[120, 3, 1] = np.nextafter(steps[120, 3, 1], np.inf)


def not_numbers(file: Any) -> None:
    file["mcmc/chain"][5, 2] = np.nan


def other_densities(file: Any) -> None:
    file["mcmc/log_prob"][7] += 1e-9


def no_random_state(file: Any) -> None:
    for index in range(5):
        del file["mcmc"].attrs[f"random_state_{index}"]


def other_random_state(file: Any) -> None:
    key = file["mcmc"].attrs["random_state_1"].copy()
    key[17] ^= 1
    file["mcmc"].attrs["random_state_1"] = key


def moved_position(file: Any) -> None:
    file["mcmc"].attrs["random_state_2"] += 1


def other_acceptance(file: Any) -> None:
    file["mcmc/accepted"][0] += 1


def negative_steps(file: Any) -> None:
    file["mcmc"].attrs["iteration"] = -3


def fewer_steps(file: Any) -> None:
    file["mcmc"].attrs["iteration"] = 200


def steps_in_words(file: Any) -> None:
    file["mcmc"].attrs["iteration"] = "many"


def a_billion_steps(file: Any) -> None:
    file["mcmc"].attrs["iteration"] = 10**9
    for name in ("chain", "log_prob"):
        file[f"mcmc/{name}"].resize(10**9, axis=0)


def integers(file: Any) -> None:
    steps = file["mcmc/chain"][:].astype(int)
    del file["mcmc/chain"]
    file["mcmc/chain"] = steps


def integer_names(file: Any) -> None:
    origin = json.loads(file["mcmc"].attrs["torchlc_origin"]) | {"parameters": [1, 2, 3, 4]}
    file["mcmc"].attrs["torchlc_origin"] = json.dumps(origin)
    file["mcmc"].attrs["parameters"] = np.arange(4)


def no_origin(file: Any) -> None:
    del file["mcmc"].attrs["torchlc_origin"]


def a_bomb(file: Any) -> None:
    """A gigabyte of zeros in a megabyte."""
    del file["mcmc/chain"]
    file["mcmc"].create_dataset(
        "chain", (3_000_000, 10, 4), "f8", compression="gzip", chunks=(100_000, 10, 4)
    )
    file["mcmc"].attrs["iteration"] = 3_000_000


def elsewhere(file: Any) -> None:
    del file["mcmc/chain"]
    file["mcmc/chain"] = h5py.ExternalLink("/etc/passwd", "chain")


def nothing(file: Any) -> None:
    del file["mcmc"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (overwritten, "steps 1 to 100 are not what was written"),
        (one_bit, "steps 101 to 200 are not what was written"),
        (not_numbers, "steps 1 to 100 are not a number"),
        (other_densities, "steps 1 to 100 are not what was written"),
        (no_random_state, "no random state"),
        (other_random_state, "random state"),
        (moved_position, "random state"),
        (other_acceptance, "settings, random state or hashes"),
        (negative_steps, "iteration -3"),
        (fewer_steps, "chain of float64 and shape (250, 10, 4)"),
        (steps_in_words, "iteration many"),
        (a_billion_steps, "which a file of"),
        (integers, "chain of int64"),
        (integer_names, "an unreadable record of what it was made from"),
        (no_origin, "no record of what it was made from"),
        (a_bomb, "which a file of"),
        (elsewhere, "no dataset chain"),
        (nothing, "no record of what it was made from"),
    ],
)
def test_a_damaged_chain_is_refused_in_one_line(damage, said: str, fitted: Path, tmp_path: Path):
    """Before the search, and without reading it whole."""
    out = shutil.copytree(fitted / "out", tmp_path / "out")
    with h5py.File(out / "chain.h5", "a") as file:
        damage(file)
    refused(fitted, out, said, limit_mib=64)


def refused(folder: Path, out: Path, said: str, limit_mib: float, *more: str) -> None:
    """``fit --resume`` ends with 2 and one line that says what to do, in little memory, and has changed nothing."""
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    arguments = ["fit", str(folder / "scene.toml"), str(folder / "recording.ecsv"), "-o", str(out), "--resume",
                 "--steps", "260", "--walkers", "10", *more]  # fmt: skip
    error = io.StringIO()
    tracemalloc.start()
    with contextlib.redirect_stderr(error):
        assert run(arguments) == 2
    assert tracemalloc.get_traced_memory()[1] < limit_mib * 2**20
    tracemalloc.stop()
    (line,) = error.getvalue().splitlines()
    assert said in line and "chain.h5" in line, line
    assert "Remove it to start anew" in line
    assert before == {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}


@pytest.mark.parametrize("kind", ["empty", "text", "truncated", "pipe", "directory", "link"])
def test_what_is_no_chain_is_refused_in_one_line(kind: str, fitted: Path, tmp_path: Path):
    out = shutil.copytree(fitted / "out", tmp_path / "out")
    chain = out / "chain.h5"
    whole = chain.read_bytes()
    chain.unlink()
    match kind:
        case "pipe":
            os.mkfifo(chain)
        case "directory":
            chain.mkdir()
        case "link":
            chain.symlink_to(fitted / "out" / "chain.h5")
        case _:
            chain.write_bytes({"empty": b"", "text": b"steps", "truncated": whole[: len(whole) // 2]}[kind])
    words = {"pipe": "a named pipe", "directory": "a directory", "link": "a symbolic link"}
    refused(fitted, out, words.get(kind, "not readable as a chain"), 64)
    if kind in words:
        with pytest.raises(InputError, match=words[kind]):
            read_chain(chain)


@pytest.mark.parametrize("change", ["recording", "scene", "comment", "walkers", "seed", "copy"])
def test_a_chain_goes_on_with_its_own_inputs_only(change: str, fitted: Path, tmp_path: Path):
    """A magnitude that is 1e-6 fainter, a prior that is a little narrower; but not comments and places of files."""
    folder = shutil.copytree(fitted, tmp_path / "case")
    scene, recording = folder / "scene.toml", folder / "recording.ecsv"
    more: list[str] = []
    match change:
        case "recording":
            table = Table.read(recording, format="ascii.ecsv")
            table["mag"][4] += 1e-6
            table.write(recording, format="ascii.ecsv", overwrite=True)
        case "scene":
            text = scene.read_text()
            assert "high = 1e6" in text
            scene.write_text(text.replace("high = 1e6", "high = 0.9e6"))
        case "comment":
            scene.write_text(f"# looked at again\n{scene.read_text()}")
        case "walkers":
            more = ["--walkers", "12"]
        case "seed":
            more = ["--seed", "7"]
    said = {
        "recording": "other data: another recording",
        "scene": "another scene",
        "walkers": "a chain of 10 walkers over",
        "seed": "a chain of seed 0; expected one of seed 7",
    }
    if change in said:
        refused(folder, folder / "out", said[change], 256, *more)
    else:
        result = torchlc.fit(scene, recording, steps=260, walkers=10, out=folder / "out", resume=True)
        whole = torchlc.fit(scene, recording, steps=260, walkers=10)
        assert result.posterior is not None and whole.posterior is not None
        assert torch.equal(result.posterior.theta, whole.posterior.theta), "as one that was never stopped"
