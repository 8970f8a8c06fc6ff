"""Every block of code in the README and the documentation runs, and the pages build without a warning."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.run_page import blocks
from tests.warm import call
from torchlc.brdf import MODELS
from torchlc.shapes import SHAPES

ROOT = Path(__file__).parent.parent
NEEDS_SHARED = "<!-- needs ../shared -->"
"""Stands in a page whose code reads the data beside the repository."""
FETCHED = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"']?(?:https?:)?//[^>]*>")
PAGES = sorted(
    page
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    if "_build" not in page.parts and any(blocks(page))
)
EVERY = {
    "README.md": 8,
    "docs/how_to/runs.md": 8,
    "docs/how_to/how_long_will_it_take.md": 8,
    "docs/tutorials/my_own_satellite.md": 8,
    "docs/tutorials/my_first_fit.md": 3,
    "docs/tutorials/why_does_it_not_fit.md": 3,
    "docs/adding_an_effect.md": 3,
}
"""Of which rows of the demo's recording the code of a page runs here: every eighth where it holds no result to anything, every
third where only the effect that is missing has to be named."""


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_code_of_a_page_runs(page: Path, tmp_path: Path, warm: tuple[str, Path]) -> None:
    if (ROOT.parent / "shared" / "data").is_dir():
        (tmp_path / "shared").symlink_to(ROOT.parent / "shared")
    elif NEEDS_SHARED in page.read_text(encoding="utf-8"):
        pytest.skip("../shared is not here")
    here = tmp_path / "here"
    here.mkdir()
    for name in ("scene.toml", "recording.ecsv"):
        shutil.copy(ROOT / "torchlc" / "demo" / name, here)
    every = EVERY.get(str(page.relative_to(ROOT)), 1)
    if every > 1:
        lines = (here / "recording.ecsv").read_text(encoding="utf-8").splitlines(keepends=True)
        rows = next(index for index, line in enumerate(lines) if not line.startswith("#")) + 1
        (here / "recording.ecsv").write_text("".join([*lines[:rows], *lines[rows::every]]), encoding="utf-8")
    address, programs = warm
    path = os.pathsep.join([str(programs), str(Path(sys.executable).parent), os.environ["PATH"]])
    said = tmp_path / "said"
    with said.open("wb") as out, Path(os.devnull).open("rb") as nothing:
        code = call(
            address,
            ["page", str(page)],
            cwd=here,
            env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"},
            streams=(nothing.fileno(), out.fileno(), out.fileno()),
        )
    assert code == 0, said.read_text(encoding="utf-8")[-6000:]


def test_pages_read_in_the_repository_as_on_the_site() -> None:
    """No raw mark of a template; numbers in the pages, and the list of effects, are those of the code."""
    sys.path[:0] = [str(ROOT / "docs" / folder) for folder in ("", "effects", "physics")]
    try:
        import conf
        import effect_library
        import fill_numbers
        import law_library
    finally:
        del sys.path[:3]
    for page in fill_numbers.pages():
        text = page.read_text(encoding="utf-8")
        assert "{{" not in re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL), page
        assert "```{" not in text, page  # a directive, which only a site shows
        assert text == fill_numbers.filled(text, conf.myst_substitutions), (
            f"{page}: python docs/fill_numbers.py"
        )
    library = ROOT / "docs" / "effects" / "library.md"
    assert library.read_text(encoding="utf-8") == effect_library.library(), "python docs/fill_numbers.py"
    laws = ROOT / "docs" / "physics" / "laws.md"
    assert laws.read_text(encoding="utf-8") == law_library.laws(), "python docs/fill_numbers.py"


def test_every_law_and_shape_is_in_the_page_of_scenes() -> None:
    page = (ROOT / "docs" / "formats" / "scene.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w-]+)`", page))
    assert set(MODELS) - named == set() and set(SHAPES) - named == set()


@pytest.mark.long
def test_the_pages_build_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("furo")
    pages = shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("_build"))
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(pages), str(tmp_path / "html")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert "panel_offset" in (tmp_path / "html" / "effects" / "library.html").read_text(encoding="utf-8")
    fetched = [
        (str(page.relative_to(tmp_path)), found)
        for page in (tmp_path / "html").rglob("*.html")
        for found in FETCHED.findall(page.read_text(encoding="utf-8"))
    ]
    assert not fetched, "the pages open without a network"
