"""Formats of recordings, one file each; every module of this folder is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.naming import import_modules
from torchlc.readers.format import FORMATS, Format, read_head
from torchlc.readers.roles import assigned
from torchlc.readers.table import Header, encoding_of
from torchlc.scene.reading import Reading

if TYPE_CHECKING:
    from torchlc.scene import Scene


def formats() -> list[type[Format]]:
    """Every format in the order in which a file is offered to them."""
    latest_first = [*FORMATS.values()][::-1]
    return sorted(latest_first, key=lambda form: form.order)


def read_header(path: Path, reading: Reading | None = None, scene: Scene | None = None) -> Header:
    """What a file says before its rows, in the first format that recognises it, with its columns under our names."""
    reading = Reading() if reading is None else reading
    head = read_head(path, reading, scene)
    form = next(candidate for candidate in formats() if candidate.recognises(head))
    header = assigned(form.read(head), reading, form.columns)
    if encoding_of(path) == "cp1252":
        note = "the file is not UTF-8 text and was read as Windows-1252 (Latin-1): check names with accents"
        header = replace(header, notes=(note, *header.notes))
    return header


import_modules(__name__, __path__)
