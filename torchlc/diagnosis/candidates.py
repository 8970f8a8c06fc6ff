"""Names of candidate effects, as a person gives them: one check for the verb, the command line and campaigns."""

from __future__ import annotations

from collections.abc import Sequence

from torchlc.effects import Entry, effect_class, names
from torchlc.errors import InputError, option
from torchlc.lightcurve.assembled import Assembly
from torchlc.scene.problems import shown
from torchlc.suggest import did_you_mean

DIVISIONS = ("curve", "night", "object")
"""What a diagnosis may divide an offset by."""


def check_candidates(effects: Sequence[str] | None, assembly: Assembly | None = None) -> None:
    """Raise InputError unless the library has every one of these effects, each ``name``, ``name[target]``, or either
    with ``@curve``, ``@night`` or ``@object``; and unless a target is there in an ``assembly``, if given."""
    known = names()
    for text in effects or ():
        entry = Entry.parse(text)
        if entry.name not in known:
            raise InputError(
                None,
                option("effects"),
                f"unknown effect {shown(text)}",
                f"some of {', '.join(known)}",
                did_you_mean(entry.name, known),
            )
        divisible = effect_class(entry.name).divisible
        if entry.width is not None or (entry.per is not None and not (divisible and entry.per in DIVISIONS)):
            raise InputError(
                None,
                option("effects"),
                shown(text),
                f"{entry.name} or, to give each a value, {entry.name}@curve, @night or @object"
                if divisible
                else f"{entry.name} without @ and ~: it has one value for the whole recording",
            )
        if assembly is not None and entry.per is not None:
            _, members = assembly.row_index.get(entry.per, (None, ()))
            if len(members) < 2:
                has = "one" if members else "no column"
                expected = f"several {entry.per}s, of which the recording has {has}"
                raise InputError(None, option("effects"), shown(text), expected)
        if entry.target is not None and assembly is not None:
            targets = [
                target for target in effect_class(entry.name).targets(assembly.context) if target is not None
            ]
            if entry.target not in targets:
                raise InputError(
                    None,
                    option("effects"),
                    f"{shown(text)}: {entry.name} cannot be applied to {shown(entry.target)}",
                    f"one of {', '.join(targets)}" if targets else f"{entry.name} without brackets",
                    did_you_mean(entry.target, targets),
                )
