"""From a scene and a recording to everything a light curve needs: track, attitude, shape, effects and the
parameter set."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchlc.attitude import Attitude
from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.effects import GEOMETRY_STAGES, every, registry
from torchlc.effects.base import Context, Effect, Entry
from torchlc.errors import InputError
from torchlc.naming import Origin
from torchlc.orbit import Track, make_track
from torchlc.parameters import Free, ParameterSet, Prior, Quantity, prior_of
from torchlc.recording import Recording
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.scene.problems import shown
from torchlc.shape import Facets, Shape
from torchlc.spelling import did_you_mean

DEFAULT_SUN_MAGNITUDE = -26.7
RESOLVED_N = 1e4
"""Smooth shapes are cut finely enough for exponents up to here, or up to a smaller upper bound."""

ZERO_POINT = Quantity("zero_point", "mag", -math.inf, math.inf, "added to every magnitude", off=0.0)


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
    """By full name, what a number has a value for each of: "curve", "station" or "night"."""
    warnings: tuple[str, ...]
    dtype: torch.dtype = torch.float64
    device: str = "cpu"

    @property
    def T(self) -> int:
        return len(self.context.seconds)

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
        """Facet-row pairs of one evaluation, with the instants and lights that the effects bring; sizes the
        batches."""
        facets = sum(len(part.faces) for part in self.shape.parts)
        return facets * self.T * max(1, math.prod(effect.nodes for effect in self.effects))

    @property
    def traced_pairs(self) -> int:
        """Facet-row pairs of the parts that are traced by rays."""
        return self.T * sum(len(part.faces) for part in self.shape.parts if part.hull is None)

    @cached_property
    def patches(self) -> list[list[tuple[str, Tensor]]]:
        """For each part, the materials on it and the facets (indices) of each."""
        found = []
        for part in self.shape.parts:
            names = np.array(part.materials)
            groups = dict.fromkeys(part.materials)
            found.append(
                [(m, torch.as_tensor(np.flatnonzero(names == m), device=self.device)) for m in groups]
            )
        return found

    @cached_property
    def geometry_columns(self) -> list[int]:
        """Places in theta of the parameters that move the geometry: the attitude's, sizes, and those of
        effects before the shade stage."""
        owners = {
            effect.name: effect
            for effect in self.effects
            if effect.stage in GEOMETRY_STAGES and not effect.linear
        }
        columns = []
        for column, free in enumerate(self.parameters.free):
            origin = free.origin
            if origin.role == "effects":
                effect = owners.get(origin.owner)
                moves = effect is not None and not (
                    effect.brdf is not None and _is_material(effect.brdf, origin.quantity)
                )
            else:
                moves = origin.role in ("attitude", "components")
            if moves:
                columns.append(column)
        return columns

    @property
    def geometry_free(self) -> bool:
        """True if a free parameter moves the geometry."""
        return bool(self.geometry_columns)

    def stage(self, name: str) -> list[Effect]:
        return [effect for effect in self.effects if effect.stage == name]

    def own(self, effect: Effect, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """An effect's parameters by short name, each (..., 1) or (..., T)."""
        return {
            quantity.name: self.rows(values, effect.full_name(quantity.name))
            for quantity in effect.quantities
        }

    def rows(self, values: Mapping[str, Tensor], name: str) -> Tensor:
        """A parameter (..., 1), or (..., T) if it has a value for each curve, station or night."""
        if name in values:
            return values[name][..., None]
        index, ids = self.row_index[self.divided[name]]
        each = torch.broadcast_tensors(*[values[f"{name}[{member}]"] for member in ids])
        return torch.stack(each, -1)[..., index]

    def attitude_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the attitude's numbers by the attitude's own names, as `rows` gives them."""
        own = self._own_names["attitude"]
        return {**values, **{plain: self.rows(values, name) for plain, name in own.items()}}

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


def assemble(
    scene: Scene,
    recording: Recording,
    effects: Sequence[str] | None = None,
    *,
    base: Assembly | None = None,
    pinned: Mapping[str, float] | None = None,
    sharpest: float = RESOLVED_N,
) -> Assembly:
    """Bring scene and recording together under a list of effects (default: the scene's own).

    An entry of ``effects`` is a name, or ``name[target]`` for one material or component alone. ``base`` lends
    its track, attitude and shape; ``pinned`` fixes parameters at given values whatever the scene says of
    them. Smooth shapes are cut finely enough for exponents up to ``sharpest``.
    """
    if base is None:
        track = make_track(scene, recording)
        attitude = Attitude(scene, recording)
        lobes = _finest_lobes(scene, sharpest)
        shape = Shape(scene, lobes)
    else:
        track, attitude, shape, lobes = base.track, base.attitude, base.shape, base.context.lobes
    models = {name: MODELS[material.model] for name, material in scene.materials.items()}
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
    wanted = scene.model.effects if effects is None else list(effects)
    chosen = _effects(wanted, scene, context)
    models |= {effect.material_key: effect.brdf for effect in chosen if effect.brdf is not None}
    sun, warnings = _sun_magnitude(scene, recording)
    parameters, divided = _parameters(scene, chosen, models, row_index, pinned or {})
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
        tuple(dict.fromkeys(notes)),
    )


def _is_material(model: type[Brdf], short: str) -> bool:
    return short in model.shared or any(quantity.name == short for quantity in model.quantities)


def _finest_lobes(scene: Scene, sharpest: float) -> dict[str, float]:
    finest = {}
    for name, material in scene.materials.items():
        bounds = [1.0]
        for key, number in material.parameters.items():
            if key in ("n", "n_u", "n_v"):
                if isinstance(number, SceneFree):
                    top = number.high if number.high is not None else number.value + 3 * (number.sigma or 0.0)
                    bounds.append(min(top, max(sharpest, number.value)))
                else:
                    bounds.append(number)
            elif key in ("alpha", "m"):
                width = number.value if isinstance(number, SceneFree) else number
                bounds.append(min(2 / max(width, 1e-3) ** 2, sharpest))
        finest[name] = max(bounds)
    return finest


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
        track=track,
        attitude=attitude,
        shape=shape,
        rest=_at_rest(scene, shape),
        lobes=lobes,
        materials=list(scene.materials),
        models=dict(models),
        mode=scene.attitude.mode,
        light_time_corrected=recording.light_time_corrected,
        kind=recording.kind,
        errors=recording.error is not None,
    )


def _effects(wanted: Sequence[str] | None, scene: Scene, context: Context) -> tuple[Effect, ...]:
    known = registry()
    numbers = frozenset(scene.origins())
    parts = frozenset(component.name for component in scene.components)

    def made(effect: Effect, by: str | None = None, width: float | None = None) -> Effect:
        ready = effect.prepared(context)
        ready.taken, ready.by, ready.width = numbers | parts, by, width
        return ready

    if wanted is None:
        standard = [effect for cls in known.values() if (effect := cls()).standard(context)]
        return tuple(made(effect) for effect in standard if effect.missing(context) is None)
    found: list[Effect] = []
    for entry in wanted:
        parsed = Entry.parse(entry)
        name, target = parsed.name, parsed.target
        if name not in every():
            raise InputError(
                scene.source,
                "model.effects",
                f"{shown(entry)} is no effect",
                f"one of {', '.join(known)}",
                did_you_mean(name, known),
            )
        cls = every()[name]
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
            found.append(made(effect, parsed.per, parsed.width))
    order = list(every())
    return tuple(sorted(found, key=lambda effect: order.index(effect.name)))


def _set_targets(cls: type[Effect], scene: Scene) -> list[str]:
    """Targets that [model.parameters] names in brackets for an effect that has one set of parameters for
    each."""
    if cls.per is None:
        return []
    marked = [
        key.partition("[")[2].rstrip("]") for key in scene.model.parameters if key.startswith(f"{cls.name}.")
    ]
    return [target for target in dict.fromkeys(marked) if target]


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
) -> tuple[ParameterSet, dict[str, str]]:
    """The parameters, and by full name what those with several values have one for each of."""
    free: list[Free] = []
    fixed: dict[str, float] = {}
    divided: dict[str, str] = {}

    def add(name: str, origin: Origin, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            fixed[name] = pinned[name]
        elif number is None:
            prior = prior_of(quantity)
            start = quantity.mean if quantity.mean is not None else quantity.typical
            begin = 0.0 if start is None else start
            free.append(Free(name, prior, begin, quantity.unit, quantity.meaning, origin))
        elif isinstance(number, SceneFree):
            divide(name, origin, _prior(number, quantity), number.value, quantity, number.per)
        else:
            fixed[name] = float(number)

    def divide(
        name: str, origin: Origin, prior: Prior, start: float, quantity: Quantity, division: str | None
    ) -> None:
        """One free number, or one for each member of a division."""
        members = [(name, origin)]
        if division is not None:
            divided[name] = division
            ids = row_index[division][1]
            members = [(f"{name}[{member}]", origin.of(division, member)) for member in ids]
        for full, whose in members:
            if full in pinned:
                fixed[full] = pinned[full]
            else:
                free.append(Free(full, prior, start, quantity.unit, quantity.meaning, whose))

    numbers = scene.numbers()
    for name, origin in scene.origins().items():
        short = origin.quantity
        if origin.role == "materials":
            quantity = models[origin.owner].quantity(short)
        elif origin.role == "components":
            quantity = Quantity(short, "m", 0.0, math.inf, short)
        else:
            quantity = Quantity(short, "", -math.inf, math.inf, short)
        add(name, origin, numbers[name], quantity)
    given = scene.model.parameters
    add("zero_point", Origin("calibration", "", "zero_point"), given.get("zero_point", 0.0), ZERO_POINT)
    for effect in effects:
        for quantity in effect.quantities:
            name, origin = effect.full_name(quantity.name), effect.origin(quantity.name)
            if effect.by is not None:
                centre = quantity.off or 0.0
                prior = Prior(
                    "normal", quantity.low, quantity.high, centre, effect.width or quantity.sigma or 1.0
                )
                divide(name, origin, prior, centre, quantity, effect.by)
                continue
            number = given.get(origin.full_name(), given.get(f"{effect.name}.{quantity.name}"))
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
        (effect.full_name("r_spec"), effect.full_name("r_diff"))
        for effect in effects
        if {"r_spec", "r_diff"} <= {quantity.name for quantity in effect.quantities}
    ]
    return ParameterSet(free, fixed, simplex), divided


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
