"""Whether a recording names the object whose elements its scene has, by catalogue number."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from torchlc.readers.roles import NAMES, plain
from torchlc.readers.table import Header
from torchlc.scene.tle import Elements, read_elements

if TYPE_CHECKING:
    from torchlc.scene import Scene

BEHIND_ITS_WORD = re.compile(
    r"(?<![a-z])(?:norad|satcat|satno|(?:catalog(?:ue)?|satellite)[\s_-]*(?:number|no|nr|id))"
    r"(?:[\s_-]*(?:catalog(?:ue)?|cat|sat))?(?:[\s_-]*(?:id|number|no|nr))?[\s_.:=#(-]*0*([A-HJ-NP-Z]?\d{1,9})(?!\w|\.\d)",
    re.IGNORECASE,
)
"""A number behind the word for it. A catalogue alone may be one of stars."""
NUMBER = re.compile(r"\s*0*(\d{1,9}|[A-HJ-NP-Z]\d{4})(?:\.0*)?\s*", re.ASCII)
"""A whole cell; programs that take the column for numbers write a decimal point."""
AT_THE_BEGINNING = re.compile(r"\s*0*(\d{5,6})(?!\S)", re.ASCII)
"""A number of five digits or more, before the name of an object or alone: shorter ones may be of a list of one's own."""
OF_THE_OBJECT = ("object", "satellite", "target")
"""Keys of metadata under which an object stands with its number first."""


def told_of_another(header: Header, scene: Scene | None, cells: Iterable[str]) -> list[str]:
    """A warning where the recording names another object than the scene's elements; none where either is not known.

    ``cells`` are those of the column of numbers or, without one, of objects, in the rows that are used.
    """
    named = _in_cells(header, cells)
    lines = [f"{key}: {value}" for key, value in header.meta.items() if isinstance(value, str)]
    lines += header.comments
    named = named or _in_lines(header, lines)
    if not named or scene is None:
        return []
    number = _number_of_elements(scene)
    if number is None or number in named:
        return []
    first = next(iter(named))
    more = f" and {len(named) - 1} more" if len(named) > 1 else ""
    return [
        f"the recording names object {first}{more}, but the elements of the scene are of {number}: "
        f"give the scene the elements of {first}, or take a recording of {number}"
    ]


def _in_cells(header: Header, cells: Iterable[str]) -> dict[str, None]:
    """Numbers in the order of the rows; in a column of names only what cannot be one."""
    of_numbers = (
        "object_number" in header.names or plain(header.theirs.get("object", "")) in NAMES["object_number"]
    )
    form = NUMBER if of_numbers else AT_THE_BEGINNING
    matches = (form.fullmatch(cell) for cell in cells)
    return dict.fromkeys(_in_digits(match[1]) for match in matches if match and match[1] != "0")


def _in_lines(header: Header, lines: Iterable[str]) -> dict[str, None]:
    named = [number for line in lines for number in BEHIND_ITS_WORD.findall(line)]
    for key, value in header.meta.items():
        if str(key).casefold() in OF_THE_OBJECT and (match := AT_THE_BEGINNING.match(str(value))):
            named.append(match[1])
    return dict.fromkeys(_in_digits(number) for number in named if number.strip("0"))


def _in_digits(number: str) -> str:
    """A catalogue number without a letter of the Alpha-5 scheme."""
    return Elements(None, (f"1 {number.upper():>5}", "")).whole_number if number[0].isalpha() else number


def _number_of_elements(scene: Scene) -> str | None:
    """The catalogue number of the scene's elements; None where they have none, or a placeholder."""
    if scene.orbit.tle is not None:
        number = Elements(None, scene.orbit.tle).whole_number
    elif scene.orbit.tle_file is not None:
        number = read_elements(scene.file_path(scene.orbit.tle_file))[0].whole_number
    else:
        return None
    return number if number.isdecimal() and number != "0" else None
