"""The object as facets: where each is, where it faces, how large it is, and what it is made of. Every module of this
folder is imported, and every class of a shape is known by its name, these and those that are defined elsewhere.

Letters: F facets, V corners of a facet, T or N rows, H corners of a hull. Lengths in metres, everything in
the body frame.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from torchlc.shapes.component import Component, Side, Tracks
from torchlc.shapes.curved import Band, Dome, Plane, Surface
from torchlc.shapes.object import Shape
from torchlc.shapes.part import SHAPES, Facets, Hull, Part, Surroundings
from torchlc.shapes.tracking import tracking_pose

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

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
