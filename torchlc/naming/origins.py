"""Whose a number is, and the full name that people read: one rule for all roles, so that equal names in different
roles never share a number.

A full name is ``owner.quantity``, such as "panel.n", or the quantity alone where the whole recording owns it
("zero_point"). What an effect is applied to, and the curve, station or night that a value belongs to, follow in
brackets. The names of materials, components and stations hold no brackets, so a bracket before the first dot marks a
name that carries its role: ``effects[appendage].n`` is the effect's where a material is called appendage too.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal

Role = Literal["materials", "components", "attitude", "calibration", "effects"]
ENTRY = re.compile(
    r"(?P<name>[^\[\]@~]+)(\[(?P<target>[^\[\]]+)\])?"
    r"(@(?P<per>curve|station|night|object))?(~(?P<width>\d+(\.\d*)?(e[-+]?\d+)?))?"
)
"""An item of a list of effects. Targets hold any sign but brackets."""


@dataclass(frozen=True)
class Origin:
    """Whose a number is: ``role``, the ``owner``'s name (empty for the calibration), its ``quantity``; the ``target``
    of an effect; and for a value of its own, what ``division`` (curve, station, night, object) it belongs to, and which."""

    role: Role
    owner: str
    quantity: str
    target: str | None = None
    division: str | None = None
    member: str | None = None

    def full_name(self, taken: Collection[str] = ()) -> str:
        """The name without its role, or with it where that is ``taken``."""
        plain = self._name(self.owner)
        return self._name(f"{self.role}[{self.owner}]") if plain in taken else plain

    def _name(self, owner: str) -> str:
        return (f"{owner}." if owner else "") + self.short

    @property
    def short(self) -> str:
        """The full name without its owner: the quantity and what follows in brackets."""
        return self.quantity + "".join(f"[{text}]" for text in (self.target, self.member) if text is not None)

    def of(self, division: str, member: str) -> Origin:
        """The same number of one curve, station or night."""
        return replace(self, division=division, member=member)


NOBODY = Origin("calibration", "", "")
"""Of a number that was made without an owner."""


def full_names(origins: Iterable[Origin]) -> dict[str, Origin]:
    """Origins by full name; one whose name an earlier one has carries its role."""
    named: dict[str, Origin] = {}
    for origin in origins:
        named[origin.full_name(named)] = origin
    return named
