"""What the comment lines above a table say: metadata, and how the file is to be read."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchlc.errors import InputError, option
from torchlc.readers.table import METADATA
from torchlc.scene.reading import SETTINGS, Reading, reading_of

TOLD = tuple(name for name in SETTINGS if name not in (*METADATA, "object"))
"""Keys of [recording] that a comment may say. What people write behind ``object`` is whom they observed, not which of
several objects of the file they want."""
KEY_AND_VALUE = re.compile(r"\s*([^\W\d_][\w .-]{0,39}?)\s*[:=]\s*(?!//)(\S.*?)\s*")
SECONDS = re.compile(r"(.*?)\s*(s|sec|seconds?)\.?", re.IGNORECASE)
"""A number with the unit that exposures have anyway."""


def key_and_value(line: str) -> tuple[str, str] | None:
    """The two sides of ``key: value`` or ``key = value``; None where a line is none."""
    match = KEY_AND_VALUE.fullmatch(line)
    return (match[1], match[2]) if match else None


def metadata_of(comments: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """What comment lines say as ``key: value``, keys of ``METADATA`` and ``TOLD`` in small letters; and the lines
    that say anything else than these keys."""
    meta, others = {}, []
    for line in filter(None, map(str.strip, comments)):
        pair = key_and_value(line)
        ours = pair is not None and pair[0].lower() in (*METADATA, *TOLD)
        if pair is not None:
            meta[pair[0].lower() if ours else pair[0]] = pair[1]
        if not ours:
            others.append(line)
    return meta, others


def told_in(source: Path, meta: Mapping[str, str], given: Reading) -> Reading:
    """What ``meta`` says with keys of ``TOLD``, checked as if the user had typed it, with what the user says
    (``given``) in its place."""
    reading = Reading()
    for key in TOLD:
        if key not in meta or key in given.model_fields_set:
            continue
        text = SECONDS.sub(r"\1", meta[key]) if key in ("exptime", "longest_gap") else meta[key]
        try:
            added = reading_of({key: text})
            if added.columns:  # an exposure that is no number would name a column
                raise InputError(option("columns"), key, repr(text[:40]), "a number of seconds")
        except InputError as error:
            hint = f"Correct the comment, or say {option('columns', f'{key}=...')}, which counts first; a comment of another name is only a remark"
            raise InputError(source, f"comment {key}", repr(meta[key][:40]), error.expected, hint) from None
        reading = reading.with_given(added)
    return reading.with_given(given)
