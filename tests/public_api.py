"""What docs/reference.md documents; ``python -m tests.public_api > tests/public_api.txt`` records it."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import torchlc

REFERENCE = Path(__file__).parent.parent / "docs" / "reference.md"
ENTRY = re.compile(
    r"^\.\. auto(?:function|class|exception):: ([\w.]+).*\n(?:   :members:(.*)\n)?", re.MULTILINE
)


def documented() -> Iterator[tuple[str, list[str]]]:
    """Each name of the page with the members that it lists."""
    for name, members in ENTRY.findall(REFERENCE.read_text(encoding="utf-8")):
        yield name, [one.strip() for one in members.split(",") if one.strip()]


def lines() -> Iterator[str]:
    for name, members in documented():
        module, _, short = name.rpartition(".")
        thing = getattr(importlib.import_module(module) if module else torchlc, short)
        yield f"{name}{_signature(thing)}"
        for member in members:
            yield f"{name}.{member}{_signature(getattr(thing, member, None))}"


def _signature(thing: object) -> str:
    """Names, kinds and defaults of the arguments of what can be called; annotations are for readers."""
    if not callable(thing) or (inspect.isclass(thing) and issubclass(thing, torchlc.Scene | Exception)):
        return ""
    found = inspect.signature(thing)
    plain = [one.replace(annotation=inspect.Parameter.empty) for one in found.parameters.values()]
    return str(found.replace(parameters=plain, return_annotation=inspect.Signature.empty))


if __name__ == "__main__":
    print("\n".join(lines()))
