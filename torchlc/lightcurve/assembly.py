"""From a scene and a recording to everything a light curve needs: track, attitude, shape, effects and the
parameter set."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.effects import GEOMETRY_STAGES, object_kind, registry
from torchlc.errors import InputError
from torchlc.geometry.orbit import Track, make_track
from torchlc.geometry.rotation.attitude import Attitude
from torchlc.naming import Origin
from torchlc.parameters import EXPONENT, WIDTH, Free, ParameterSet, Prior, Quantity, prior_of
from torchlc.readers import Recording
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.scene.checks import PARAMETER_KEY
from torchlc.scene.problems import shown
from torchlc.shapes import Facets, Part, Shape
from torchlc.shapes.smooth import Smooth
from torchlc.stages.effect import Columns, Context, Effect, Entry, Instants
from torchlc.suggest import did_you_mean
from torchlc.tensors.moving import CPU, on_cpu

DEFAULT_SUN_MAGNITUDE = -26.7
RESOLVED_N = 1e4
"""Lobes are expected to be as sharp as this, or as a smaller upper bound of the exponent."""
WIDE = 200.0
"""Exponent of a lobe as wide as one of m = 0.1, below which edges within it cost more than 0.002 mag."""

ZERO_POINT = Quantity("zero_point", "mag", -math.inf, math.inf, "added to every magnitude", off=0.0)
POLE_LATITUDE = Quantity("pole_lat", "deg", -90.0, 90.0, "latitude of the pole", prior="isotropic")


@dataclass(frozen=True)
class Assembly:
    """Everything fixed about a model; built once by :func:`assemble` and shared between models that differ in
    their effects."""

    scene: Scene
    recording: Recording
    track: Track
    attitude: Attitude
    shape: Shape
    effects: tuple[Effect, ...]
    parameters: ParameterSet
    models: Mapping[str, type[Brdf]]
    context: Context
    sun_magnitude: Tensor
    row_index: Mapping[str, tuple[Tensor, Sequence[str]]]
    divided: Mapping[str, str]
    """By full name, what a number has a value for each of: "curve", "station", "night" or "object"."""
    origins: Mapping[str, Origin]
    """By full name, whose each number is."""
    warnings: tuple[str, ...]
    optics: Context
    instants: Instants | None = None
    pinned: Mapping[str, float] = field(default_factory=dict)
    dtype: torch.dtype = torch.float64
    device: torch.device = CPU

    @property
    def T(self) -> int:
        return len(self.context.seconds)

    @property
    def N(self) -> int:
        """Instants at which the geometry is worked out: those of ``optics``, at least one a row."""
        return len(self.optics.seconds)

    @property
    def instant_row(self) -> Tensor | None:
        """The row of each instant, (N,); None if they are the rows."""
        return None if self.instants is None else self.instants.row

    @cached_property
    def apart(self) -> Columns | None:
        """Every instant as a column of the tables; None if rows have one."""
        if self.instants is None:
            return None
        return Columns.joined(self.instants, torch.ones(self.T, dtype=torch.bool))

    @cached_property
    def columns(self) -> Columns | None:
        """Columns of tables made for good: instants stay apart where the share of sunlight changes within the
        exposure."""
        if self.instants is None:
            return None
        apart = torch.zeros(self.T, dtype=torch.bool)
        for effect in self.stage("shade"):
            apart |= effect.change(self.context, exposures(self.context)) > 0
        return Columns.joined(self.instants, apart)

    @property
    def components(self) -> list[str]:
        names = [part.name for part in self.shape.parts]
        return names + [
            effect.label for effect in self.effects if effect.stage == "surface" and effect.quantities
        ]

    @property
    def needs_shares(self) -> bool:
        return any(effect.needs_shares for effect in self.effects)

    @cached_property
    def pairs(self) -> int:
        """Pairs of facet, or of a point on a curved surface, and row of one evaluation, with the instants and lights that the effects bring; sizes the
        batches."""
        surfaces = sum(self._slots(part) for part in self.shape.parts)
        return surfaces * self.N * max(1, math.prod(effect.nodes for effect in self.effects))

    @cached_property
    def pairs_of_discs(self) -> int:
        """The same where sources that are discs are left whole for parts that are not curved."""
        every = max(1, math.prod(effect.nodes for effect in self.effects))
        others = max(1, math.prod(effect.nodes for effect in self.effects if not effect.widens))
        curved = [any(points > 1 for points in part.whole.values()) for part in self.shape.parts]
        slots = zip(map(self._slots, self.shape.parts), curved, strict=True)
        return self.N * sum(count * (every if bent else others) for count, bent in slots)

    def _slots(self, part: Part) -> int:
        """Facets and points at which light of a part is summed; where parts shadow each other also the facets of
        curved surfaces."""
        faces = dict.fromkeys(zip(part.faces, part.materials, strict=True))
        whole = [
            face for face, material in faces if face in part.whole and not self.models[material].additive
        ]
        points = sum(part.whole[face] for face in whole)
        hidden = [face for face in whole if self.stage("surface") and part.whole[face] > 1]
        apart = (face not in whole or face in hidden for face in part.faces)
        return points + sum(apart)

    @property
    def traced_pairs(self) -> int:
        """Facet-row pairs of the parts that are traced by rays."""
        return self.N * sum(len(part.faces) for part in self.shape.parts if part.hull is None)

    @cached_property
    def patches(self) -> list[list[tuple[str, str | None, list[str], Tensor]]]:
        """For each part, the materials on it, each of its surfaces that is one whole by its label (else None), and the
        labels and the indices of the facets of each."""
        found = []
        for part in self.shape.parts:
            labels = [face if face in part.whole else None for face in part.faces]
            groups: dict[tuple[str, str | None], list[int]] = {}
            for index, key in enumerate(zip(part.materials, labels, strict=True)):
                groups.setdefault(key, []).append(index)
            found.append(
                [
                    (*key, [part.faces[i] for i in index], torch.as_tensor(index, device=self.device))
                    for key, index in groups.items()
                ]
            )
        return found

    @cached_property
    def moving(self) -> dict[str, str]:
        """Free parameters that move the geometry, in the order of theta, and where each does: the attitude's
        "spin", a "size", or the stage of an effect before shade."""
        stages = {name: self._moves(name) for name in self.parameters.names}
        return {name: stage for name, stage in stages.items() if stage is not None}

    @cached_property
    def settled(self) -> tuple[tuple[str, float], ...]:
        """Fixed numbers that the geometry depends on."""
        return tuple((name, value) for name, value in self.parameters.fixed.items() if self._moves(name))

    @cached_property
    def geometry_columns(self) -> list[int]:
        """Places in theta of the parameters that move the geometry."""
        return [self.parameters.names.index(name) for name in self.moving]

    def _moves(self, name: str) -> str | None:
        """The stage at which a number moves the geometry; None if it does not."""
        origin = self.origins[name]
        if origin.role == "attitude":
            return "spin"
        if origin.role == "components":
            return "size"
        if origin.role != "effects":
            return None
        for effect in self.effects:
            if effect.name != origin.owner or effect.linear or effect.stage not in GEOMETRY_STAGES:
                continue
            if effect.brdf is None or not _is_material(effect.brdf, origin.quantity):
                return effect.stage
        return None

    @property
    def geometry_free(self) -> bool:
        """True if the tables of the geometry cannot be kept: a free parameter moves it, or an effect learns it."""
        return bool(self.geometry_columns) or self.learns_geometry

    @cached_property
    def learns_geometry(self) -> bool:
        """True if an effect that learns acts where tables would hold what it did: they are then made anew at every call."""
        held = {*GEOMETRY_STAGES, "scatter"}
        return any(effect.stage in held and effect.learns for effect in self.effects)

    @property
    def learners(self) -> dict[str, nn.Module]:
        """What learns beside the free parameters, by whose it is: effects and laws of materials."""
        effects = {f"effects.{effect.entry}": effect for effect in self.effects}
        laws = {f"materials.{name}": law for name, law in self.models.items() if isinstance(law, nn.Module)}
        return {name: module for name, module in (effects | laws).items() if _has_state(module)}

    def effect_of(self, name: str) -> Effect | None:
        """The effect whose number this is, by its full name; None if it is the scene's."""
        origin = self.origins[name]
        if origin.role != "effects":
            return None
        return next((effect for effect in self.effects if effect.name == origin.owner), None)

    @property
    def parts_meet(self) -> bool:
        """True if parts shadow or light each other, which every new geometry has to have worked out anew."""
        return any(effect.joins_parts or effect.stage == "scatter" for effect in self.effects)

    def stage(self, name: str) -> list[Effect]:
        return [effect for effect in self.effects if effect.stage == name]

    def own(
        self, effect: Effect, values: Mapping[str, Tensor], row: Tensor | None = None
    ) -> dict[str, Tensor]:
        """An effect's parameters by short name, each (..., 1) or (..., T), or for the rows ``row`` (N,) asked for."""
        return {
            quantity.name: self.rows(values, effect.full_name(quantity.name), row)
            for quantity in effect.quantities
        }

    def rows(self, values: Mapping[str, Tensor], name: str, row: Tensor | None = None) -> Tensor:
        """A parameter (..., 1), or (..., T) if it has a value for each curve, station or night; (..., N) for the rows
        ``row`` (N,) asked for."""
        if name in values:
            return values[name][..., None]
        index, ids = self.row_index[self.divided[name]]
        index = index if row is None else index[row]
        each = torch.broadcast_tensors(*[values[f"{name}[{member}]"] for member in ids])
        return torch.stack(each, -1)[..., index]

    def attitude_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the attitude's numbers by the attitude's own names, as `rows` gives them for every
        instant."""
        own = self._own_names["attitude"]
        numbers = {plain: self.rows(values, name, self.instant_row) for plain, name in own.items()}
        return {**values, **numbers}

    def size_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the sizes of parts by the parts' own names."""
        return {**values, **{plain: values[name] for plain, name in self._own_names["components"].items()}}

    @cached_property
    def _own_names(self) -> dict[str, dict[str, str]]:
        """By role, the full names of the scene's numbers by their plain ones, which no two of a role share."""
        names: dict[str, dict[str, str]] = {"materials": {}, "attitude": {}, "components": {}}
        for name, origin in self.scene.origins().items():
            names[origin.role][origin.full_name()] = name
        return names

    def material_values(
        self, material: str, model: type[Brdf], values: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Values of one material, of the scene or of an effect (by its :attr:`Effect.material_key`), by the short
        names its model uses; a shared name appears under each name it stands for."""
        given = self._material_names(material)
        shared = {long: short for short, keys in model.shared.items() for long in keys}
        names = (quantity.name for quantity in model.quantities)
        return {name: values[given[name] if name in given else given[shared[name]]] for name in names}

    def lobes_at(self, values: Mapping[str, Tensor]) -> dict[str, float]:
        """The exponent of each material's sharpest lobe at these values."""
        lobes = {}
        for name, material in self.scene.materials.items():
            law, names = MODELS[material.model], self._material_names(name)
            own = [(law.quantity(key).role, float(values[names[key]])) for key in material.parameters]
            lobes[name] = max([1.0, *(one for role, number in own if (one := _exponent(role, number)))])
        return lobes

    def has_number(self, material: str, short: str) -> bool:
        """Whether a material has a number of this short name."""
        return short in self._material_names(material)

    def _material_names(self, material: str) -> dict[str, str]:
        """Full names of a material's numbers by the short ones."""
        if material in self.scene.materials:
            own = self._own_names["materials"]
            return {key: own[f"{material}.{key}"] for key in self.scene.materials[material].parameters}
        effect = next(one for one in self.effects if one.brdf is not None and one.material_key == material)
        return {quantity.name: effect.full_name(quantity.name) for quantity in effect.quantities}


@on_cpu
def assemble(
    scene: Scene,
    recording: Recording,
    effects: Sequence[str] | None = None,
    *,
    base: Assembly | None = None,
    pinned: Mapping[str, float] | None = None,
    finer: Tensor | None = None,
) -> Assembly:
    """Bring scene and recording together under a list of effects (default: the scene's own).

    An entry of ``effects`` is a name, or ``name[target]`` for one material or component alone. ``base`` lends
    its track, attitude and shape; ``pinned`` fixes parameters at given values whatever the scene says of
    them. ``finer`` (T,) marks rows whose exposures are divided twice as finely as they need.
    """
    if base is None:
        with scene.reading():
            track = make_track(scene, recording)
            attitude = Attitude(scene, recording)
            lobes = _finest_lobes(scene, RESOLVED_N)
            shape = Shape(scene, {name: lobes[name] for name in scene.materials if _uneven(scene, name)})
    else:
        track, attitude, shape, lobes = base.track, base.attitude, base.shape, base.context.lobes
    models = {name: _law(MODELS[material.model], name, base) for name, material in scene.materials.items()}
    context = (
        base.context
        if base is not None
        else _context(scene, recording, track, attitude, shape, models, lobes)
    )
    row_index = {
        "curve": (context.curve, recording.curve_ids),
        "station": (context.station, recording.station_ids),
        "night": (context.night, recording.night_ids),
    }
    if context.object is not None:
        row_index["object"] = (context.object, recording.object_ids)
    wanted = scene.model.effects if effects is None else list(effects)
    context = replace(context, finer=finer)
    _check_given(scene, context)
    held = {} if effects is not None else _held_already(wanted or [], context)
    listed = None if wanted is None else [entry for entry in wanted if entry not in held]
    chosen, context = _prepared(_effects(listed, scene, context), scene, context, pinned or {})
    for effect, learned in ((one, other) for one in chosen for other in (base.effects if base else ())):
        if type(effect) is type(learned) and effect.entry == learned.entry and learned.learns:
            effect.share(learned)
    models |= {effect.material_key: effect.brdf for effect in chosen if effect.brdf is not None}
    sun, warnings = _sun_magnitude(scene, recording)
    parameters, divided, origins = _parameters(scene, chosen, models, row_index, pinned or {}, warnings)
    if effects is None:
        warnings += _unused(scene, chosen) + [f"{entry} is left out: {why}" for entry, why in held.items()]
    several = [one for effect in chosen if (one := effect.instants(context)) is not None]
    instants = several[0] if several else None
    warnings += _edges_within_lobes(shape.parts, models, lobes)
    notes = (*scene.warnings, *recording.warnings, *track.warnings, *shape.warnings, *warnings)
    return Assembly(
        scene,
        recording,
        track,
        attitude,
        shape,
        chosen,
        parameters,
        models,
        context,
        torch.as_tensor(sun, dtype=torch.float64),
        row_index,
        divided,
        origins,
        tuple(dict.fromkeys(notes)),
        context if instants is None else context.at_rows(instants.row),
        instants,
        pinned or {},
    )


def _law(law: type[Brdf], material: str, base: Assembly | None) -> type[Brdf]:
    """The law of a material; that of ``base`` if it is the same, with what it has learnt."""
    own = None if base is None else base.models.get(material)
    return law.of_material() if own is None or own.__class__ is not law else own


def exposures(context: Context) -> Tensor:
    """The longest time that each exposure may take, (T,), s: as recorded, else the cadence."""
    return torch.full_like(context.seconds, context.cadence) if context.exptime is None else context.exptime


def _has_state(module: nn.Module) -> bool:
    return next(module.parameters(), None) is not None or next(module.buffers(), None) is not None


def _is_material(model: type[Brdf], short: str) -> bool:
    return short in model.shared or any(quantity.name == short for quantity in model.quantities)


def _uneven(scene: Scene, material: str) -> bool:
    """Whether a material's lobe may be wider along u than along v."""
    given, shared = scene.materials[material].parameters, MODELS[scene.materials[material].model].shared
    widths = [[given[name] for name in long] for short, long in shared.items() if short not in given]
    return any(isinstance(one, SceneFree) or one != several[0] for several in widths for one in several)


def _finest_lobes(scene: Scene, sharpest: float = math.inf) -> dict[str, float]:
    """The largest exponent of each material's lobe: of a free one the upper bound, up to ``sharpest``."""
    finest = {}
    for name, material in scene.materials.items():
        bounds = [1.0]
        law = MODELS[material.model]
        for key, number in material.parameters.items():
            role = law.quantity(key).role
            if role == EXPONENT:
                if isinstance(number, SceneFree):
                    top = number.high if number.high is not None else number.value + 3 * (number.sigma or 0.0)
                    bounds.append(min(top, max(sharpest, number.value)))
                else:
                    bounds.append(number)
            elif role == WIDTH:
                width = number.value if isinstance(number, SceneFree) else number
                bounds.append(min(_exponent(role, width) or 1.0, sharpest))
        finest[name] = max(bounds)
    return finest


def _exponent(role: str | None, number: float) -> float | None:
    """The exponent of a lobe that a number of its role makes; None if it makes none."""
    if role == EXPONENT:
        return number
    return 2 / max(number, 1e-3) ** 2 if role == WIDTH else None


def _edges_within_lobes(
    parts: Sequence[Part], models: Mapping[str, type[Brdf]], lobes: Mapping[str, float]
) -> list[str]:
    """What has to be said of curved surfaces of a law whose light has edges within a wide lobe."""
    return [
        f"{part.name}: the masking of V-shaped cavities ({material}) has edges within so wide a lobe. The light of a curved "
        "surface is within 0.006 mag (rms), single rows 0.02 mag; that of ggx, or of a smaller m, within 0.002 mag (rms)"
        for part in parts
        if isinstance(part, Smooth)
        for material in sorted(set(part.materials))
        if models[material].edged and lobes[material] < WIDE
    ]


def _at_rest(scene: Scene, shape: Shape) -> list[Facets]:
    numbers = {
        name: number.value if isinstance(number, SceneFree) else number
        for name, number in scene.numbers().items()
    }
    values = {name: torch.tensor(number, dtype=torch.float64) for name, number in numbers.items()}
    sizes = {
        origin.full_name(): values[name]
        for name, origin in scene.origins().items()
        if origin.role == "components"
    }
    return [part.facets({**values, **sizes}) for part in shape.parts]


def _context(
    scene: Scene,
    recording: Recording,
    track: Track,
    attitude: Attitude,
    shape: Shape,
    models: Mapping[str, type[Brdf]],
    lobes: Mapping[str, float],
) -> Context:
    seconds = torch.as_tensor(recording.seconds, dtype=torch.float64)
    gaps = np.diff(np.unique(recording.seconds))
    exptime = None if recording.exptime is None else torch.as_tensor(recording.exptime, dtype=torch.float64)
    airmass = None if track.airmass is None else torch.as_tensor(track.airmass, dtype=torch.float64)
    return Context(
        seconds=seconds,
        exptime=exptime,
        cadence=float(np.median(gaps)) if len(gaps) else 0.0,
        airmass=airmass,
        curve=torch.as_tensor(recording.curve, dtype=torch.long),
        station=torch.as_tensor(recording.station, dtype=torch.long),
        night=torch.as_tensor(recording.night, dtype=torch.long),
        curve_ids=recording.curve_ids,
        night_ids=recording.night_ids,
        object=None if recording.object is None else torch.as_tensor(recording.object, dtype=torch.long),
        track=track,
        attitude=attitude,
        shape=shape,
        rest=_at_rest(scene, shape),
        lobes=lobes,
        lobe_bounds=_finest_lobes(scene),
        materials=list(scene.materials),
        models=dict(models),
        mode=scene.attitude.mode,
        light_time_corrected=recording.light_time_corrected,
        kind=recording.kind,
        errors=recording.error is not None,
        limits=int(np.bincount(recording.curve[recording.upper_limit], minlength=1).max()),
    )


def _held_already(wanted: Sequence[str], context: Context) -> dict[str, str]:
    """Entries of a scene's list that a model of these data has without them, and why."""
    known = registry()
    asked = ((entry, known.get(Entry.parse(entry).name)) for entry in wanted)
    reasons = {entry: cls().held_already(context) for entry, cls in asked if cls is not None}
    return {entry: reason for entry, reason in reasons.items() if reason is not None}


def _effects(wanted: Sequence[str] | None, scene: Scene, context: Context) -> tuple[Effect, ...]:
    known = registry()
    numbers = frozenset(scene.origins())
    parts = frozenset(component.name for component in scene.components)

    def made(effect: Effect, by: str | None = None, width: float | None = None) -> Effect:
        effect.taken, effect.by, effect.width = numbers | parts, by, width
        return effect

    found: list[Effect] = []
    if wanted is None:
        standard = [effect for cls in known.values() if (effect := cls()).standard(context)]
        found = [made(effect) for effect in standard if effect.missing(context) is None]
    asked = list(wanted or ())
    if _from_population(scene) and (differ := object_kind().name) not in asked:
        asked.append(
            differ
        )  # what a zero point of each object amounts to: the population's, and noise that its rows share
    for entry in asked:
        parsed = Entry.parse(entry)
        name, target = parsed.name, parsed.target
        if name not in known:
            raise InputError(
                scene.source,
                "model.effects",
                f"{shown(entry)} is no effect",
                f"one of the {len(known)} that torchlc effects lists",
                did_you_mean(name, known),
            )
        cls = known[name]
        targets = [target] if target else _set_targets(cls, scene) or cls.targets(context) or [None]
        for one in targets:
            effect = cls(one)
            reason = effect.missing(context)
            if reason is None and one not in cls.targets(context):
                reason = "it has no target: it is of the whole object"
            if reason is not None:
                raise InputError(
                    scene.source, "model.effects", f"{Entry(name, one).plain} cannot be applied: {reason}"
                )
            _check_axes(effect, scene, context)
            found.append(made(effect, parsed.per, parsed.width))
    for effect in found:
        reason = effect.beside([other for other in found if other is not effect])
        if reason is not None:
            raise InputError(scene.source, "model.effects", f"{effect.name} cannot be applied: {reason}")
    order = list(known)
    return tuple(sorted(found, key=lambda effect: order.index(effect.name)))


def _from_population(scene: Scene) -> bool:
    """Whether each object has a zero point of its own, from a population whose spread is learnt."""
    number = scene.model.parameters.get("zero_point")
    return isinstance(number, SceneFree) and number.per == "object"


def _prepared(
    effects: Sequence[Effect], scene: Scene, context: Context, pinned: Mapping[str, float]
) -> tuple[tuple[Effect, ...], Context]:
    """The effects made ready for these data, and the context that knows of them and of their numbers' bounds."""
    bounds: dict[str, tuple[float, float]] = {}

    def bound(name: str, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            bounds[name] = (pinned[name], pinned[name])
        elif isinstance(number, SceneFree):
            several = [number.of(member) for member in number.values or ()]
            ends = [_ends(one, quantity) for one in (number, *several)]
            bounds[name] = (min(low for low, _ in ends), max(high for _, high in ends))
        elif number is not None:
            bounds[name] = (float(number), float(number))
        elif quantity.unless_set is not None:
            bounds[name] = (quantity.unless_set, quantity.unless_set)
        else:
            bounds[name] = (quantity.low, quantity.high)

    numbers = scene.numbers()
    for name, origin in scene.origins().items():
        if origin.role == "attitude":
            bound(origin.full_name(), numbers[name], Quantity(name, "", -math.inf, math.inf, ""))
    for effect in effects:
        for quantity in effect.quantities:
            name = effect.full_name(quantity.name)
            bound(name, None if effect.by else _given_number(effect, quantity, scene), quantity)
    context = replace(context, bounds=bounds, effects=effects)
    # how finely exposures are divided depends on what the others do
    others = [effect if effect.spans_exposure else effect.prepared(context) for effect in effects]
    context = replace(context, effects=others)
    ready = tuple(effect.prepared(context) if effect.spans_exposure else effect for effect in others)
    return ready, replace(context, effects=ready)


def _ends(number: SceneFree, quantity: Quantity) -> tuple[float, float]:
    """Between what a number lies: itself where it is fixed."""
    if number.sigma is number.low is number.high is None:
        return number.value, number.value
    prior = _prior(number, quantity)
    return _end(prior, -1.0), _end(prior, 1.0)


def _end(prior: Prior, side: float) -> float:
    """The lower (side -1) or upper (1) end of a prior, five standard deviations away where it has none."""
    end = prior.low if side < 0 else prior.high
    return end if math.isfinite(end) else prior.centre + side * 5 * prior.sigma


def _check_axes(effect: Effect, scene: Scene, context: Context) -> None:
    """InputError where an effect on a material gives it numbers along u and v, and the facets of a part of it have no such axes."""
    numbers = {quantity.name for quantity in effect.quantities}
    for component in scene.components if effect.stage == "material" else ():
        if component.axes_wanted is None:
            continue
        apart = context.models[component.material].along_axes
        if effect.target in (None, component.material) and len(numbers.intersection(apart)) > 1:
            found = f"{effect.name} has {' and '.join(apart)} apart, and the {component.shape} says nothing of the direction of u"
            raise InputError(scene.source, f"component {component.name!r}", found, component.axes_wanted)


def _set_targets(cls: type[Effect], scene: Scene) -> list[str]:
    """Targets that [model.parameters] names in brackets for an effect that has one set of parameters for
    each."""
    if cls.per is None:
        return []
    marked = [
        key.partition("[")[2].rstrip("]") for key in scene.model.parameters if key.startswith(f"{cls.name}.")
    ]
    return [target for target in dict.fromkeys(marked) if target]


def _check_given(scene: Scene, context: Context) -> None:
    """InputError where [model.parameters] gives a number that its effect does not have, or not on that target."""
    for key in scene.model.parameters:
        match = PARAMETER_KEY.fullmatch(key)
        if match is None:
            continue
        name, quantity, target = match["effect"], match["quantity"], match["target"]
        place, known = f'model.parameters."{key}"', registry()
        if name not in known:
            found, expected = (
                f"unknown effect {shown(name)}",
                f"one of the {len(known)} that torchlc effects lists",
            )
            raise InputError(scene.source, place, found, expected, did_you_mean(name, registry()))
        numbers = [one.name for one in known[name].quantities]
        if quantity not in numbers:
            expected = f"one of {', '.join(numbers)}" if numbers else "no such key: the effect has no numbers"
            hint = did_you_mean(quantity, numbers)
            raise InputError(scene.source, place, f"{name} has no number {shown(quantity)}", expected, hint)
        if target is None:
            continue
        targets = [one for one in known[name].targets(context) if one is not None]
        if target not in targets:
            expected = f"one of {', '.join(targets)}" if targets else f'"{name}.{quantity}", without brackets'
            found, hint = f"{name} cannot be applied to {shown(target)}", did_you_mean(target, targets)
            raise InputError(scene.source, place, found, expected, hint)


def _keys(effect: Effect, quantity: Quantity) -> tuple[str, str]:
    """How [model.parameters] may name a number of an effect: with its target, or for all targets at once."""
    return effect.origin(quantity.name).full_name(), f"{effect.name}.{quantity.name}"


def _given_number(effect: Effect, quantity: Quantity, scene: Scene) -> Number | None:
    """What [model.parameters] says of an effect's number; InputError where its value is beyond the number's range."""
    given = scene.model.parameters
    key = next((key for key in _keys(effect, quantity) if key in given), None)
    if key is None:
        return None
    number = given[key]
    for value in number.starts if isinstance(number, SceneFree) else [float(number)]:
        if not quantity.low <= value <= quantity.high:
            place = f'model.parameters."{key}"' + (".value" if isinstance(number, SceneFree) else "")
            raise InputError(scene.source, place, f"{value:g}", _range(quantity))
    return number


def _cut(name: str, number: SceneFree, quantity: Quantity) -> list[str]:
    """A sentence where a prior reaches beyond the range of its number."""
    beyond = (number.low is not None and number.low < quantity.low) or (
        number.high is not None and number.high > quantity.high
    )
    return [f"the prior of {name} is cut to {_range(quantity)}, the range of this number"] if beyond else []


def _range(quantity: Quantity) -> str:
    unit = f" {quantity.unit}" if quantity.unit else ""
    if quantity.high == math.inf:
        return f"{quantity.low:g}{unit} or more"
    return f"{quantity.low:g} to {quantity.high:g}{unit}"


def _unused(scene: Scene, effects: Sequence[Effect]) -> list[str]:
    """A sentence for each number of [model.parameters] that none of the model's effects has."""
    names = {effect.name for effect in effects}
    used = {key for effect in effects for one in effect.quantities for key in _keys(effect, one)}
    warnings = []
    for key in scene.model.parameters:
        match = PARAMETER_KEY.fullmatch(key)
        if match is None or key in used:
            continue
        why = (
            f"{match['effect']} takes what it needs from the recording"
            if match["effect"] in names
            else f"{match['effect']} is not among the model's effects; a diagnosis takes it as a prior"
        )
        warnings.append(f"[model.parameters] {key} is not used: {why}")
    return warnings


def _sun_magnitude(scene: Scene, recording: Recording) -> tuple[np.ndarray, list[str]]:
    given = scene.model.band_sun_magnitude
    rows = len(recording.seconds)
    if isinstance(given, Mapping):
        if recording.band is None:
            raise InputError(
                scene.source,
                "model.parameters.band_sun_magnitude",
                "a table by band, but the recording has no band column",
                "one number, or a band column",
                None,
            )
        unknown = sorted(set(recording.band) - set(given))
        if unknown:
            raise InputError(
                scene.source, "model.parameters.band_sun_magnitude", f"no value for band {unknown[0]!r}"
            )
        return np.array([given[band] for band in recording.band]), []
    if given is None:
        warning = f"band_sun_magnitude is not given: {DEFAULT_SUN_MAGNITUDE} is taken"
        return np.full(rows, DEFAULT_SUN_MAGNITUDE), [warning] if recording.kind == "mag" else []
    return np.full(rows, float(given)), []


def _parameters(
    scene: Scene,
    effects: Sequence[Effect],
    models: Mapping[str, type[Brdf]],
    row_index: Mapping[str, tuple[Tensor, Sequence[str]]],
    pinned: Mapping[str, float],
    warnings: list[str],
) -> tuple[ParameterSet, dict[str, str], dict[str, Origin]]:
    """The parameters; by full name what those with several values have one for each of; and by full name whose each
    number is, free or fixed."""
    free: list[Free] = []
    fixed: dict[str, float] = {}
    divided: dict[str, str] = {}
    origins: dict[str, Origin] = {}

    def add(name: str, origin: Origin, number: Number | None, quantity: Quantity) -> None:
        origins[name] = origin
        if name in pinned:
            fixed[name] = pinned[name]
        elif number is None and quantity.unless_set is not None:
            fixed[name] = quantity.unless_set
        elif number is None:
            prior = prior_of(quantity)
            start = quantity.mean if quantity.mean is not None else quantity.typical
            begin = 0.0 if start is None else start
            free.append(Free(name, prior, begin, quantity.unit, quantity.meaning, origin, quantity.role))
        elif isinstance(number, SceneFree):
            if number.prior == "isotropic" and quantity.prior != "isotropic":
                raise InputError(
                    scene.source,
                    f"{name}.prior",
                    '"isotropic" for a number that is no latitude of a direction',
                    "another prior",
                    "The longitude of a direction that may point anywhere is uniform.",
                )
            if quantity.prior == "isotropic" and "prior" not in number.model_fields_set:
                warnings.append(
                    f"{name} has a prior uniform in degrees, which favours directions near the poles; "
                    'prior = "isotropic" is uniform on the sphere'
                )
            divide(name, origin, number, quantity)
        else:
            fixed[name] = float(number)

    def divide(name: str, origin: Origin, number: SceneFree, quantity: Quantity) -> None:
        """One free number, or one for each member of a division, free or fixed."""
        division = number.per
        members = [(name, origin, number)]
        if division is not None:
            if division not in row_index:
                found, expected = f'per = "{division}"', f"a column {division}, which the recording lacks"
                raise InputError(scene.source, name, found, expected)
            divided[name] = division
            ids = row_index[division][1]
            members = [(f"{name}[{one}]", origin.of(division, one), number.of(one)) for one in ids]
            warnings.extend(_unmet(name, number, ids))
        for full, whose, own in members:
            origins[full] = whose
            if full in pinned:
                fixed[full] = pinned[full]
            elif number.fixed:
                fixed[full] = own.value
            else:
                prior = _prior(own, quantity)
                free.append(
                    Free(full, prior, own.value, quantity.unit, quantity.meaning, whose, quantity.role)
                )

    numbers = scene.numbers()
    for name, origin in scene.origins().items():
        short = origin.quantity
        if origin.role == "materials":
            quantity = models[origin.owner].quantity(short)
        elif origin.role == "components":
            quantity = Quantity(short, "m", 0.0, math.inf, short)
        elif origin.role == "attitude" and short == POLE_LATITUDE.name:
            quantity = POLE_LATITUDE
        else:
            quantity = Quantity(short, "", -math.inf, math.inf, short)
        add(name, origin, numbers[name], quantity)
    zero_point = scene.model.parameters.get("zero_point", 0.0)
    if isinstance(zero_point, SceneFree) and _from_population(scene):
        if zero_point.values is not None:
            expected = "no values: the offsets of objects are integrated out"
            raise InputError(scene.source, "model.parameters.zero_point.values", "a table", expected)
        zero_point = zero_point.model_copy(update={"per": None})  # that of the population
    add("zero_point", Origin("calibration", "", "zero_point"), zero_point, ZERO_POINT)
    for effect in effects:
        for quantity in effect.quantities:
            name, origin = effect.full_name(quantity.name), effect.origin(quantity.name)
            if effect.by is not None:
                divide(name, origin, divided_offset(effect, quantity), quantity)
                continue
            number = _given_number(effect, quantity, scene)
            if isinstance(number, SceneFree):
                warnings += _cut(name, number, quantity)
            whole = effect.brdf is not None or effect.stage == "material"
            if whole and isinstance(number, SceneFree) and number.per is not None:
                of = "a part" if effect.brdf is not None else "of a material"
                place, expected = f"{name}.per", f"one value for the whole recording: the effect is {of}"
                raise InputError(scene.source, f"model.parameters.{place}", f'"{number.per}"', expected)
            add(name, origin, number, quantity)
    own = {origin: name for name, origin in scene.origins().items()}
    simplex = [
        (own[Origin("materials", material, a)], own[Origin("materials", material, b)])
        for material in scene.materials
        for a, b in zip(models[material].simplex, models[material].simplex[1:], strict=False)
    ]
    simplex += [
        (effect.full_name(a), effect.full_name(b))
        for effect in effects
        for a, b in zip(effect.simplex, effect.simplex[1:], strict=False)
    ]
    return ParameterSet(free, fixed, simplex), divided, origins


def divided_offset(effect: Effect, quantity: Quantity) -> SceneFree:
    """The prior of an offset that an effect divides, as a scene would give it."""
    alone = effect.width is None and quantity.apart is not None
    sigma = quantity.apart if alone else effect.width or quantity.sigma or 1.0
    return SceneFree(
        value=quantity.off or 0.0,
        sigma=sigma,
        prior="cauchy" if alone else "normal",
        per=cast(Any, effect.by),
    )


def _unmet(name: str, number: SceneFree, members: Sequence[str]) -> list[str]:
    """What has to be said where the values of a number and the nights, say, of the recording are not the same."""
    if number.values is None:
        return []
    lacking = [one for one in members if one not in number.values]
    spare = [one for one in number.values if one not in members]
    told = []
    if lacking:
        told.append(
            f"{name} has no value for the {number.per} {', '.join(lacking)}: {number.value:g} is taken"
        )
    if spare:
        told.append(f"{name} has values for no {number.per} of the recording: {', '.join(spare)}")
    return told


def _prior(number: SceneFree, quantity: Quantity) -> Prior:
    kind = number.prior or ("normal" if number.sigma is not None else "uniform")
    low = -math.inf if number.low is None else number.low
    high = math.inf if number.high is None else number.high
    low, high = max(low, quantity.low), min(high, quantity.high)
    if kind == "lognormal":
        low = max(low, 0.0)
    if kind == "halfnormal":
        low = max(low, 0.0)
        return Prior(kind, low, high, low, number.sigma or 1.0)
    return Prior(kind, low, high, number.value, number.sigma or 1.0)
