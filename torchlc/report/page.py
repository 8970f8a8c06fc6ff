"""What all pages share: their templates, and the line that says what was recorded."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchlc.brdf.base import MODELS
from torchlc.readers import Recording, iso_times

if TYPE_CHECKING:
    from jinja2 import Environment

    from torchlc.parameters import Free

TEMPLATES = Path(__file__).parent / "templates"


def titled(free: Free) -> str:
    """What a free parameter of a material is, its name beside it: "diffuse reflectance (r_diff)"."""
    name = free.origin.quantity
    # one number that stands for those along two axes is along neither
    both = any(name in model.shared for model in MODELS.values())
    meaning = re.sub(r" along the facet's [uv] axis$", "", free.meaning) if both else free.meaning
    return f"{meaning} ({name})" if meaning else name


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
        f"{source}: {len(recording)} rows, {first} to {last} {recording.time.scale.upper()}"
        + (f", {nights} nights" if nights > 1 else "")
        + (f", from {places}" if places != "unknown" else "")
    )
