"""The numbers of the page: each stands before a comment that names it, ``4.23<!-- figure_2 orbit_1/peak_mag -->``.

python examples/paper/page.py docs/real_data/index.md    # after the examples have run into docs/real_data
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

MARKED = re.compile(
    r"(?P<shown>-?\d[\d,.]*(?:e-?\d+)?%?|yes|no)<!-- (?P<file>\w+) (?P<key>[^>]+?)(?: to (?P<digits>\d) digits)? -->"
)


def filled(text: str, directory: Path) -> str:
    """The page with every named number taken from NAME.json, to the decimals that stand there, and ``to 2 digits``
    where its comment ends so.
    """

    def number(match: re.Match[str]) -> str:
        value: Any = json.loads((directory / f"{match['file']}.json").read_text())
        for key in match["key"].split("/"):
            value = value[int(key)] if isinstance(value, list) else value[key]
        if match["digits"]:
            value = float(f"{value:.{match['digits']}g}")
        return shown_like(match["shown"], value) + match[0][len(match["shown"]) :]

    return MARKED.sub(number, text)


def shown_like(shown: str, value: Any) -> str:
    """A value in the manner of what stands there: with its decimals, as a percentage, or with an exponent."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    number = 100 * value if shown.endswith("%") else value
    unit = "%" if shown.endswith("%") else ""
    digits = shown.removesuffix("%")
    if "e" in digits:
        return f"{number:.0e}"
    decimals = len(digits.partition(".")[2])
    return f"{number:,.{decimals}f}{unit}" if "," in digits else f"{number:.{decimals}f}{unit}"


def fill(page: Path) -> None:
    """Bring the numbers of a page up to date with the JSON beside it."""
    page.write_text(filled(page.read_text(encoding="utf-8"), page.parent), encoding="utf-8")


if __name__ == "__main__":
    for page in sys.argv[1:]:
        fill(Path(page))
