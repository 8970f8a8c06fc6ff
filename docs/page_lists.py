"""Lists that a reader of the repository sees in the place of a site's menus: pages of a folder, and public names with what they are."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

HERE = Path(__file__).parent
FOLDERS = ("tutorials", "how_to", "calibration")
SECTION = re.compile(r"^## (?P<title>.+?)$(?P<text>.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^\.\. auto(?:function|class|exception):: ([\w.]+)", re.MULTILINE)


def pages_of(folder: str) -> str:
    """A link to every page of a folder but its index, by its title."""
    pages = [page for page in sorted((HERE / folder).glob("*.md")) if page.stem != "index"]
    titles = [page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for page in pages]
    return "\n".join(f"- [{title}]({page.name})" for title, page in zip(titles, pages, strict=True))


def names_of(text: str) -> str:
    """A table of the names that a section of the reference documents, with the first sentence of each."""
    rows = [
        f"| `{name.removeprefix('torchlc.')}` | {_first_sentence(name)} |" for name in ENTRY.findall(text)
    ]
    return "\n".join(["| name | what it is |", "|---|---|", *rows])


def _first_sentence(name: str) -> str:
    module, _, short = name.rpartition(".")
    thing = getattr(importlib.import_module(module or "torchlc"), short)
    paragraph = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
    sentence = re.split(r"(?<=[.:;])\s", paragraph)[0].rstrip(".:;").replace("``", "`")
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", sentence).replace("|", r"\|")


def page_lists() -> dict[str, str]:
    """By the name that a page asks for them by: ``pages_how_to``, ``names_verbs``."""
    reference = (HERE / "reference.md").read_text(encoding="utf-8")
    names = {
        f"names_{section['title'].lower().replace(' ', '_')}": names_of(section["text"])
        for section in SECTION.finditer(reference)
    }
    return {f"pages_{folder}": pages_of(folder) for folder in FOLDERS} | names
