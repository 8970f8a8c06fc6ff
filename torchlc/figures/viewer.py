"""What the report's object view needs, as plain numbers: triangles at rest, and for some rows the turns,
the Sun and the observer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from torchlc.figures.object_drawing import brightest, good_camera, levelled, posed_mesh
from torchlc.figures.raster import fan
from torchlc.figures.style import component_colour
from torchlc.geometry.orbit import angle_between
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import iso_times
from torchlc.stages.light import View

MOST_ROWS = 240
"""More are not told apart with a slider."""
MOST_TRIANGLES = 6000
"""Larger meshes are simplified to so many: all are in the page, and drawn at every turn."""


def viewer_data(model: LightCurve, view: View, prediction: np.ndarray) -> dict[str, Any]:
    """Everything the view draws; directions are unit vectors in the body frame, lengths in metres.

    ``prediction`` (T,) is the model in the recording's unit, ``view`` its geometry at each row.
    """
    recording = model.recording
    peak = brightest(recording, prediction)
    rows = shown_rows(len(recording), peak)
    mesh = posed_mesh(model, view, peak)
    to_sun, to_observer = view.to_sun[0].numpy(), view.to_observer[0].numpy()
    parts = []
    for number, (part, facets) in enumerate(zip(model.assembly.shape.parts, view.facets, strict=True)):
        triangles, _ = fan(facets.vertices.numpy())
        triangles = simplified(triangles, MOST_TRIANGLES)
        pose = view.poses[number]
        parts.append(
            {
                "name": part.name,
                "colour": component_colour(number),
                "pivot": rounded(np.asarray(part.pivot), 5),
                "triangles": rounded(triangles, significant(triangles)),
                "poses": None if pose is None else rounded(pose[0, rows].numpy().reshape(len(rows), 9), 5),
            }
        )
    phase, nearest = nearest_glints(view, rows)
    light = {
        name: levelled(recording, values)[rows]
        for name, values in (("observed", recording.observed), ("model", prediction))
    }
    return {
        "parts": parts,
        "middle": rounded(mesh.middle, 5),
        "radius": round(mesh.radius, 5),
        "camera": rounded(good_camera(to_sun[peak], to_observer[peak]), 5),
        "start": int(np.searchsorted(rows, peak)),
        "kind": recording.kind,
        "scale": recording.time.scale.upper(),
        "time": [text[:19].replace("T", " ") for text in np.array(iso_times(recording))[rows].tolist()],
        "hours": rounded(recording.seconds[rows] / 3600, 6),
        "sun": rounded(to_sun[rows], 5),
        "observer": rounded(to_observer[rows], 5),
        "phase": rounded(phase, 2),
        "glint": nearest,
        "light": {
            name: rounded(values, 4 if recording.kind == "mag" else 5) for name, values in light.items()
        },
    }


def shown_rows(count: int, peak: int) -> np.ndarray:
    """At most MOST_ROWS rows, evenly spread, the peak among them."""
    return np.unique(np.append(np.linspace(0, count - 1, min(count, MOST_ROWS)).round().astype(int), peak))


def nearest_glints(view: View, rows: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Phase angle, deg, and for each row the lit-and-seen facet whose normal is nearest to the bisector, in
    words.
    """
    index = torch.as_tensor(rows)
    to_sun, to_observer = view.to_sun[0, index], view.to_observer[0, index]
    half = torch.nn.functional.normalize(to_sun + to_observer, dim=-1)
    best = torch.full((len(rows),), math.inf, dtype=torch.float64)
    names = ["none"] * len(rows)
    for patch in view.patches:
        directions = (to_sun, to_observer, half)
        if patch.pose is not None:
            directions = tuple(
                torch.einsum("tij,ti->tj", patch.pose[0, index], direction) for direction in directions
            )
        cos_i, cos_r = (direction @ patch.normal.T for direction in directions[:2])
        angle = torch.rad2deg(angle_between(directions[2][:, None], patch.normal[None]))
        angle = torch.where((cos_i > 0) & (cos_r > 0), angle, math.inf)
        least = angle.min(1)
        for k in torch.nonzero(least.values < best)[:, 0].tolist():
            best[k] = least.values[k]
            names[k] = f"{patch.component} {patch.faces[int(least.indices[k])]}, {float(best[k]):.1f}°"
    return torch.rad2deg(angle_between(to_sun, to_observer)).numpy(), names


def simplified(triangles: np.ndarray, most: int) -> np.ndarray:
    """Triangles (N, 3, 3), corners merged on an ever coarser grid until there are at most that many."""
    cells = 256.0
    low, size = triangles.min((0, 1)), np.ptp(triangles.reshape(-1, 3), axis=0).max()
    merged = triangles
    while len(merged) > most:
        corners = np.round((triangles - low) / size * cells)
        distinct = np.abs(np.diff(corners[:, [0, 1, 2, 0]], axis=1)).sum(-1).min(1) > 0
        merged = corners[distinct] / cells * size + low
        cells /= 1.25
    return merged


def significant(values: np.ndarray) -> int:
    """Decimals that keep 1e-4 of the largest value."""
    largest = float(np.abs(values).max(initial=0.0))
    return max(0, 4 - math.floor(math.log10(largest))) if largest > 0 else 4


def rounded(values: np.ndarray, digits: int) -> Any:
    """Nested lists without digits that nobody sees; None where JSON has no number."""
    plain = np.asarray(values, dtype=float).round(digits)
    listed = plain.tolist()
    return (
        listed
        if np.isfinite(plain).all()
        else [number if math.isfinite(number) else None for number in listed]
    )
