"""Stations that a recording has and its scene has not, and what to write for them."""

from __future__ import annotations

from collections.abc import Sequence

from torchlc.scene.writer import toml_value
from torchlc.suggest import did_you_mean


def to_add(
    name: str, latitude: str = "(deg north)", longitude: str = "(deg east)", height: str = "(m)"
) -> str:
    """The lines of a scene that make a station of this name; words in brackets stand for numbers that are not known."""
    return (
        f"Add to the scene, each on a line of its own: [[stations]], id = {toml_value(name)}, latitude = {latitude}, "
        f"longitude = {longitude}, height = {height}"
    )


def remedy(name: str, known: Sequence[str]) -> str:
    """What to do about a name of a row's station, blank or not, that is none of those that the scene has."""
    if not name:
        return "Write into every row which of them it is from"
    near = did_you_mean(name, known)
    only = f"If {known[0]} has been meant, that may be its id in the scene. " if len(known) == 1 else ""
    return f"{f'{near} ' if near else only}{to_add(name)}"
