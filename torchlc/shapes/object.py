"""The object of a scene: its parts, one for each component."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchlc.errors import InputError
from torchlc.shapes.part import SHAPES, Part, Surroundings, unit
from torchlc.shapes.tracking import ALONG_AXIS

MOST_FACETS = 1_000_000
"""Of all components; a row then has 8 MB an angle."""


class Shape:
    """All parts of a scene's object, in the order of its components.

    ``uneven_n`` gives the largest lobe exponent expected of each material with a different width along u and v: a dish or
    sphere of such a material shines facet by facet, and is cut as finely as the lobe asks for.
    """

    def __init__(self, scene: Any, uneven_n: Mapping[str, float]) -> None:
        self.warnings: list[str] = []
        parts: list[Part] = []
        facets = 0
        surroundings = Surroundings(scene.directory or Path(), uneven_n)
        for component in scene.components:
            parts.append(self._part(component, scene, surroundings))
            facets += len(parts[-1].faces)
            if facets > MOST_FACETS:
                place, found = f"component {component.name!r}", f"more than {MOST_FACETS:,} facets in all"
                raise InputError(
                    scene.source,
                    place,
                    found,
                    f"at most {MOST_FACETS:,}",
                    "Fewer parts or wider lobes need less.",
                )
        self.parts: tuple[Part, ...] = tuple(parts)

    def _part(self, component: Any, scene: Any, surroundings: Surroundings) -> Part:
        part = SHAPES[component.shape](component, surroundings)
        if component.tracks is not None:
            axis = unit(component.tracks.axis)
            if np.linalg.norm(np.cross(axis, part.front)) < ALONG_AXIS:
                raise InputError(
                    scene.source,
                    f"component {component.name!r}",
                    "tracks.axis is along the normal of the front",
                    "an axis that can turn the front to the Sun",
                )
            part.tracks_axis = axis
        self.warnings += part.warnings
        return part
