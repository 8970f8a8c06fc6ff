"""Where the scripts of this folder leave what they find: NAME.json and, where there is a figure, NAME.png."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from torchlc.figures.style import style

PAGE = Path(__file__).parents[2] / "docs" / "paper"
DPI = 100
Made = tuple[dict[str, Any], Figure | None]
"""The numbers of a figure or table, and the figure."""


def publish(script: str, make: Callable[[], Made]) -> None:
    """Run one script into the folder on the command line, by default the page's, and print its numbers."""
    directory = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    print(json.dumps(write(Path(script).stem, make, directory), indent=1))


def write(name: str, make: Callable[[], Made], directory: Path) -> dict[str, Any]:
    """Make one figure or table and write its files; the numbers, rounded as in the file."""
    directory.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({**style(9.5), "axes.grid": True}):
        numbers, figure = make()
        if figure is not None:
            figure.savefig(directory / f"{name}.png", dpi=DPI, facecolor="white")
    rounded = tidy(numbers)
    (directory / f"{name}.json").write_text(json.dumps(rounded, indent=1) + "\n")
    return rounded


def tidy(value: Any) -> Any:
    """Numbers to 5 significant digits; None for what is not a number."""
    if isinstance(value, dict):
        return {str(key): tidy(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [tidy(one) for one in value]
    if isinstance(value, bool | str | int) or value is None:
        return value
    number = float(value)
    return float(f"{number:.5g}") if math.isfinite(number) else None
