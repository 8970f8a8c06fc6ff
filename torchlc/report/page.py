"""What all pages share: their templates, and the line that says what was recorded."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchlc.brdf.base import MODELS
from torchlc.digits import number_of
from torchlc.readers import Recording, iso_times

if TYPE_CHECKING:
    from jinja2 import Environment

    from torchlc.parameters import Free

TEMPLATES = Path(__file__).parent / "templates"


def titled(free: Free) -> str:
    """What a free parameter is, beside its owner's name: "diffuse reflectance (r_diff)"."""
    words = meaning(free)
    return f"{words} ({free.origin.quantity})" if words else free.origin.quantity


def titled_with_owner(free: Free) -> str:
    """What a free parameter is and whose, its full name beside it: "length along its x axis, body (body.size_x)"."""
    words, of = meaning(free), free.origin
    named = [of.owner] if of.role in ("materials", "components") else [of.target] if of.target else []
    of_which = "".join(f", {name}" for name in (*named, of.member) if name)
    return f"{words}{of_which} ({free.name})" if words else free.name


def meaning(free: Free) -> str:
    """What a free parameter is, in words; of a material whatever its axes."""
    name = free.origin.quantity
    # one number that stands for those along two axes is along neither
    both = any(name in model.shared for model in MODELS.values())
    return re.sub(r" along the facet's [uv] axis$", "", free.meaning) if both else free.meaning


@cache
def environment() -> Environment:
    """Every value that reaches a page is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )


def origin(recording: Recording) -> str:
    """File, rows, times and stations of a recording in one line."""
    times = iso_times(recording)
    first, last = (text[:16].replace("T", " ") for text in (times[0], times[-1]))
    places = ", ".join(recording.station_ids[i] for i in np.unique(recording.station))
    nights = len(recording.night_ids)
    source = recording.source.name if recording.source is not None else "a recording"
    return (
        f"{source}: {number_of(len(recording), 'row')}, {first} to {last} {recording.time.scale.upper()}"
        + (f", {nights} nights" if nights > 1 else "")
        + (f", from {places}" if places != "unknown" else "")
    )
