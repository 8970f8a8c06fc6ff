"""What tests of several files begin with."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchlc.readers import Recording, load_recording
from torchlc.scene import Scene


@pytest.fixture
def read(tmp_path: Path):
    """Reads a recording from text, with a scene's text if given."""

    def load(content: str | bytes, scene: str | None = None, **options) -> Recording:
        path = tmp_path / "recording.txt"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_recording(path, None if scene is None else Scene.from_toml(scene), **options)

    return load
