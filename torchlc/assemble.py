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
from torchlc.orbit import Track, make_track
from torchlc.parameters import Free, ParameterSet, Prior, Quantity, prior_of
from torchlc.recording import Recording
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.shape import Facets, Shape
from torchlc.spelling import did_you_mean

DEFAULT_SUN_MAGNITUDE = -26.7
RESOLVED_N = 1e4
"""Smooth shapes are cut finely enough for exponents up to here, or up to a smaller upper bound."""

ZERO_POINT = Quantity("zero_point", "mag", -math.inf, math.inf, "added to every magnitude", off=0.0)
COMPONENT_SIZES = (
    "size_x",
    "size_y",
    "size_z",
    "size_u",
    "size_v",
    "radius",
    "radius_top",
    "length",
    "depth",
)


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
            effect.name for effect in self.effects if effect.stage == "surface" and effect.quantities
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
        found = []
        for column, name in enumerate(self.parameters.names):
            owner, _, short = name.partition("[")[0].rpartition(".")
            effect = owners.get(name.partition(".")[0])
            material = effect is not None and effect.brdf is not None and _is_material(effect.brdf, short)
            if owner == "attitude" or short in COMPONENT_SIZES or (effect is not None and not material):
                found.append(column)
        return found

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
        for index, ids in self.row_index.values():
            keys = [f"{name}[{one}]" for one in ids]
            if keys and all(key in values for key in keys):
                return torch.stack(torch.broadcast_tensors(*[values[key] for key in keys]), -1)[..., index]
        raise KeyError(name)

    def attitude_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the attitude's numbers by full name as `rows` gives them."""
        return {**values, **{name: self.rows(values, name) for name in self.attitude.numbers}}

    def material_values(
        self, material: str, model: type[Brdf], values: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Values of one material by the short names its model uses; a shared name appears under each name it
        stands for."""
        found = {}
        for quantity in model.quantities:
            name = f"{material}.{quantity.name}"
            if name not in values:
                name = next(
                    f"{material}.{short}" for short, long in model.shared.items() if quantity.name in long
                )
            found[quantity.name] = values[name]
        return found


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
        with scene.reading():
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
    models |= {effect.name: effect.brdf for effect in chosen if effect.brdf is not None}
    sun, warnings = _sun_magnitude(scene, recording)
    parameters = _parameters(scene, chosen, models, row_index, pinned or {})
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
    return [part.facets(values) for part in shape.parts]


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
    if wanted is None:
        standard = [effect for cls in known.values() if (effect := cls()).standard(context)]
        return tuple(effect.prepared(context) for effect in standard if effect.missing(context) is None)
    found: list[Effect] = []
    for entry in wanted:
        parsed = Entry.parse(entry)
        name, target = parsed.name, parsed.target
        if name not in every():
            raise InputError(
                scene.source,
                "model.effects",
                f"{entry!r} is no effect",
                f"one of {', '.join(known)}",
                did_you_mean(name, known),
            )
        cls = every()[name]
        targets = [target] if target else _set_targets(cls, scene) or cls.targets(context) or [None]
        for one in targets:
            effect = cls(one)
            reason = effect.missing(context)
            if reason is not None:
                raise InputError(scene.source, "model.effects", f"{name} cannot be applied: {reason}")
            effect = effect.prepared(context)
            effect.by, effect.width = parsed.per, parsed.width
            found.append(effect)
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
) -> ParameterSet:
    free: list[Free] = []
    fixed: dict[str, float] = {}

    def add(name: str, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            fixed[name] = pinned[name]
        elif number is None:
            prior = prior_of(quantity)
            start = quantity.mean if quantity.mean is not None else quantity.typical
            free.append(Free(name, prior, 0.0 if start is None else start, quantity.unit, quantity.meaning))
        elif isinstance(number, SceneFree):
            prior = _prior(number, quantity)
            ids = row_index[number.per][1] if number.per else None
            for one in [name] if ids is None else [f"{name}[{one}]" for one in ids]:
                if one in pinned:
                    fixed[one] = pinned[one]
                else:
                    free.append(Free(one, prior, number.value, quantity.unit, quantity.meaning))
        else:
            fixed[name] = float(number)

    for name, number in scene.numbers().items():
        owner, _, short = name.rpartition(".")
        if owner in scene.materials and short not in COMPONENT_SIZES:
            quantity = models[owner].quantity(short)
        else:
            low = 0.0 if short in COMPONENT_SIZES else -math.inf
            quantity = Quantity(short, "m" if short in COMPONENT_SIZES else "", low, math.inf, short)
        add(name, number, quantity)
    given = scene.model.parameters
    add("zero_point", given.get("zero_point", 0.0), ZERO_POINT)
    for effect in effects:
        for quantity in effect.quantities:
            name = effect.full_name(quantity.name)
            if effect.by is not None:
                centre = quantity.off or 0.0
                prior = Prior(
                    "normal", quantity.low, quantity.high, centre, effect.width or quantity.sigma or 1.0
                )
                free += [
                    Free(f"{name}[{one}]", prior, centre, quantity.unit, quantity.meaning)
                    for one in row_index[effect.by][1]
                ]
                continue
            number = given.get(name, given.get(f"{effect.name}.{quantity.name}"))
            if effect.brdf is not None and isinstance(number, SceneFree) and number.per is not None:
                place, expected = f"{name}.per", "one value for the whole recording: the effect is a part"
                raise InputError(scene.source, f"model.parameters.{place}", f'"{number.per}"', expected)
            add(name, number, quantity)
    simplex = [
        (f"{material}.{a}", f"{material}.{b}")
        for material in scene.materials
        for a, b in zip(models[material].simplex, models[material].simplex[1:], strict=False)
    ]
    simplex += [
        (effect.full_name("r_spec"), effect.full_name("r_diff"))
        for effect in effects
        if {"r_spec", "r_diff"} <= {quantity.name for quantity in effect.quantities}
    ]
    return ParameterSet(free, fixed, simplex)


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
