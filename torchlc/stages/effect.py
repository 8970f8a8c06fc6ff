"""The contract of an effect: one class, its parameters, and one method of one stage.

Stages, their order and what passes through each: :mod:`torchlc.stages.order`. An effect changes what passes through its own
stage and nothing else.

Letters: B batch, L lights, Q instants within an exposure, T rows, F facets, C components. The tensors of
``p``, an effect's own parameters, end in a row axis of size 1 or T; any batch axes stand before it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import torch
from torch import Tensor, nn

from torchlc.brdf.base import Brdf
from torchlc.naming import Origin, Registry
from torchlc.parameters import Quantity
from torchlc.scene.problems import shown
from torchlc.stages.entry import Entry
from torchlc.stages.instants import Instants, Nodes, Request
from torchlc.stages.light import UNRESOLVED, Brightness, Light, Patch, Sky, Surface, View
from torchlc.stages.memory import Memory
from torchlc.stages.noise import Noise
from torchlc.stages.order import SCALING_STAGES, STAGES
from torchlc.stages.showing import Shown

if TYPE_CHECKING:
    from torchlc.geometry.orbit import State, Track
    from torchlc.geometry.rotation.attitude import Attitude
    from torchlc.shapes import Facets, Part, Shape

Parameters = Mapping[str, Tensor]
MANY_FACETS = 100
"""Flat ones, from where effects that take several lights a facet take fewer."""


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
                self.bounds[effect.full_name(quantity.name)] != (quantity.off, quantity.off)
                for quantity in effect.quantities
            )
            for effect in self.effects
            if not effect.spans_exposure
        )

    def at_rows(self, rows: Tensor) -> Context:
        """The context of some rows (N,), which may repeat."""
        per_row = {
            each.name: value[rows]
            for each in fields(self)
            if isinstance(value := getattr(self, each.name), Tensor)
        }
        return replace(self, **per_row, track=self.track.at_rows(rows))

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.shape.parts

    @property
    def radius(self) -> float:
        """Largest distance of a corner of the object from the body's origin, m, at the scene's sizes."""
        return max(float(torch.linalg.vector_norm(facets.vertices, dim=-1).max()) for facets in self.rest)

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


def turned_poses(
    poses: Sequence[Tensor | None], parts: Sequence[Part], turn: Callable[[Tensor, Part], Tensor]
) -> tuple[Tensor | None, ...]:
    """Poses of parts, with those of the parts that track the Sun turned; parts that stand alike have one pose, and
    keep one."""
    turned: dict[int, Tensor] = {}
    for pose, part in zip(poses, parts, strict=True):
        if pose is not None and part.tracks_axis is not None and id(pose) not in turned:
            turned[id(pose)] = turn(pose, part)
    return tuple(pose if pose is None else turned.get(id(pose), pose) for pose in poses)


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
    reflection model of a surface that it adds; ``simplex`` names quantities whose sum may not exceed 1, ``coupled`` where light is in proportion to the last times one minus the first; ``linear`` marks an effect of the geometry whose parameters
    only scale its light; ``divisible`` an offset that each curve or night may have for itself (``by`` names
    the division of this one, ``width`` the spread of its values); ``taken`` holds what the scene calls its own numbers and
    components; ``unable`` says why what is not among its
    targets cannot be one; ``spans_exposure`` marks the clock whose ``instants`` divide exposures; ``at_middle`` a
    scatter that is worked out for mid-exposure alone; ``reshapes_lobe`` a material that gives lobes another form, so that no
    table of theirs serves it; ``joins_parts`` a surface that every other part has a hand in, and so costs much for a new
    geometry; ``shifts_clock`` a clock whose first quantity is an offset, s, the same for all instants of a row;
    ``whole_turn`` of a divisible phase of the spin what a turn is in its unit, 0 of all else;
    ``adds_area`` one that adds a surface, which sizes of the scene's components may stand for; ``opaque_air`` names
    the quantity that is the height, km, of the air that takes sunlight away; ``timed_by_rows`` marks numbers that mean
    something for one recording alone, for they count time from its rows; ``swings`` names the angle of a "pointing" effect that is
    constant here, and that a diagnosis may find to swing; ``prior_odds`` is how probable the effect is,
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
    coupled: ClassVar[bool] = False
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
    whole_turn: ClassVar[float] = 0.0
    timed_by_rows: ClassVar[bool] = False
    swings: ClassVar[str] = ""
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

    @classmethod
    def one_sided(cls) -> bool:
        """Whether the change of the light that it makes has no opposite: each number that switches it off does so at a bound and changes
        the light in proportion, or it has none that does. Of glints that are moved or widened a small step may ask for less where the minimum
        has much of it, and sharper lobes."""
        switches = [
            (quantity.low, quantity.off, quantity.high)
            for quantity in cls.quantities
            if quantity.off is not None
        ]
        scales = not switches or cls.stage in SCALING_STAGES
        return scales and all(not low < off < high for low, off, high in switches)

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

    def law(self, model: type[Brdf]) -> type[Brdf]:
        """Of a material: the law that its surfaces have with the effect, which may tabulate more than ``model`` does."""
        return model

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
