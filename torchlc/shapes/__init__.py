"""The object as facets: where each is, where it faces, how large it is, and what it is made of.

Letters: F facets, V corners of a facet, T or N rows, H corners of a hull. Lengths in metres, everything in
the body frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from torchlc.errors import InputError
from torchlc.shapes.curved import Band, Dome, Plane, Surface
from torchlc.shapes.flat import Box, Plate
from torchlc.shapes.mesh import Mesh
from torchlc.shapes.part import Facets, Hull, Part, unit
from torchlc.shapes.smooth import Cone, Cylinder, Dish, Sphere
from torchlc.shapes.tracking import ALONG_AXIS, tracking_pose

__all__ = ["Band", "Dome", "Facets", "Hull", "Part", "Plane", "Shape", "Surface", "tracking_pose"]

SMOOTH: dict[str, Any] = {"cylinder": Cylinder, "cone": Cone, "dish": Dish, "sphere": Sphere}
MOST_FACETS = 1_000_000
LEAST_AROUND = 64
MOST_AROUND = {"cylinder": 4096, "cone": 4096, "dish": 512, "sphere": 512}
CURVED_TWICE = ("dish", "sphere")


class Shape:
    """All parts of a scene's object, in the order of its components.

    ``uneven_n`` gives the largest lobe exponent expected of each material with a different width along u and v: a dish or
    sphere of such a material shines facet by facet, and is cut as finely as the lobe asks for.
    """

    def __init__(self, scene: Any, uneven_n: Mapping[str, float]) -> None:
        self.warnings: list[str] = []
        parts: list[Part] = []
        facets = 0
        for component in scene.components:
            parts.append(self._part(component, scene, uneven_n))
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

    def _part(self, component: Any, scene: Any, uneven_n: Mapping[str, float]) -> Part:
        match component.shape:
            case "box":
                part: Part = Box(component)
            case "plate":
                part = Plate(component)
            case "mesh":
                part = Mesh(component, scene.directory)
            case smooth:
                part = SMOOTH[smooth](component, self._around(component, uneven_n))
                if smooth in CURVED_TWICE and component.material in uneven_n:
                    part.whole = {}
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

    def _around(self, component: Any, uneven_n: Mapping[str, float]) -> int:
        """Facets around a smooth shape: what the scene wants, or an uneven lobe needs, if it can be done."""
        n = uneven_n.get(component.material, 0.0) if component.shape in CURVED_TWICE else 0.0
        wanted = max(
            LEAST_AROUND,
            math.ceil(2 * math.pi * math.sqrt(n)),
            getattr(component, "facets", None) or 0,
        )
        most = MOST_AROUND[component.shape]
        if wanted > most:
            self.warnings.append(
                f"{component.name}: {wanted} facets around are wanted, {most} are used"
                + ("; narrow glints of it may come out as spikes" if n > 0 else "")
            )
        return min(wanted, most)
