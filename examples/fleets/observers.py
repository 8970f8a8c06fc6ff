"""The satellites of Starlink v2 mini below LOW_KM by who saw them."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from populations import LEAST_OBJECTS
from unseen import area_under_curve, held_out, robust
from v2mini import LOW_KM, passes, v2mini

from torchlc.files.numbers import Free

SURVEY_DEG = 43.65
"""Latitude of the survey's station; no visual observer is there."""
BRIGHT_MAG = 3.0
"""At 400 km: between the two kinds of passes of the satellites below LOW_KM."""
TOLD_BY = ("height", "day", "phase angle", "elevation", "azimuth", "station's latitude")
NEIGHBOURS = 15


def observers() -> dict[str, Any]:
    """The satellites below LOW_KM by who saw them: the survey's photometer, or visual observers, each fitted by itself and asked for
    satellites that it has not seen, with an offset of each, or with rows that may be of another kind; how much rows of one pass differ,
    and the share of rows of each station that are bright."""
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, lit, recorded = v2mini(Path(folder))
    low = lit & (recorded["height"] < LOW_KM)
    latitude, distance = recorded["station's latitude"][low], recorded["range"][low]
    some = recording.keep(low, "of the other class")
    parameters = scene.model.parameters | {"zero_point": Free(value=0.0, sigma=0.5, prior="normal")}
    spared = scene.model_copy(
        update={
            "model": scene.model.model_copy(
                update={"effects": [*(scene.model.effects or ()), "outliers"], "parameters": parameters}
            )
        }
    )
    surveyed = np.abs(latitude - SURVEY_DEG) < 0.05
    found: dict[str, Any] = {}
    for name, rows in (("photometer", surveyed), ("visual", ~surveyed)):
        kept = some.keep(rows, "of the other observers")
        assert kept.object is not None
        group = passes(kept)
        mean = np.bincount(group, kept.observed) / np.bincount(group)
        apart = len(kept) - len(mean)
        unseen = held_out(scene, kept, kept.object)
        among_bad = held_out(spared, kept, kept.object)
        found[name] = {
            "rows": len(kept),
            "objects": len(kept.object_ids),
            "passes": len(mean),
            "within_pass": float(np.sqrt(((kept.observed - mean[group]) ** 2).sum() / apart)),
            "unseen": robust(unseen),
            "unseen_with_outliers": robust(among_bad),
            "unseen_median_of_passes": robust(
                np.array([np.median(unseen[group == k]) for k in range(len(mean))])
            ),
        }
        print(name, found[name], flush=True)
    at_400_km = some.observed - 5 * np.log10(distance / 400.0)
    found["stations"] = [
        {
            "latitude": float(one),
            "rows": int((latitude == one).sum()),
            "bright": float(np.mean(at_400_km[latitude == one] < BRIGHT_MAG)),
        }
        for one in np.unique(latitude)
        if (latitude == one).sum() >= LEAST_OBJECTS
    ]
    columns = np.array([column[low] for name, column in recorded.items() if name in TOLD_BY])
    assert some.object is not None
    share = of_neighbours(columns, at_400_km < BRIGHT_MAG, some.object)
    found["bright_told"] = area_under_curve(share, at_400_km < BRIGHT_MAG)
    return found


def of_neighbours(columns: np.ndarray, bright: np.ndarray, member: np.ndarray) -> np.ndarray:
    """Share (T,) of bright rows among the NEIGHBOURS nearest rows of other members, in columns (C, T) scaled to a deviation of 1."""
    scaled = columns / columns.std(1, keepdims=True)
    apart = ((scaled[:, :, None] - scaled[:, None]) ** 2).sum(0)
    apart[member[:, None] == member] = np.inf
    return bright[np.argsort(apart, 1)[:, :NEIGHBOURS]].mean(1)
