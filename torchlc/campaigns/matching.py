"""Which object of a file of elements a recording is of, by number or name in its file's name or in the file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torchlc.errors import InputError
from torchlc.readers.formats import read_header
from torchlc.scene.reading import Reading
from torchlc.scene.tle import Elements

NOT_RECORDINGS = (".toml", ".html", ".json", ".md", ".png", ".pdf", ".obj", ".stl", ".zip")
SAID = re.compile(r"\b(object|satellite|target|norad|catalog\w*|designation)\b", re.IGNORECASE)
"""Keys of metadata and words of comments beside which an object is named."""
WHOLE_NUMBER = 5
"""Digits from which on a number is taken for one of the catalogue; shorter ones need the word for it beside them."""
AFTER_ITS_WORD = re.compile(
    r"(?:norad|catalog(?:ue)?|cat|satno|sat|ssn)[\s_#:=.-]*(?:id|no|number)?[\s_#:=.-]*0*(\d{1,9})(?!\d)",
    re.I,
)


@dataclass(frozen=True)
class Match:
    """A recording's file, and the sets of its object; none, with the ``reason``, where it is not known which."""

    recording: Path
    sets: tuple[Elements, ...]
    reason: str = ""


def match_files(
    folder: Path, sets: Sequence[Elements], leave: Sequence[Path] = (), reading: Reading | None = None
) -> list[Match]:
    """Every file of ``folder`` that may be a recording, in order of names, with its object; ``reading`` says how they are
    read."""
    if not folder.is_dir():
        raise InputError(folder, None, "no such directory", "a folder of recordings")
    left = {path.resolve() for path in leave}
    files = sorted(
        path
        for path in folder.iterdir()
        if path.is_file()
        and not path.name.startswith(".")
        and path.suffix.lower() not in NOT_RECORDINGS
        and path.resolve() not in left
    )
    if not files:
        raise InputError(folder, None, "no file that may be a recording", "recordings, one object a file")
    return [_match(path, sets, reading) for path in files]


def _match(path: Path, sets: Sequence[Elements], reading: Reading | None) -> Match:
    by_name = _objects_in(path.stem, sets)
    try:
        header = read_header(path, reading)
    except InputError as error:
        return Match(path, (), f"cannot be read: {error}")
    said = [f"{key} {value}" for key, value in header.meta.items() if SAID.search(str(key).replace("_", " "))]
    said += [line for line in header.comments if SAID.search(line)]
    inside = [number for line in said for number in _objects_in(line, sets)]
    chosen = set(by_name) or set(inside)
    if by_name and inside and not set(by_name) & set(inside):
        return Match(
            path, (), f"its name says {_labels(by_name, sets)}, the file says {_labels(inside, sets)}"
        )
    if by_name and inside:
        chosen = set(by_name) & set(inside)
    if len(chosen) != 1:
        reason = "no number or name of an object" if not chosen else f"fits {_labels(sorted(chosen), sets)}"
        return Match(path, (), f"{reason} in its name or at its beginning")
    number = chosen.pop()
    return Match(path, tuple(elements for elements in sets if elements.lines[0][2:7] == number))


def _objects_in(text: str, sets: Sequence[Elements]) -> list[str]:
    """Catalogue numbers (as in the lines) of the objects that a text names: by number, else by the longest name."""
    objects = {elements.lines[0][2:7]: elements for elements in sets}
    numbers = {number.lstrip("0") for number in AFTER_ITS_WORD.findall(text)}
    numbers |= {
        number.lstrip("0")
        for number in re.findall(r"(?<![\w.])\d+(?![\w.])", text.replace("_", " "))
        if len(number) >= WHOLE_NUMBER
    }
    if text.strip().isdigit():
        numbers.add(text.strip().lstrip("0"))
    numbered = [
        key for key, elements in objects.items() if {elements.number, elements.whole_number} & numbers
    ]
    if numbered:
        return numbered
    words = _words(text)
    lengths = {
        key: len(words_of_name)
        for key, elements in objects.items()
        if (words_of_name := _words(elements.name or "")) and _within(words_of_name, words)
    }
    longest = max(lengths.values(), default=0)
    return [key for key, length in lengths.items() if length == longest]


def _words(text: str) -> list[str]:
    """Runs of letters and runs of digits, the latter without zeros in front."""
    return [word.lstrip("0") or "0" for word in re.findall(r"[a-z]+|\d+", text.lower())]


def _within(part: Sequence[str], whole: Sequence[str]) -> bool:
    return any(list(whole[k : k + len(part)]) == list(part) for k in range(len(whole) - len(part) + 1))


def _labels(numbers: Sequence[str], sets: Sequence[Elements]) -> str:
    objects = {elements.lines[0][2:7]: elements.label for elements in sets}
    return ", ".join(objects[number] for number in dict.fromkeys(numbers))
