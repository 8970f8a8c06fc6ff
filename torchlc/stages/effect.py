"""The contract of an effect: one class, its parameters, and one method of one stage.

A light curve is computed in stages, in this order; an effect changes what passes through its own stage and
nothing else:

=============  ===========================================================================================
stage          what passes through
=============  ===========================================================================================
``clock``      :class:`Nodes`: the instants at which a row is evaluated, and their weights
``orbit``      :class:`Request`: where object and observer are taken
``spin``       the values of the attitude
``attitude``   rotation (Q, T, 3, 3), body to inertial
``pointing``   poses of the parts that track the Sun
``light``      :class:`Light` sources
``surface``    :class:`Patch` surfaces: area, visible fraction
``shade``      share of the Sun that the object sees, by row
``scatter``    further sunlight that needs the whole geometry, added per component
``material``   lobe and diffuse light of a patch as functions of its material
``detector``   :class:`Brightness`: total flux and component shares
``noise``      :class:`Noise`: variance, law and correlation of the residuals
=============  ===========================================================================================

Letters: B batch, L lights, Q instants within an exposure, T rows, F facets, C components. The tensors of
``p``, an effect's own parameters, end in a row axis of size 1 or T; any batch axes stand before it.
"""

from __future__ import annotations

import hashlib
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import torch
from torch import Tensor, nn

from torchlc.brdf.base import Brdf
from torchlc.naming import ENTRY, Origin, Registry
from torchlc.parameters import Quantity
from torchlc.scene.problems import shown
from torchlc.stages.noise import Noise
from torchlc.stages.showing import Shown
from torchlc.tensors.autodiff_state import apart, readable
from torchlc.tensors.vectors import least_axis

if TYPE_CHECKING:
    from torchlc.geometry.orbit import State, Track
    from torchlc.geometry.rotation.attitude import Attitude
    from torchlc.shapes import Facets, Part, Shape
    from torchlc.shapes import Surface as SurfaceShape

Parameters = Mapping[str, Tensor]
STAGES = (
    "clock", "orbit", "spin", "attitude", "pointing", "light", "surface", "shade",
    "scatter", "material", "detector", "noise",
)  # fmt: skip
PARALLEL = 1e-12
"""Square of the sine of an angle below which two directions have no direction across them."""
Directions = tuple[Tensor, ...]
"""Three components of unit vectors."""
LARGEST_MEMORY = 400 * 2**20
MANY_FACETS = 100
UNRESOLVED = 1e7
"""Distance of an observer, in radii of the object, at which its radius is 0.02 arcsec: no camera resolves it."""
GEOMETRY_STAGES = frozenset(STAGES[: STAGES.index("shade")])


@dataclass(frozen=True)
class Nodes:
    """Instants of each row: seconds after the stamp (Q, T) and weights (Q, 1) or (Q, T) that sum to 1 over
    Q."""

    offset: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Instants:
    """Which instants N of each exposure are worked out, those of a row one after the other: more where light changes.

    ``row`` (N,) that an instant belongs to; ``place`` (N,) in the exposure, -1/2 to 1/2; ``weight`` (N,), its share of
    the exposure. Each is a Gauss-Legendre node of a ``panel`` (N,), a part of the exposure; ``span`` (P,) is how
    much of the exposure each panel takes. There are ``rows``, of which some may have none.
    """

    row: Tensor
    place: Tensor
    weight: Tensor
    panel: Tensor
    span: Tensor
    rows: int | None = None

    @property
    def middle(self) -> Tensor:
        """The instant nearest to mid-exposure of each row, (T,); the first of all for rows that have none."""
        with apart():
            order = torch.argsort(self.place.abs(), stable=True)
            order = order[torch.argsort(self.row[order], stable=True)]
            row = self.row[order]
            first = torch.ones_like(row, dtype=torch.bool)
            first[1:] = row[1:] != row[:-1]
            rows = int(row[-1]) + 1 if self.rows is None else self.rows
            return row.new_zeros(rows).index_copy(0, row[first], order[first])

    def at(self, instants: Tensor) -> Instants:
        """Some of the instants (K,)."""
        return replace(
            self,
            row=self.row[instants],
            place=self.place[instants],
            weight=self.weight[instants],
            panel=self.panel[instants],
        )


