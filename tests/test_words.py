"""Plain words: sentences that can be read in one breath, and no words that point at nothing, in the pages, in the help of the
commands and in the docstrings of the public names.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
import typer.main

import torchlc
from tests.small_case import write_case
from torchlc.cli.app import app
from torchlc.diagnosis.coordinates import TITLES, coordinates, in_words
from torchlc.diagnosis.gate import Battery
from torchlc.diagnosis.words import statistic

ROOT = Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
]
READ_THROUGH = [*sorted((ROOT / "docs/tutorials").glob("*.md")), ROOT / "docs/formats/results.md"]
"""Pages for a first reader, and what every run writes: no colon makes two sentences of one there."""
MOST_WORDS = 30
"""Plain-language guides ask for 15 to 20 on average; what is longer than this is read twice."""
LATER = {"docs/physics/verdict.md": 10, "docs/effects/library.md": 5}
"""Pages that still have as many longer sentences; the second is made of docstrings of effects. Numbers only go down."""
EMPTY = (
    r"the (former|latter)", "aforementioned", "and so (on|forth)", "etc", "stuff", "somehow", "in order to",
    "due to the fact", "the fact that", "basically", "obviously", "of course", "simply", "just", "very",
)  # fmt: skip
"""Words that say nothing, or point at what the reader has to look for."""
POINTER = re.compile(rf"\b({'|'.join(EMPTY)})\b", re.IGNORECASE)


def blocks(text: str) -> list[str]:
    """Paragraphs, entries of lists and cells of tables, without code, formulas and comments."""
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL)
    found: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text):
        lines: list[str] = []
        for line in paragraph.splitlines():
            if line.lstrip().startswith("|"):
                found += line.strip().strip("|").split("|")
                continue
            if re.match(r"\s*([-*]|\d+\.)\s|#|!\[|>", line):
                found.append(" ".join(lines))
                lines = []
            lines.append(re.sub(r"^\s*([-*>#]+|\d+\.)\s*", "", line))
        found.append(" ".join(lines))
    return [block for block in found if block.strip()]


def sentences(block: str) -> list[str]:
    """Of a paragraph, to its full stops. A list of names in code counts as one word."""
    block = re.sub(r"``?[^`]+``?", "code", block)
    block = re.sub(r"code(\s*\([^)]*\))?((, | and | or |, and )code(\s*\([^)]*\))?)+", "code", block)
    block = re.sub(r"\]\([^)]*\)", "]", block)
    block = re.sub(r"\$[^$]*\$|:\w+:", "x", block)
    return [part for part in re.split(r"(?<=[.!?])\s+(?=[A-Z*\[(0-9]|code)", block) if part]


def breaths(block: str) -> list[str]:
    """Sentences of a paragraph, where a colon or a semicolon lets a reader breathe."""
    return [part for sentence in sentences(block) for part in re.split(r"[:;]\s", sentence) if part]


def words(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z0-9][\w'.-]*", sentence))


def long_sentences(text: str) -> list[str]:
    return [one for block in blocks(text) for one in breaths(block) if words(one) > MOST_WORDS]


def test_the_counter_counts():
    short = "One two three. Four five `six, seven` eight: nine ten."
    assert [words(one) for one in breaths(short)] == [3, 4, 2]
    assert [words(one) for one in sentences(short)] == [3, 6]
    assert long_sentences("word " * 31 + ".") and not long_sentences("word " * 30 + ".")
    assert not long_sentences("```\n" + "word " * 40 + "\n```")
    assert len(long_sentences("- " + "word " * 31 + "\n- " + "word " * 31)) == 2
    assert POINTER.search("It does the latter.") and not POINTER.search("Nothing is justified.")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_has_short_sentences(page: Path):
    found = long_sentences(page.read_text(encoding="utf-8"))
    assert len(found) <= LATER.get(str(page.relative_to(ROOT)), 0), found


@pytest.mark.parametrize("page", READ_THROUGH, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_that_is_read_through_has_short_sentences_up_to_the_full_stop(page: Path):
    found = [one for block in blocks(page.read_text(encoding="utf-8")) for one in sentences(block)]
    assert [one for one in found if words(one) > MOST_WORDS] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_points_at_something(page: Path):
    text = " ".join(re.sub(r"`[^`]*`", "", block) for block in blocks(page.read_text(encoding="utf-8")))
    assert [mark[0] for mark in POINTER.finditer(text)] == []


def helps() -> Iterator[tuple[str, str]]:
    """Every text of the command line's help, by command."""

    def walk(command: object, name: str) -> Iterator[tuple[str, str]]:
        for text in (getattr(command, "help", None), getattr(command, "epilog", None)):
            if text:
                yield name, text
        for parameter in getattr(command, "params", []):
            yield f"{name} {parameter.name}", getattr(parameter, "help", None) or ""
        for other, inner in getattr(command, "commands", {}).items():
            yield from walk(inner, f"{name} {other}")

    yield from walk(typer.main.get_command(app), "torchlc")


def docstrings() -> Iterator[tuple[str, str]]:
    """Of the public names and their public members."""
    for name in torchlc.__all__:
        value = getattr(torchlc, name)
        yield name, inspect.getdoc(value) or "" if callable(value) else ""
        if inspect.isclass(value):
            for key, member in vars(value).items():
                if not key.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
                    yield f"{name}.{key}", inspect.getdoc(member) or ""


@pytest.mark.parametrize("texts", [helps, docstrings], ids=["help", "docstrings"])
def test_help_and_docstrings_have_short_sentences(texts: Callable[[], Iterator[tuple[str, str]]]):
    found = {name: long_sentences(text) for name, text in texts()}
    assert {name: long for name, long in found.items() if long} == {}
    pointers = {name: POINTER.findall(re.sub(r"``?[^`]+``?", "", text)) for name, text in texts()}
    assert {name: one for name, one in pointers.items() if one} == {}


def test_coordinates_and_statistics_of_a_diagnosis_are_told_in_words(tmp_path: Path):
    """No name of the program stands in a sentence, and what has a unit says it: of all coordinates that a box-wing in a low
    orbit has, and of all statistics of the battery."""
    scene, recording = torchlc.load(*write_case(tmp_path, rows=9))
    model = torchlc.LightCurve(scene, recording)
    known = coordinates(model, model.theta())
    known |= {"shadow_coordinate": known["flux"], "spin_phase": known["flux"]}
    assert {"sun_lon_body", "obs_lat_body", "glint_angle_deg[body/+X]"} <= set(known)
    assert {name.partition("[")[0] for name in known} == set(TITLES)
    for name in known:
        said = in_words(name, 5.366, 264.4)
        assert "_" not in said and "[" not in said
        assert ("5.37 and 264 " in said) == bool(TITLES[name.partition("[")[0]][1])
    assert in_words("shadow_coordinate", 5.366, 264.4).endswith("between 5.37 and 264 radii of the Sun")
    zeros = torch.zeros(1, len(recording), dtype=torch.float64)
    battery = Battery(
        zeros[0], torch.zeros(len(recording), dtype=torch.int64), known, {"lobe_tail": zeros}, True
    )
    for name in battery.statistics(zeros + 1, zeros):
        told = statistic(name)
        assert told != name and "'" not in told.replace("Sun's", "").replace("Earth's", "")
        assert "_" not in told.replace("lobe_tail (", "")
