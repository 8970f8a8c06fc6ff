"""Broken, odd and merely unusual inputs: the files of each, and what must come of them.

Each case is a small change of one of the good scenes and recordings. ``outcome`` is "exit2" (refused
with one line that holds ``message``), "dropped" (read, one row counted under the reason ``message``) or
"warning" (read, with a warning that holds it).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.good_input import ALTAZ_RECORDING, ALTAZ_SCENE, RECORDING, SCENE, VECTOR_RECORDING, VECTOR_SCENE


@dataclass(frozen=True)
class Case:
    """Files by name (``scene.toml`` and ``recording.csv`` are the two loaded), and what must come of them."""

    name: str
    files: dict[str, str | bytes]
    outcome: str
    message: str

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write the files into ``folder``; the paths of scene and recording."""
        for name, content in self.files.items():
            path = folder / name
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / "scene.toml", folder / "recording.csv"


def case_of(
    name: str,
    message: str,
    *,
    scene: str | bytes = SCENE,
    recording: str | bytes = RECORDING,
    outcome: str = "exit2",
) -> Case:
    return Case(name, {"scene.toml": scene, "recording.csv": recording}, outcome, message)


def scene_case(
    name: str, old: str, new: str, message: str, base: str = SCENE, outcome: str = "exit2"
) -> Case:
    assert base.count(old) >= 1, (name, old)
    recording = {VECTOR_SCENE: VECTOR_RECORDING, ALTAZ_SCENE: ALTAZ_RECORDING}.get(base, RECORDING)
    return case_of(name, message, scene=base.replace(old, new, 1), recording=recording, outcome=outcome)


def rows_case(
    name: str, old: str, new: str, message: str, base: str = RECORDING, outcome: str = "exit2"
) -> Case:
    assert base.count(old) >= 1, (name, old)
    scene = {VECTOR_RECORDING: VECTOR_SCENE, ALTAZ_RECORDING: ALTAZ_SCENE}.get(base, SCENE)
    return case_of(name, message, scene=scene, recording=base.replace(old, new, 1), outcome=outcome)
