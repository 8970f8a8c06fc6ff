"""Tables of every shape, every format of recordings and every figure of a report, made from their classes: one that is defined
elsewhere has a row like those of the package. fill_numbers.py writes the tables into the pages."""

from __future__ import annotations

import inspect
import re
from typing import Any, get_args

from torchlc.files.numbers import Free
from torchlc.readers.format import Format
from torchlc.readers.formats import formats
from torchlc.report.figures import ReportFigure, registry
from torchlc.report.figures.contract import PAGES
from torchlc.shapes import SHAPES, Component, Part


def addition_tables() -> dict[str, str]:
    """By the name that a page asks for them by."""
    return {
        "every_shape": every_shape(),
        "every_format": every_format(),
        "format_details": format_details(),
        "every_figure": every_figure(),
    }


def every_shape() -> str:
    """The shapes by name, with their keys in a scene."""
    head = ("shape", "needs", "may have", "of these may be free", "what it is")
    return _table([head, *(shape_row(SHAPES[name]) for name in sorted(SHAPES))])


def shape_row(shape: type[Part]) -> tuple[str, ...]:
    """One shape: the keys that it adds to those of all components, and what its docstring and that of its keys say."""
    keys = {key: field for key, field in shape.keys.model_fields.items() if key not in Component.model_fields}
    needed = [key for key, field in keys.items() if field.is_required()]
    free = [key for key, field in keys.items() if _may_be_free(field.annotation)]
    meaning = "" if shape.keys is Component else _paragraphs(shape.keys)[0]
    described = f"{_sentence_and_rest(shape)[0]} {meaning}".strip()
    others = [key for key in keys if key not in needed]
    return (f"`{shape.kind}`", _code(needed), _code(others), _code(free), described)


def every_format() -> str:
    """The formats of recordings in the order in which a file is offered to them, those of equal order by name."""
    head = ("format", "file", "what is read")
    return _table([head, *map(format_row, _formats())])


def format_row(form: type[Format]) -> tuple[str, ...]:
    """One format: its name, what kind of file it is, and the first sentence of its docstring."""
    return (form.name, form.files, _sentence_and_rest(form)[0])


def format_details() -> str:
    """What the docstrings of the formats say beyond their first sentences, an entry a format."""
    return "\n".join(
        f"- **{form.name}.** {rest}" for form in _formats() if (rest := _sentence_and_rest(form)[1])
    )


def every_figure() -> str:
    """The figures of every report, in their order on it."""
    head = ("report", "file", "title", "what it shows")
    return _table([head, *(figure_row(figure) for page in PAGES for figure in registry(page))])


def figure_row(figure: ReportFigure) -> tuple[str, ...]:
    """One figure: whose report it is of, its file, its heading or else its name, and the first sentence of its docstring."""
    title = figure.heading or figure.name.replace("_", " ").capitalize()
    return (figure.page, f"`{figure.name}.png`", title, _sentence_and_rest(type(figure))[0])


def _formats() -> list[type[Format]]:
    return sorted(formats(), key=lambda form: (form.order, form.name.casefold()))


def _may_be_free(annotation: Any) -> bool:
    """Whether a value of this type, or a part of it, may be a free number."""
    return annotation is Free or any(map(_may_be_free, get_args(annotation)))


def _paragraphs(cls: type) -> list[str]:
    """A class's own docstring as a page writes it, a line a paragraph; nothing of a class without one, rather than its base's."""
    text = inspect.cleandoc(cls.__doc__ or "").replace("``", "`").replace("|", r"\|")
    text = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n")]


def _sentence_and_rest(cls: type) -> tuple[str, str]:
    """The first sentence of a docstring, to its full stop, and what follows it."""
    sentence, *others = re.split(r"(?<=\.)\s+(?=[A-Z`\"])", " ".join(_paragraphs(cls)), maxsplit=1)
    return sentence, "".join(others)


def _code(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _table(rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])
