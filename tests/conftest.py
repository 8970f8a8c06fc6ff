"""What tests of several files begin with."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.effects.cases import PLATE, seen_from, still, tilted
from tests.noisy_rows import FREE
from tests.small_case import write_case
from tests.warm import server
from torchlc.readers import Recording, load_recording
from torchlc.scene import Scene


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
