"""Passes as a calendar (RFC 5545), an event each."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """A pass of an object, by its ``name`` and ``number``, over a ``place``; ``made``, ``begin`` and ``end`` are ISO UTC, ``lines``
    describe it."""

    name: str
    number: str | None
    place: str
    made: str
    begin: str
    end: str
    summary: str
    lines: Sequence[str]

    def written(self) -> list[str]:
        """The lines of the event, not folded."""
        begin, end = _stamp(self.begin), _stamp(self.end)
        key = hashlib.sha256(f"{self.name} {self.number} {self.place} {begin}".encode()).hexdigest()
        return [
            "BEGIN:VEVENT",
            f"UID:{key[:32]}@torchlc",
            f"DTSTAMP:{_stamp(self.made)}",
            f"DTSTART:{begin}",
            f"DTEND:{end}",
            f"SUMMARY:{_escaped(self.summary)}",
            f"LOCATION:{_escaped(self.place)}",
            f"DESCRIPTION:{_escaped(chr(10).join(self.lines))}",
            "END:VEVENT",
        ]


def calendar(events: Iterable[Event]) -> str:
    """The text of a calendar with these events."""
    lines = ["BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//torchlc//prediction//EN", "CALSCALE:GREGORIAN"]
    for event in events:
        lines += event.written()
    lines.append("END:VCALENDAR")
    return "".join(f"{part}\r\n" for line in lines for part in _folded(line))


def _stamp(iso: str) -> str:
    """ISO UTC as a calendar writes it, to the second."""
    return f"{iso[:19].replace('-', '').replace(':', '')}Z"


def _escaped(text: str) -> str:
    for plain, written in (("\\", "\\\\"), (";", "\\;"), (",", "\\,"), ("\r", ""), ("\n", "\\n")):
        text = text.replace(plain, written)
    return "".join(letter for letter in text if letter.isprintable())


def _folded(line: str, most: int = 75) -> list[str]:
    """A line of a calendar in pieces of at most 75 octets, the later ones after a blank; no character is cut."""
    pieces, piece = [], ""
    for letter in line:
        if len((piece + letter).encode()) > most:
            pieces.append(piece)
            piece = " "
        piece += letter
    return [*pieces, piece]
