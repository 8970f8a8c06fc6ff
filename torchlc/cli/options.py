"""Options and arguments that commands share, and numbers and times as they are typed."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from torchlc.cli import completion
from torchlc.files.decimals import advice, decimal


def number(text: str, low: float = -math.inf, *, metavar: str = "FLOAT", show_default: bool = True) -> Any:
    """An option that takes a finite number from ``low`` on, written as in a file: no underscores, no digits
    of other scripts.
    """

    def parser(value: Any) -> Any:  # a function of its own: typer asks a parser for its name
        return typed(low, math.inf, value)

    return typer.Option(help=text, metavar=metavar, show_default=show_default, parser=parser)


def whole_number(text: str, low: int, high: int | None = None, *, show_default: bool = True) -> Any:
    """An option that takes a whole number from ``low`` to ``high``."""
    metavar = f"INTEGER [{low} or more]" if high is None else f"INTEGER [{low} to {high}]"

    def parser(value: Any) -> Any:
        return typed(low, math.inf if high is None else high, value, whole=True)

    return typer.Option(help=text, metavar=metavar, show_default=show_default, parser=parser)


def typed(low: float, high: float, value: Any, *, whole: bool = False) -> Any:
    """The number that was typed; the parser of an option. A default is one already."""
    if not isinstance(value, str):
        return value
    kind = "whole number" if whole else "number"
    try:
        found = decimal(value)
        if whole:
            found = int(value) if math.isfinite(found) else math.nan
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise typer.BadParameter(f"{value[:40]!r}; expected a {kind}. {advice(value) or ''}".rstrip(". "))
    if not low <= found <= high:
        expected = f"{low:g} or more" if high == math.inf else f"{low:g} to {high:.0f}"
        raise typer.BadParameter(f"{value[:40]}; expected {expected}")
    return found


def moment(text: str) -> str | float:
    """A time as typed: a Julian date, a date alone (from 0 h), or ISO text as it is."""
    try:
        return decimal(text)
    except ValueError:
        return f"{text}T00:00:00" if re.fullmatch(r"\d{4}-\d\d-\d\d", text, re.ASCII) else text


def directory(value: str | Path) -> Path:
    """The directory that was typed; the parser of an option."""
    if not str(value):  # as of a shell's variable that is not set; Path("") is the folder one is in
        raise typer.BadParameter("it is empty; expected the name of a directory")
    return Path(value)


SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).", show_default=False)]
RecordingFile = Annotated[
    Path,
    typer.Argument(metavar="OBS", help="Recording, in any of the formats that are read.", show_default=False),
]
RESULTS: Any = typer.Option(
    "-o", "--out", metavar="DIR", help="Directory for the results.", show_default=False, parser=directory
)
Out = Annotated[Path, RESULTS]
OutIfWanted = Annotated[Path | None, RESULTS]
"""Without it results are only shown."""
Seed = Annotated[int, whole_number("Seed of everything random.", 0, 2**32 - 1)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Threads = Annotated[int | None, whole_number("Threads of the computation.", 1, 1024, show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
Budget = Annotated[
    float | None,
    number("CPU seconds of the search, after which the best so far is the answer.", 1.0, show_default=False),
]
Use = Annotated[
    str | None,
    typer.Option(
        help="mag or flux, of a recording that has both.", show_default=False, autocompletion=completion.kinds
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=COLUMN,...",
        help="Which column is what, as in time=JD_UTC,mag=V,mag_err=e_V; also time_format, date_order, time_scale, time_zone, "
        "time_mark, exptime, object, bad, delimiter, decimal, non_detections, longest_gap.",
        show_default=False,
    ),
]
Trust = Annotated[bool, typer.Option("--trust", help="Let the scene name files outside its own folder.")]
