"""What passes through the stages from light to detector: sources, surfaces, views, brightness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchlc.brdf.base import Brdf
from torchlc.stages.instants import Instants, Nodes
from torchlc.tensors.autodiff_state import readable
from torchlc.tensors.vectors import least_axis

if TYPE_CHECKING:
    from torchlc.geometry.orbit import State
    from torchlc.shapes import Facets
    from torchlc.shapes import Surface as SurfaceShape

PARALLEL = 1e-12
"""Square of the sine of an angle below which two directions have no direction across them."""
Directions = tuple[Tensor, ...]
"""Three components of unit vectors."""
UNRESOLVED = 1e7
"""Distance of an observer, in radii of the object, at which its radius is 0.02 arcsec: no camera resolves it."""


@dataclass(frozen=True)
class Disc:
    """What a source looks like from the object: angular ``radius`` (Q, T), rad, and ``rules`` for means over it, the coarsest
    first: points (D, 2) in radii and weights (D,) that sum to 1."""

    radius: Tensor
    rules: tuple[tuple[Tensor, Tensor], ...]

    def around(self, middle: Tensor, radius: Tensor, rule: int, towards: Tensor | None = None) -> Tensor:
        """Unit directions (D, ..., 3) of the points of a rule, on discs of ``radius`` (...) about ``middle`` (..., 3).
        Their x axis points ``towards`` a unit vector (..., 3): they are the same in any frame, turned or mirrored."""
        points, _ = self.rules[rule]
        first = torch.linalg.cross(middle, least_axis(middle))
        if towards is not None:
            across = towards - (towards * middle).sum(-1, keepdim=True) * middle
            first = torch.where((across * across).sum(-1, keepdim=True) > PARALLEL, across, first)
        first = first / torch.linalg.vector_norm(first, dim=-1, keepdim=True)
        second = torch.linalg.cross(middle, first)
        x, y = points.reshape(-1, 2, *(1,) * middle.ndim).unbind(1)
        spread = middle + (x * first + y * second) * radius[..., None]
        return spread / torch.linalg.vector_norm(spread, dim=-1, keepdim=True)

    def beside(
        self, middle: Directions, radius: Tensor, rule: int, towards: Directions
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What :meth:`around` gives, component by component, (M, D) each, for directions whose components (M,) lie apart."""
        along = middle[0] * towards[0] + middle[1] * towards[1] + middle[2] * towards[2]
        first = tuple(t - along * m for t, m in zip(towards, middle, strict=True))
        square = first[0].square() + first[1].square() + first[2].square()
        parallel = square <= PARALLEL
        if not readable(parallel) or bool(parallel.any()):
            whole = torch.stack(middle, -1)
            other = torch.linalg.cross(whole, least_axis(whole)).unbind(-1)
            first = tuple(torch.where(parallel, o, f) for o, f in zip(other, first, strict=True))
            square = first[0].square() + first[1].square() + first[2].square()
        scale = radius / torch.sqrt(square)
        a, b, c = (scale * f for f in first)
        x, y, z = middle
        second = y * c - z * b, z * a - x * c, x * b - y * a
        points, _ = self.rules[rule]
        on_plane = torch.cat([torch.ones_like(points[:, :1]), points], -1).mT
        shorter = torch.rsqrt(1 + radius.square()[:, None] * points.square().sum(-1))
        su, sv, sn = (
            (torch.stack(each, -1) @ on_plane) * shorter
            for each in zip(middle, (a, b, c), second, strict=True)
        )
        return su, sv, sn

    def spread(self, light: Light, rule: int) -> Light:
        """Each source (L, Q, T) of a light as the points of a disc, (D L, Q, T)."""
        direction = self.around(light.direction, self.radius, rule)
        irradiance = self.rules[rule][1][:, None, None, None] * light.irradiance
        return replace(
            light, direction=direction.flatten(0, 1), irradiance=irradiance.flatten(0, 1), disc=None
        )


@dataclass(frozen=True)
class Light:
    """A set of L sources seen from the object: unit directions in the body frame (L, Q, T, 3), and irradiance
    over the Sun's at 1 au (L, Q, T).

    ``primary`` marks the Sun, whose shadows count. ``spread`` (L, Q, T), rad^2, is the variance per axis of a
    source that stands for a piece of sky: narrower lobes are widened to it, so that a mirror shows no lattice
    of points. ``scale`` names a parameter that multiplies it. ``fewer`` is the same light from fewer directions, as many as a
    surface needs that is curved about one axis, and about two, whose normals spread it themselves. ``disc``: each source is
    the middle of one that is yet to be spread over it.
    """

    direction: Tensor
    irradiance: Tensor
    primary: bool = True
    spread: Tensor | None = None
    scale: str | None = None
    fewer: tuple[Light, Light] | None = None
    disc: Disc | None = None


@dataclass(frozen=True)
class Near:
    """That lamp and camera are at distances: ``point`` (F, 3) m, the middle of each facet at rest in the body frame, and
    one over the distances from the body's origin, ``lamp`` and ``camera`` (Q or 1, T or 1), 1/m."""

    point: Tensor
    lamp: Tensor
    camera: Tensor


