"""Numbers of the pages, written into them where they stand, so that a page reads the same in the repository and on the site:

    python docs/fill_numbers.py

A number that comes from the code or from an example stands between two comments, ``<!--name-->0.01<!--/-->``; ``{{ name }}``
asks for one. ``myst_substitutions`` of conf.py has the values. effects/library.md and physics/laws.md are written anew as well.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).parent
MARK = re.compile(r"\{\{ *(?P<asked>\w+) *\}\}|<!--(?P<name>\w+)-->.*?<!--/-->", re.DOTALL)


def filled(text: str, values: Mapping[str, object]) -> str:
    """The page with every number as it is now; a table stands between its comments on lines of its own."""

    def number(mark: re.Match[str]) -> str:
        name = mark["asked"] or mark["name"]
        value = str(values[name])
        return f"<!--{name}-->\n\n{value}\n\n<!--/-->" if "\n" in value else f"<!--{name}-->{value}<!--/-->"

    return MARK.sub(number, text)


def pages() -> list[Path]:
    return [page for page in sorted(HERE.rglob("*.md")) if "_build" not in page.parts]


def main() -> None:
    sys.path[:0] = [str(HERE), str(HERE / "effects"), str(HERE / "physics")]
    import conf
    from effect_library import library
    from law_library import laws

    (HERE / "effects" / "library.md").write_text(library(), encoding="utf-8")
    (HERE / "physics" / "laws.md").write_text(laws(), encoding="utf-8")
    for page in pages():
        before = page.read_text(encoding="utf-8")
        after = filled(before, conf.myst_substitutions)
        if after != before:
            page.write_text(after, encoding="utf-8")
            print(page.relative_to(HERE))


if __name__ == "__main__":
    main()