@dataclass(frozen=True)
class Columns:
    """What the tables hold side by side, C columns: a whole exposure where the light that falls on the object stays
    the same within it, else an instant of it.

    ``of`` (N,) is the column of each instant; ``row`` (C,) its row, ``weight`` (C,) its share of the exposure,
    ``instant`` (C,) one of its instants.
    """

    of: Tensor
    row: Tensor
    weight: Tensor
    instant: Tensor

    @classmethod
    def joined(cls, instants: Instants, apart: Tensor) -> Columns:
        """The instants of a row as one column, unless they are kept ``apart`` (T,)."""
        row = instants.row
        starts = torch.ones_like(row, dtype=torch.bool)
        starts[1:] = (row[1:] != row[:-1]) | apart[row[1:]]
        of = starts.long().cumsum(0) - 1
        instant = torch.nonzero(starts)[:, 0]
        weight = instants.weight.new_zeros(len(instant)).index_add(0, of, instants.weight)
        return cls(of, row[instant], weight, instant)


@dataclass(frozen=True)
class Request:
    """Seconds after the stamp for observer and object, (Q, T), how far the object is ahead on its orbit, rad (1,) or
    (T,), and by how much the observer's direction is off to the ``east`` and ``north``, deg, None where it is not."""

    observer_offset: Tensor
    object_offset: Tensor
    ahead: Tensor
    east: Tensor | None = None
    north: Tensor | None = None


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
        place = torch.cat([torch.ones_like(points[:, :1]), points], -1).mT
        shorter = torch.rsqrt(1 + radius.square()[:, None] * points.square().sum(-1))
        su, sv, sn = (
            (torch.stack(each, -1) @ place) * shorter for each in zip(middle, (a, b, c), second, strict=True)
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
            columns = {one.name: getattr(record, one.name) for one in fields(record)}
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


class Memory:
    """Costly geometric results by the bytes of what they came from, the oldest given up beyond LARGEST_MEMORY
    bytes."""

    def __init__(self) -> None:
        self._kept: dict[bytes, Sequence[Tensor]] = {}
        self._bytes = 0

    def recall(
        self, inputs: Sequence[Sequence[Tensor]], compute: Callable[[list[int]], Sequence[Tensor]]
    ) -> list[Tensor]:
        """What ``compute`` gives for some of the N items of ``inputs``, by their numbers, as tensors (items,
        ...): for all of them, (N, ...), but asked only for items that are new."""
        if not all(readable(tensor) for item in inputs for tensor in item):
            return list(compute(list(range(len(inputs)))))
        keys = [_digest(item) for item in inputs]
        new = {key: k for k, key in enumerate(keys) if key not in self._kept}
        found = compute(list(new.values())) if new else ()
        made = {key: [one[place].clone() for one in found] for place, key in enumerate(new)}
        self._kept |= made
        self._bytes += sum(map(_size, made.values()))
        whole = [torch.stack(column) for column in zip(*(self._kept[key] for key in keys), strict=True)]
        while len(self._kept) > 1 and self._bytes > LARGEST_MEMORY:
            self._bytes -= _size(self._kept.pop(next(iter(self._kept))))
        return whole


def _size(tensors: Sequence[Tensor]) -> int:
    return sum(one.numel() * one.element_size() for one in tensors)


def _digest(tensors: Sequence[Tensor]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for tensor in tensors:
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.digest()


@dataclass(frozen=True)
class Context:
    """What an effect may know of the recording: (T,) tensors, None where unknown; the ids name what ``curve``
    etc. index.

    ``rest`` holds the parts' facets at the scene's sizes, ``lobes`` the largest exponent of each material's
    lobe that has to be resolved, ``lobe_bounds`` the largest that it may have; ``errors`` is false if they are
    fitted, ``limits`` the largest number of upper limits in one curve. ``bounds`` gives the least and largest value of
    every number of the attitude and of the model's ``effects`` (one, twice, if it is fixed). ``finer`` (T,) marks rows
    whose exposures are worked out at twice as many instants as they need, to see what that changes.
    """

    seconds: Tensor
    exptime: Tensor | None
    cadence: float
    airmass: Tensor | None
    curve: Tensor
    station: Tensor
    night: Tensor
    curve_ids: Sequence[str]
    night_ids: Sequence[str]
    object: Tensor | None
    track: Track
    attitude: Attitude
    shape: Shape
    lobes: Mapping[str, float]
    rest: Sequence[Facets]
    materials: Sequence[str]
    models: Mapping[str, type[Brdf]]
    mode: str
    light_time_corrected: bool
    kind: str
    errors: bool
    limits: int
    memory: Memory = field(default_factory=lambda: Memory())
    lobe_bounds: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    effects: Sequence[Effect] = ()
    finer: Tensor | None = None

    def turned(self, *stages: str) -> bool:
        """Whether a number of an effect of these stages, free or not 0, turns or moves what they make."""
        return any(
            effect.stage in stages
            and not effect.linear
            and any(
                self.bounds[effect.full_name(one.name)] != (one.off, one.off) for one in effect.quantities
            )
            for effect in self.effects
            if not effect.spans_exposure
        )

    def at_rows(self, rows: Tensor) -> Context:
        """The context of some rows (N,), which may repeat."""
        per_row = {
            one.name: value[rows]
            for one in fields(self)
            if isinstance(value := getattr(self, one.name), Tensor)
        }
        return replace(self, **per_row, track=self.track.at_rows(rows))

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.shape.parts

    @property
    def radius(self) -> float:
        """Largest distance of a corner of the object from the body's origin, m, at the scene's sizes."""
        return max(float(torch.linalg.vector_norm(own.vertices, dim=-1).max()) for own in self.rest)

    @property
    def a_point(self) -> str | None:
        """Why the observer cannot tell one side of the object from the other, in words; None if it may."""
        if self.track.supports("position"):
            return "an object in orbit is a point for a photometer"
        if 1e3 * float(self.track.range_km.min()) > UNRESOLVED * self.radius:
            return f"the object is a point at {UNRESOLVED:.0e} times its radius"
        return None

    @property
    def many_facets(self) -> bool:
        """True for meshes, whose facets smooth an extended source themselves."""
        return sum(face not in part.whole for part in self.parts for face in part.faces) > MANY_FACETS

    @property
    def curved(self) -> bool:
        """True if a surface is curved, so that each light on it is summed over many points."""
        return any(points > 1 for part in self.parts for points in part.whole.values())


Reflect = Callable[[Mapping[str, Tensor]], tuple[Tensor, Tensor]]
Reflector = Callable[[Surface], tuple[Tensor, Tensor]]
"""Lobe and diffuse light (..., P, T) of a surface whose table has a leading axis P, by its material with all
the effects on it."""


@dataclass(frozen=True)
class Scatter:
    """Further sunlight: ``light`` gives it by component, (..., T), from what materials and the effect's
    parameters are at present; ``values`` is how many numbers it holds for one of them."""

    light: Callable[[Reflector, Parameters], Mapping[str, Tensor]]
    values: int = 1


@dataclass(frozen=True)
class Entry:
    """One item of a list of effects: ``name``, ``name[target]``, and, where the diagnosis divides an offset,
    ``name@curve`` (or ``@night``, ``@station``): a value for each, drawn from a normal of standard deviation
    ``width`` (``name@curve~width``)."""

    name: str
    target: str | None = None
    per: str | None = None
    width: float | None = None

    @classmethod
    def parse(cls, text: str) -> Entry:
        """The parts of an item; the whole of one that has another form counts as a name, which no effect has."""
        match = ENTRY.fullmatch(text)
        if match is None:
            return cls(text)
        width = match["width"]
        return cls(match["name"], match["target"], match["per"], float(width) if width else None)

    @classmethod
    def split(cls, text: str) -> list[str]:
        """Items of a list as it is typed: commas divide it, those in brackets belong to a target."""
        return [item.strip() for item in re.split(r",(?![^\[]*\])", text) if item.strip()]

    @property
    def plain(self) -> str:
        """The entry without the width."""
        return self.name + (f"[{self.target}]" if self.target else "") + (f"@{self.per}" if self.per else "")

    def __str__(self) -> str:
        return self.plain + (f"~{self.width:.3g}" if self.width is not None else "")


def turned_poses(
    poses: Sequence[Tensor | None], parts: Sequence[Part], turn: Callable[[Tensor, Part], Tensor]
) -> tuple[Tensor | None, ...]:
    """Poses of parts, with those of the parts that track the Sun turned; parts that stand alike have one pose, and
    keep one."""
    found: dict[int, Tensor] = {}
    for pose, part in zip(poses, parts, strict=True):
        if pose is not None and part.tracks_axis is not None and id(pose) not in found:
            found[id(pose)] = turn(pose, part)
    return tuple(pose if pose is None else found.get(id(pose), pose) for pose in poses)


EFFECTS: Registry[type[Effect]] = Registry("effect")
"""Every effect by the name that a scene uses."""


class Effect(nn.Module):
    """Physics, or noise, that a bare facet sum leaves out. Subclasses set ``name``, ``title`` (what it is, in a few plain
    words), ``shown`` (how its page shows it), ``stage``, ``quantities`` and override the method of their stage; ``per`` gives each material or component its own set of
    parameters; ``known`` switches it on by default; ``nodes`` is by how much it multiplies the instants or
    lights; ``widens`` a light effect that leaves discs whole where a view asks for that; ``steps`` into how many parts its one parameter is divided, from 0 to the upper bound, for light
    to be interpolated where nothing else moves the geometry (0: never); ``scanned`` names a quantity in hours
    after the first row, the instant from which on the effect acts, alike whenever that is: it has to be tried at every row, for no descent finds it; ``turning`` marks a ``swing``,
    whose quantities are amplitude, period, phase, longitude and latitude of the axis, or a ``jump``, whose are turns
    about the body axes and the time; ``brdf`` is the
    reflection model of a surface that it adds; ``simplex`` names quantities whose sum may not exceed 1; ``linear`` marks an effect of the geometry whose parameters
    only scale its light; ``divisible`` an offset that each curve or night may have for itself (``by`` names
    the division of this one, ``width`` the spread of its values); ``taken`` holds what the scene calls its own numbers and
    components; ``unable`` says why what is not among its
    targets cannot be one; ``spans_exposure`` marks the clock whose ``instants`` divide exposures; ``at_middle`` a
    scatter that is worked out for mid-exposure alone; ``reshapes_lobe`` a material that gives lobes another form, so that no
    table of theirs serves it; ``joins_parts`` a surface that every other part has a hand in, and so costs much for a new
    geometry; ``shifts_clock`` a clock whose first quantity is an offset, s, the same for all instants of a row;
    ``adds_area`` one that adds a surface, which sizes of the scene's components may stand for; ``opaque_air`` names
    the quantity that is the height, km, of the air that takes sunlight away; ``timed_by_rows`` marks numbers that mean
    something for one recording alone, for they count time from its rows; ``prior_odds`` is how probable the effect is,
    before a recording is seen, over one of which nothing is known.

    An effect may learn: what ``__init__`` sets as ``nn.Parameter`` or ``nn.Module`` (a small network) is a part of the
    light curve that has the effect, for an optimiser of its own; fits and samplers leave it as it is."""

    name: ClassVar[str]
    title: ClassVar[str]
    shown: ClassVar[Shown] = Shown()
    stage: ClassVar[str]
    quantities: tuple[Quantity, ...] = ()
    per: ClassVar[str | None] = None
    known: ClassVar[bool] = False
    order: ClassVar[int] = 0
    needs_shares: ClassVar[bool] = False
    nodes: int = 1
    widens: ClassVar[bool] = False
    steps: int = 0
    scanned: ClassVar[str] = ""
    turning: ClassVar[str] = ""
    brdf: ClassVar[type[Brdf] | None] = None
    simplex: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[bool] = False
    divisible: ClassVar[bool] = False
    by: str | None = None
    width: float | None = None
    spans_exposure: ClassVar[bool] = False
    at_middle: ClassVar[bool] = False
    adds_area: ClassVar[bool] = False
    opaque_air: ClassVar[str] = ""
    taken: frozenset[str] = frozenset()
    reshapes_lobe: ClassVar[bool] = False
    joins_parts: ClassVar[bool] = False
    shifts_clock: ClassVar[bool] = False
    timed_by_rows: ClassVar[bool] = False
    prior_odds: ClassVar[float] = 1.0
    unable: ClassVar[str] = "the scene has nothing of this name"

    def __init_subclass__(cls, **keywords: Any) -> None:
        """A class that gives itself a name and no title is called by its name."""
        super().__init_subclass__(**keywords)
        if "name" in vars(cls):
            if getattr(cls, "stage", None) not in STAGES:
                stage = getattr(cls, "stage", None)
                raise TypeError(f"effect {cls.name!r}: stage {stage!r}; expected one of {', '.join(STAGES)}")
            if "title" not in vars(cls):
                cls.title = cls.name.replace("_", " ")
        EFFECTS.declared(cls, "name")

    def __init__(self, target: str | None = None) -> None:
        super().__init__()
        self.target = target

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.target or ''})"

    @property
    def learns(self) -> bool:
        """Whether it has parameters of its own beside its quantities."""
        return next(self.parameters(), None) is not None

    def share(self, other: Effect) -> None:
        """Have the other's parameters, buffers and modules as its own."""
        self._parameters, self._buffers, self._modules = other._parameters, other._buffers, other._modules

    @property
    def entry(self) -> str:
        """Itself as a scene's list of effects has it."""
        return str(Entry(self.name, self.target, self.by, self.width))

    def origin(self, quantity: str) -> Origin:
        """Whose this number is: the effect's, as a list of parameters in a scene names it."""
        return Origin("effects", self.name, quantity, self.target)

    def full_name(self, quantity: str) -> str:
        """The number's full name, which no number of the scene has."""
        return self.origin(quantity).full_name(self.taken)

    @property
    def label(self) -> str:
        """Name of the component that it adds; with its role where the scene has a component of this name."""
        return f"effects[{self.name}]" if self.name in self.taken else self.name

    @property
    def material_key(self) -> str:
        """Name of the material that it brings, which no scene's material can have."""
        return f"effects[{self.name}]"

    def missing(self, context: Context) -> str | None:
        """Why these data cannot carry the effect, in words; None if they can."""
        able = self.targets(context)
        if self.target in able or (self.target is None and able):
            return None
        every = [name for name in self._all_targets(context) if name is not None]
        if self.target is not None and every and self.target not in every:
            has = ", ".join(map(shown, every))
            return f"the scene has no {self.per} {shown(self.target)}; its {self.per}s: {has}"
        return self.unable

    def held_already(self, context: Context) -> str | None:
        """Why every model of these data has the effect, asked for or not, in words; None if that is not so. A scene that
        lists it is read with a warning, so that one scene serves recordings with it and without."""
        return None

    def beside(self, others: Sequence[Effect]) -> str | None:
        """Why the effect cannot be applied together with these others, in words; None if it can."""
        return None

    def standard(self, context: Context) -> bool:
        """Whether a scene without a list of effects has it, if these data can carry it."""
        return self.known

    @property
    def capped(self) -> tuple[int, int] | None:
        """Of an effect that divides exposures: the instants that there are and that are needed, where memory does not
        allow all; else None."""
        return None

    def jumps(self, context: Context) -> str | None:
        """What of it jumps where the geometry moves steadily, as a plural: its slope is that of a step, 0, and not
        the true one; None if nothing does."""
        return None

    def prepared(self, context: Context) -> Self:
        """The effect made ready for these data: ``quantities`` that only they bound, or settle, and how many
        ``nodes`` they need."""
        return self

    def instants(self, context: Context) -> Instants | None:
        """Of a clock: the instants at which each exposure is worked out; None if it is one each."""
        return None

    def change(self, context: Context, reach: Tensor) -> Tensor:
        """Of a shade: how much of its whole range the factor on sunlight may change within ``reach`` (T,) s about the
        stamps, at most, (T,); 0 where it stays the same whatever the parameters are."""
        return torch.ones_like(reach)

    def limits(self, p: Parameters, context: Context) -> Sequence[str]:
        """What its approximations amount to at these values, a sentence each, where that is worth telling."""
        return ()

    @classmethod
    def targets(cls, context: Context) -> Sequence[str | None]:
        """What the effect may be applied to: materials or components where ``per`` says so, else the
        whole."""
        return cls._all_targets(context)

    @classmethod
    def _all_targets(cls, context: Context) -> Sequence[str | None]:
        """All materials or components of the scene where ``per`` says so, else the whole."""
        if cls.per == "material":
            return context.materials
        if cls.per == "component":
            return [part.name for part in context.parts]
        return [None]

    def clock(self, nodes: Nodes, p: Parameters, context: Context) -> Nodes:
        return nodes

    def orbit(self, request: Request, p: Parameters, context: Context) -> Request:
        return request

    def spin(self, values: dict[str, Any], p: Parameters, context: Context) -> dict[str, Any]:
        return values

    def attitude(self, rotation: Tensor, state: State, p: Parameters, context: Context) -> Tensor:
        return rotation

    def pointing(
        self, poses: tuple[Tensor | None, ...], p: Parameters, context: Context
    ) -> tuple[Tensor | None, ...]:
        return poses

    def light(
        self, lights: tuple[Light, ...], view: View, p: Parameters, context: Context
    ) -> tuple[Light, ...]:
        return lights

    def shade(self, sky: Sky, p: Parameters, context: Context) -> Tensor:
        """Factor (..., T) on sunlight; () if all of it is there."""
        return next(iter(p.values()), context.seconds).new_ones(())

    def surface(
        self, patches: tuple[Patch, ...], view: View, p: Parameters, context: Context
    ) -> tuple[Patch, ...]:
        return patches

    def scatter(self, view: View, context: Context) -> Scatter:
        """What geometry alone says of it is worked out here; the function that it returns adds materials and
        parameters."""
        return Scatter(lambda reflect, p: {})

    def material(
        self, reflect: Reflect, surface: Surface, values: Mapping[str, Tensor], p: Parameters
    ) -> Reflect:
        return reflect

    def detector(self, brightness: Brightness, p: Parameters, context: Context) -> Brightness:
        return brightness

    def noise(self, noise: Noise, p: Parameters, context: Context) -> Noise:
        return noise


def first_sentence(effect: type[Effect]) -> str:
    """The first paragraph of an effect's docstring, up to its first full stop or colon."""
    paragraph = inspect.cleandoc(effect.__doc__ or "").split("\n\n")[0]
    return " ".join(paragraph.split()).replace("``", "")