@dataclass(frozen=True)
class Response:
    """What a detector that resolves the object records of a radiance x, over that of a surface which faces the source at its nominal
    distance: max(x^power - threshold, 0) + pedestal, each (Q or 1, T or 1)."""

    power: Tensor
    threshold: Tensor
    pedestal: Tensor


@dataclass(frozen=True)
class Patch:
    """Facets of one component that share a material.

    ``normal``, ``u`` (F, 3) and ``area`` (F,), m2, are given at rest, with an axis B before if they differ
    within a batch; ``pose`` (Q, T, 3, 3) turns them into
    the body frame (None: they stay). ``visible`` (Q, T or 1, F) is the fraction of the area that is sunlit and
    seen, ``seen`` (Q, T or 1, F) that is seen (None: 1). ``surface`` is the plane or curved surface that the facets are pieces
    of, if they are; ``vertices`` (F, V, 3) m are their corners at rest where they are not facets ``select`` of ``part``. ``near`` and ``response`` say what differs from parallel light and from a linear detector.
    """

    component: str
    material: str
    model: type[Brdf]
    faces: Sequence[str]
    normal: Tensor
    u: Tensor
    area: Tensor
    pose: Tensor | None = None
    visible: Tensor | None = None
    seen: Tensor | None = None
    part: int | None = None
    select: Tensor | None = None
    surface: SurfaceShape | None = None
    vertices: Tensor | None = None
    near: Near | None = None
    response: Response | None = None

    @property
    def by_facet(self) -> bool:
        """Whether each facet has to be worked out by itself."""
        return self.near is not None or self.response is not None


@dataclass(frozen=True)
class View:
    """The geometry of all rows and instants: directions are unit vectors in the body frame.

    For a ``batch`` of values of the parameters the axis Q holds the instants of all, those of the first instant
    first, or 1 where nothing differs. ``whole_discs``: light effects leave a source that is a disc whole (:attr:`Light.disc`), for
    it is spread where it matters.
    """

    nodes: Nodes
    state: State
    rotation: Tensor
    to_sun: Tensor
    to_observer: Tensor
    range_m: Tensor
    poses: tuple[Tensor | None, ...]
    facets: tuple[Facets, ...]
    lights: tuple[Light, ...] = ()
    patches: tuple[Patch, ...] = ()
    batch: int = 1
    whole_discs: bool = False

    def at(self, instants: Tensor) -> View:
        """The view of some of the instants (K,) along the axis T, each of which stands for its whole row."""

        def picked(record: Any) -> Any:
            columns = {field.name: getattr(record, field.name) for field in fields(record)}
            ends = {"position": 2, "velocity": 2, "sun": 2, "observer": 2, "direction": 2}
            return replace(
                record,
                **{
                    name: value.index_select(value.ndim - ends.get(name, 1), instants)
                    for name, value in columns.items()
                    if isinstance(value, Tensor) and value.shape[-ends.get(name, 1)] > 1
                },
            )

        return replace(
            self,
            nodes=Nodes(self.nodes.offset[:, instants], torch.ones_like(self.nodes.offset[:, :1])),
            state=picked(self.state),
            rotation=self.rotation[:, instants],
            to_sun=self.to_sun[:, instants],
            to_observer=self.to_observer[:, instants],
            range_m=self.range_m[:, instants],
            poses=tuple(None if pose is None else pose[:, instants] for pose in self.poses),
            lights=tuple(map(picked, self.lights)),
        )

    def every(self, value: Tensor) -> Tensor:
        """A parameter (..., 1 or T) of the values of the batch for all its instants, (Q or 1, 1 or T)."""
        if value.ndim < 2:
            return value[None]
        return value.repeat(max(self.nodes.offset.shape[0] // self.batch, 1), 1)

    def apart(self, tensor: Tensor, axis: int = 0) -> Tensor:
        """``tensor`` with its axis Q as two: instants, and the values of the batch or 1."""
        size = tensor.shape[axis]
        batch = 1 if size == 1 else self.batch
        return tensor.unflatten(axis, (size // batch, batch))


@dataclass(frozen=True)
class Surface:
    """A patch with its table for the material stage: ``phase_angle`` (T,) rad, at mid-exposure; ``sunlit`` if
    its light is the Sun's; ``scale`` as of :class:`Light`; ``tabulated_mag``, mag, what its table is out by at most where it
    is interpolated over the exponent of a lobe."""

    component: str
    material: str
    model: type[Brdf]
    table: Mapping[str, Tensor]
    phase_angle: Tensor
    sunlit: bool = True
    scale: str | None = None
    tabulated_mag: float = 0.0


@dataclass(frozen=True)
class Sky:
    """What the shade stage sees: positions in every column of the tables, their weights, ``fixed`` if no free
    parameter moves them, and the ``instants`` that the columns are, where exposures have several."""

    state: State
    nodes: Nodes
    fixed: bool
    instants: Instants | None = None


@dataclass(frozen=True)
class Brightness:
    """Irradiance over the Sun's at 1 au, (..., T), and the component shares of the object's light (..., C,
    T), or None if unasked."""

    flux: Tensor
    shares: Tensor | None
    components: Sequence[str]
