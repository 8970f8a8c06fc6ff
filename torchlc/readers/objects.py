"""Which of several objects in one file is meant."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from torchlc.errors import InputError, option
from torchlc.suggest import did_you_mean

MOST_LISTED = 12
ALL = "*"
"""What is said in place of a name where every object of a file is wanted."""


def chosen_object(path: Path, names: Iterable[set[str]], wanted: str | None) -> str | None:
    """One name of the object wanted, of those of every row; None where all rows are wanted, for they are of one object or ALL is said.

    ``wanted`` is a name or number of it, or a part of a name that only one object has.
    """
    every = {frozenset(aliases) for aliases in names}
    if wanted is not None and wanted.strip() == ALL:
        return None
    if wanted is None:
        if len(every) <= 1:
            return None
        listed = sorted(" ".join(sorted(aliases)) for aliases in every)
        some = next(iter(sorted(min(every, key=sorted))), "")
        raise InputError(
            path,
            None,
            f"{len(every)} objects ({', '.join(listed[:MOST_LISTED])}{', ...' if len(every) > MOST_LISTED else ''})",
            "one object",
            f"Say which: {option('columns', f'object={some}')}, by its name, its number or a part of its name; "
            f"{option('columns', 'object=*')} takes all, for a fleet",
        )
    folded = wanted.strip().casefold()
    exact = [aliases for aliases in every if folded in {name.casefold() for name in aliases}]
    near = exact or [aliases for aliases in every if any(folded in name.casefold() for name in aliases)]
    if len(near) != 1:
        known = sorted(name for aliases in every for name in aliases)
        found = (
            "no object"
            if not near
            else f"{len(near)} objects ({', '.join(sorted(min(aliases) for aliases in near))[:200]})"
        )
        expected = f"one of {', '.join(known[:MOST_LISTED])}"[:300]
        raise InputError(
            path, "object", f"{found} called {wanted[:60]!r}", expected, did_you_mean(wanted, known)
        )
    return min(near[0])
