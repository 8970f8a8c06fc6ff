"""What tests of several files begin with."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from skyfield.api import Loader
from skyfield_data import get_skyfield_data_path

import torchlc
from tests.ball import BALL, ERROR, ROWS
from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.noisy_rows import FREE
from tests.small_case import write_case
from tests.warm import server
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, load_recording
from torchlc.scene import Scene, load_scene

DEMO = Path(__file__).parents[1] / "torchlc" / "demo"


def pytest_configure() -> None:
    """A shell without job control lets what it starts in the background ignore Ctrl-C, nohup a hang-up, and so would the programs that
    tests start and interrupt: these inherit what is ignored, not what is handled."""
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)


@pytest.fixture(scope="session")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The address of a server of processes that have their libraries loaded, and a folder for PATH whose ``torchlc`` asks it."""
    with server(tmp_path_factory.mktemp("warm")) as started:
        yield started


@pytest.fixture
def read(tmp_path: Path):
    """Reads a recording from text, with a scene's text if given."""

    def load(content: str | bytes, scene: str | None = None, **options) -> Recording:
        path = tmp_path / "recording.txt"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_recording(path, None if scene is None else Scene.from_toml(scene), **options)

    return load


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Paths of a small scene and its recording."""
    scene, recording = write_case(tmp_path_factory.mktemp("case"))
    return str(scene), str(recording)


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory):
    """A scene and seven rows of its white plate, which fades by a magnitude, one every second."""
    scene = still(PLATE, FREE)
    folder = tmp_path_factory.mktemp("seven")
    return scene, seen_from(scene, folder, tilted(np.linspace(5, 65, 7)), tilted(10, 180))


@pytest.fixture(scope="module")
def demo():
    """The demo's scene with the light of its own model at half of what its priors allow, normal errors added."""
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    model = LightCurve(scene, recording)
    with torch.no_grad():
        light = model(model.parameter_set.start()).numpy()
    noise = recording.error * np.random.default_rng(3).normal(size=len(light))
    return scene, replace(recording, observed=light + noise)


@pytest.fixture(scope="module")
def demo_search(demo):
    search = Search(Workbench(*demo), Clock(None), 0)
    search.null()
    return search


@pytest.fixture(scope="module")
def demo_refit(demo_search):
    return demo_search.visited[Hypothesis()]


@pytest.fixture(scope="module")
def sky():
    """Skyfield's time scale and its ephemeris of the planets."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # its table of the Earth's rotation ends before today
        load = Loader(get_skyfield_data_path(), verbose=False)
    ephemeris = load("de421.bsp")
    yield load.timescale(builtin=True), ephemeris
    ephemeris.close()


@pytest.fixture(scope="session")
def ball(tmp_path_factory):
    """A ball whose zero point alone is free: everything is linear."""
    folder = tmp_path_factory.mktemp("ball")
    (folder / "scene.toml").write_text(BALL)
    curve = torchlc.simulate(
        folder / "scene.toml",
        start="2026-03-15T19:00:00",
        hours=5.0,
        cadence=5 * 3600 / ROWS,
        noise=ERROR,
        seed=3,
    )
    return torchlc.load(folder / "scene.toml", curve.write(folder / "recording.ecsv"))
