"""What every part of an object has in common, whatever its shape: the contract of a shape."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from torchlc.naming import Registry
from torchlc.shapes.component import Component
from torchlc.shapes.curved import Surface

SHAPES: Registry[type[Part]] = Registry("shape")
"""Every shape by the name that a scene uses."""
CORNERS = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Of a rectangle, over its sides, counter-clockwise."""


@dataclass(frozen=True)
class Facets:
    """Facets of one part at rest, body frame.

    vertices (F, V, 3) counter-clockwise from outside, padded by repeating the last; normal (F, 3); u (F, 3),
    the in-plane axis of anisotropic materials (v = normal x u); area (F,) m2; centroid (F, 3). Of sizes that differ within
    a batch vertices, area and centroid have an axis B before the others.
    """

    vertices: Tensor
    normal: Tensor
    u: Tensor
    area: Tensor
    centroid: Tensor


@dataclass(frozen=True)
class Hull:
    """How the corners of a convex part join: ``loops`` (faces, corners) counter-clockwise from outside.

    edges (E, 2) corner indices; sides (E, 2): the face that runs along the edge forwards, the one that runs
    backwards. around (faces, corners): the edge that follows each corner of a loop.
    """

    loops: np.ndarray
    edges: np.ndarray
    sides: np.ndarray
    around: np.ndarray

    @classmethod
    def of(cls, loops: Sequence[Sequence[int]]) -> Hull:
        forwards: dict[tuple[int, int], int] = {}
        for face, loop in enumerate(loops):
            forwards |= dict.fromkeys(zip(loop, [*loop[1:], loop[0]], strict=True), face)
        edges = [(a, b) for a, b in forwards if a < b]
        longest = max(map(len, loops))
        padded = [[*loop, *[loop[-1]] * (longest - len(loop))] for loop in loops]
        sides = [(forwards[a, b], forwards[b, a]) for a, b in edges]
        numbers = {frozenset(edge): index for index, edge in enumerate(edges)}
        around = [
            # a corner that only pads a loop is followed by no edge, and never asked for it
            [numbers.get(frozenset(edge), 0) for edge in zip(loop, [*loop[1:], loop[0]], strict=True)]
            for loop in padded
        ]
        return cls(np.array(padded), np.array(edges), np.array(sides), np.array(around))


@dataclass(frozen=True)
class Surroundings:
    """What a shape may know beyond its component: the scene's ``directory``, where the names of files start, and the
    largest lobe exponent expected of each material with a different width along u and v."""

    directory: Path = field(default_factory=Path)
    uneven_n: Mapping[str, float] = field(default_factory=dict)


class Part(ABC):
    """One component: what does not depend on the sizes, and `facets`, which does. A subclass that sets ``kind`` is a
    shape: the scene's word for it; ``keys`` is the table of its keys.

    faces, materials: label and material of each facet. pivot (3,): the centre, about which the part turns.
    tracks_axis (3,): unit body axis about which it follows the Sun, or None. front (3,): what it turns to the
    Sun, at rest: a plate's normal, the axis of a shape that has one, a box's widest face, else its own +Z.
    hull: how it stands in the way of others if it is convex, else None (then visibility is traced by rays).
    whole: labels of faces whose facets are pieces of one plane or of one curved surface, with the points at which its light
    is summed.
    thin: it encloses nothing, and each facet has a twin that faces the other way.
    scalable: sizes turn none of its facets, and `facets` takes a batch (B,) of them.
    """

    kind: ClassVar[str]
    keys: ClassVar[type[Component]]
    thin: ClassVar[bool] = False
    scalable: ClassVar[bool] = False
    hull: Hull | None = None

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        SHAPES.declared(cls, "kind")

    def __init__(self, component: Any, surroundings: Surroundings) -> None:
        self.name: str = component.name
        self.pivot = np.array([number(x) for x in component.centre])
        self.turn = turn_matrix([number(x) for x in component.rotation])
        self.upright = bool((self.turn == np.eye(3)).all())
        self.faces: tuple[str, ...] = ()
        self.materials: tuple[str, ...] = ()
        self.whole: Mapping[str, int] = {}
        self.warnings: list[str] = []
        self.tracks_axis: np.ndarray | None = None
        self.front = self.turn[:, 2]

    @abstractmethod
    def at_rest(self, values: Mapping[str, Tensor]) -> Facets:
        """Facets in the shape's own frame, its middle at the origin."""

    def hull_corners(self, facets: Facets) -> Tensor:
        """Corners (H, 3) that `hull` joins, at rest in the body frame."""
        raise TypeError(f"a {self.kind} has no convex hull to stand for it")

    def areas(self, values: Mapping[str, Tensor]) -> Tensor:
        """Areas (F,) or (B, F) of `facets`, m2; of a `scalable` part without the rest of them."""
        return self.at_rest(values).area

    def facets(self, values: Mapping[str, Tensor]) -> Facets:
        """Facets in the body frame before any turn to the Sun, from values "<component>.size_x" and so on."""
        rest = self.at_rest(values)
        pivot = like(self.pivot, rest.area)
        if self.upright:
            return replace(rest, vertices=rest.vertices + pivot, centroid=rest.centroid + pivot)
        turn = like(self.turn, rest.area)
        return Facets(
            vertices=rest.vertices @ turn.mT + pivot,
            normal=rest.normal @ turn.mT,
            u=rest.u @ turn.mT,
            area=rest.area,
            centroid=rest.centroid @ turn.mT + pivot,
        )

    def surface(self, face: str, values: Mapping[str, Tensor]) -> Surface:
        """What the facets of a label in `whole` are pieces of, in the body frame before any turn to the Sun."""
        raise TypeError(f"{face} of a {self.kind} is no one surface")

    def sizes(self, values: Mapping[str, Tensor], *keys: str) -> list[Tensor]:
        return [values[f"{self.name}.{key}"] for key in keys]


def number(x: Any) -> float:
    """A scene's number, or the starting value of a free one."""
    return float(getattr(x, "value", x))


def like(array: np.ndarray, tensor: Tensor) -> Tensor:
    return torch.as_tensor(array, dtype=tensor.dtype, device=tensor.device)


def unit(vector: Sequence[Any] | np.ndarray) -> np.ndarray:
    vector = np.array([number(x) for x in vector])
    return vector / np.linalg.norm(vector)


def turn_matrix(degrees: Sequence[float]) -> np.ndarray:
    """Turns about body x, then y, then z, right-handed: v_body = R v_shape, (3, 3)."""
    matrix = np.eye(3)
    for k, angle in enumerate(np.radians(degrees)):
        i, j = (k + 1) % 3, (k + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = math.cos(angle)
        turn[j, i], turn[i, j] = math.sin(angle), -math.sin(angle)
        matrix = turn @ matrix
    return matrix


def frame_about(axis: np.ndarray) -> np.ndarray:
    """Right-handed rows e1, e2, axis; for an axis along +X, +Y or +Z, e1 is the next body axis cyclically."""
    nearest = int(np.argmax(np.abs(axis)))
    start = np.eye(3)[(nearest + 1) % 3]
    first = unit(start - (start @ axis) * axis)
    return np.stack([first, np.cross(axis, first), axis])
