"""The object as facets: where each is, where it faces, how large it is, and what it is made of. Every module of this
folder is imported, and every class of a shape is known by its name, these and those that are defined elsewhere.

Letters: F facets, V corners of a facet, T or N rows, H corners of a hull. Lengths in metres, everything in
the body frame.
"""

from __future__ import annotations

from torchlc.naming import import_modules
from torchlc.shapes.component import Component, Side, Tracks
from torchlc.shapes.curved import Band, Dome, Plane, Surface
from torchlc.shapes.object import Shape
from torchlc.shapes.part import SHAPES, Facets, Hull, Part, Surroundings
from torchlc.shapes.tracking import tracking_pose

import_modules(__name__, __path__)

__all__ = [
    "SHAPES",
    "Band",
    "Component",
    "Dome",
    "Facets",
    "Hull",
    "Part",
    "Plane",
    "Shape",
    "Side",
    "Surface",
    "Surroundings",
    "Tracks",
    "tracking_pose",
]
