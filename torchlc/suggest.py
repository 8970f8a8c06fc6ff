"""Help with misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Collection


def did_you_mean(word: str, known: Collection[str]) -> str | None:
    """A question that offers the known name nearest to ``word``, capitals aside; None if none is near."""
    folded = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower()[:100], folded, n=1)
    return f"Did you mean {folded[near[0]]!r}?" if near else None
