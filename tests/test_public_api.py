"""The public interface changes on purpose only; CONTRIBUTING.md says how to record a change that is meant."""

from __future__ import annotations

import tomllib
from pathlib import Path

import torchlc
from tests.public_api import documented, lines

ROOT = Path(__file__).parent.parent


def test_what_is_documented_is_what_is_on_record() -> None:
    recorded = (ROOT / "tests" / "public_api.txt").read_text(encoding="utf-8").splitlines()
    assert list(lines()) == recorded


def test_every_public_name_is_documented() -> None:
    assert set(torchlc.__all__) - {"__version__"} == {name for name, _ in documented() if "." not in name}


def test_one_version_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == torchlc.__version__
    assert f"version: {torchlc.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {torchlc.__version__}\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
