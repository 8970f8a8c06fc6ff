"""A scene as TOML text, the inverse of reading it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from torchlc.files.numbers import Free


def toml_table(path: str, content: Mapping[str, Any], *, array: bool = False) -> str:
    """One ``[path]`` (or ``[[path]]``) with its keys; entries that are None are left out."""
    header = f"[[{path}]]" if array else f"[{path}]"
    lines = [f"{_key(key)} = {_value(value)}" for key, value in content.items() if value is not None]
    return "\n".join([header, *lines]) + "\n"


def toml_key(*names: str) -> str:
    """A dotted key, quoted where TOML needs it."""
    return ".".join(map(_key, names))


def toml_value(value: Any) -> str:
    """One value; tables are written inline."""
    return _value(value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _string(name)


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return repr(int(value))
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Free):
        value = value.model_dump(exclude_none=True, exclude={"prior"} if value.fixed else None)
    elif isinstance(value, BaseModel):
        value = {key: getattr(value, key) for key in type(value).model_fields}
    if isinstance(value, Mapping):
        pairs = (f"{_key(key)} = {_value(entry)}" for key, entry in value.items() if entry is not None)
        return "{ " + ", ".join(pairs) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise TypeError(f"no TOML for {type(value).__name__}")
