"""From a scene and a recording to everything a light curve needs: track, attitude, shape, effects and the
parameter set."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from torchlc.attitude import Attitude
from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.effects import GEOMETRY_STAGES, every, registry
from torchlc.effects.base import Columns, Context, Effect, Entry, Instants
from torchlc.errors import InputError
from torchlc.orbit import Track, make_track
from torchlc.parameters import Free, ParameterSet, Prior, Quantity, prior_of
from torchlc.recording import Recording
from torchlc.scene import Free as SceneFree
from torchlc.scene import Number, Scene
from torchlc.scene.parts import AXES_OF_A_MESH, Mesh
from torchlc.shape import Facets, Part, Shape
from torchlc.spelling import did_you_mean

DEFAULT_SUN_MAGNITUDE = -26.7
RESOLVED_N = 1e4
"""Lobes are expected to be as sharp as this, or as a smaller upper bound of the exponent."""

ZERO_POINT = Quantity("zero_point", "mag", -math.inf, math.inf, "added to every magnitude", off=0.0)
POLE_LATITUDE = Quantity("attitude.pole_lat", "deg", -90.0, 90.0, "latitude of the pole", prior="isotropic")
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
    optics: Context
    instants: Instants | None = None
    pinned: Mapping[str, float] = field(default_factory=dict)
    dtype: torch.dtype = torch.float64
    device: str = "cpu"

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
            effect.name for effect in self.effects if effect.stage == "surface" and effect.quantities
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
    def patches(self) -> list[list[tuple[str, str | None, Tensor]]]:
        """For each part, the materials on it, each of its surfaces that is one whole by its label (else None), and the
        facets (indices) of each."""
        found = []
        for part in self.shape.parts:
            labels = [face if face in part.whole else None for face in part.faces]
            groups: dict[tuple[str, str | None], list[int]] = {}
            for index, key in enumerate(zip(part.materials, labels, strict=True)):
                groups.setdefault(key, []).append(index)
            found.append(
                [(*key, torch.as_tensor(index, device=self.device)) for key, index in groups.items()]
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
        whole = name.partition("[")[0]
        owner, _, short = whole.rpartition(".")
        if owner == "attitude":
            return "spin"
        if owner in self._sized and short in COMPONENT_SIZES:
            return "size"
        for effect in self.effects:
            if whole.partition(".")[0] != effect.name or effect.linear or effect.stage not in GEOMETRY_STAGES:
                continue
            if effect.brdf is None or not _is_material(effect.brdf, short):
                return effect.stage
        return None

    @cached_property
    def _sized(self) -> set[str]:
        return {component.name for component in self.scene.components}

    @property
    def geometry_free(self) -> bool:
        """True if a free parameter moves the geometry."""
        return bool(self.geometry_columns)

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
        for index, ids in self.row_index.values():
            keys = [f"{name}[{one}]" for one in ids]
            if keys and all(key in values for key in keys):
                index = index if row is None else index[row]
                return torch.stack(torch.broadcast_tensors(*[values[key] for key in keys]), -1)[..., index]
        raise KeyError(name)

    def attitude_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the attitude's numbers by full name as `rows` gives them for every instant."""
        numbers = {name: self.rows(values, name, self.instant_row) for name in self.attitude.numbers}
        return {**values, **numbers}

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
    finer: Tensor | None = None,
) -> Assembly:
    """Bring scene and recording together under a list of effects (default: the scene's own).

    An entry of ``effects`` is a name, or ``name[target]`` for one material or component alone. ``base`` lends
    its track, attitude and shape; ``pinned`` fixes parameters at given values whatever the scene says of
    them. ``finer`` (T,) marks rows whose exposures are divided twice as finely as they need.
    """
    if base is None:
        track = make_track(scene, recording)
        attitude = Attitude(scene, recording)
        lobes = _finest_lobes(scene, RESOLVED_N)
        shape = Shape(scene, {name: lobes[name] for name in scene.materials if _uneven(scene, name)})
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
    context = replace(context, finer=finer)
    chosen, context = _prepared(_effects(wanted, scene, context), scene, context, pinned or {})
    models |= {effect.name: effect.brdf for effect in chosen if effect.brdf is not None}
    sun, warnings = _sun_magnitude(scene, recording)
    parameters = _parameters(scene, chosen, models, row_index, pinned or {}, warnings)
    divided = [one for effect in chosen if (one := effect.instants(context)) is not None]
    instants = divided[0] if divided else None
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
        context if instants is None else context.at_rows(instants.row),
        instants,
        pinned or {},
    )


def exposures(context: Context) -> Tensor:
    """The longest time that each exposure may take, (T,), s: as recorded, else the cadence."""
    return torch.full_like(context.seconds, context.cadence) if context.exptime is None else context.exptime


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
        lobe_bounds=_finest_lobes(scene),
        materials=list(scene.materials),
        models=dict(models),
        mode=scene.attitude.mode,
        light_time_corrected=recording.light_time_corrected,
        kind=recording.kind,
        errors=recording.error is not None,
        limits=int(np.bincount(recording.curve[recording.upper_limit], minlength=1).max()),
    )


def _effects(wanted: Sequence[str] | None, scene: Scene, context: Context) -> tuple[Effect, ...]:
    known = registry()
    if wanted is None:
        standard = [effect for cls in known.values() if (effect := cls()).standard(context)]
        return tuple(effect for effect in standard if effect.missing(context) is None)
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
            _check_axes(effect, scene, context)
            effect.by, effect.width = parsed.per, parsed.width
            found.append(effect)
    for effect in found:
        reason = effect.beside([other.name for other in found])
        if reason is not None:
            raise InputError(scene.source, "model.effects", f"{effect.name} cannot be applied: {reason}")
    order = list(every())
    return tuple(sorted(found, key=lambda effect: order.index(effect.name)))


def _prepared(
    effects: Sequence[Effect], scene: Scene, context: Context, pinned: Mapping[str, float]
) -> tuple[tuple[Effect, ...], Context]:
    """The effects made ready for these data, and the context that knows of them and of their numbers' bounds."""
    given = scene.model.parameters
    bounds: dict[str, tuple[float, float]] = {}

    def bound(name: str, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            bounds[name] = (pinned[name], pinned[name])
        elif isinstance(number, SceneFree):
            prior = _prior(number, quantity)
            bounds[name] = (_end(prior, -1.0), _end(prior, 1.0))
        elif number is not None:
            bounds[name] = (float(number), float(number))
        elif quantity.unless_set is not None:
            bounds[name] = (quantity.unless_set, quantity.unless_set)
        else:
            bounds[name] = (quantity.low, quantity.high)

    for name, number in scene.numbers().items():
        if name.startswith("attitude."):
            bound(name, number, Quantity(name, "", -math.inf, math.inf, ""))
    for effect in effects:
        for quantity in effect.quantities:
            name = effect.full_name(quantity.name)
            number = None if effect.by else given.get(name, given.get(f"{effect.name}.{quantity.name}"))
            bound(name, number, quantity)
    context = replace(context, bounds=bounds, effects=effects)
    # how finely exposures are divided depends on what the others do
    others = [effect if effect.spans_exposure else effect.prepared(context) for effect in effects]
    context = replace(context, effects=others)
    ready = tuple(effect.prepared(context) if effect.spans_exposure else effect for effect in others)
    return ready, replace(context, effects=ready)


def _end(prior: Prior, side: float) -> float:
    """The lower (side -1) or upper (1) end of a prior, five standard deviations away where it has none."""
    end = prior.low if side < 0 else prior.high
    return end if math.isfinite(end) else prior.centre + side * 5 * prior.sigma


def _check_axes(effect: Effect, scene: Scene, context: Context) -> None:
    """InputError where an effect on a material gives it numbers along u and v, and a mesh of it has no such axes."""
    numbers = {quantity.name for quantity in effect.quantities}
    for component in scene.components if effect.stage == "material" else ():
        if not isinstance(component, Mesh) or component.has_axes:
            continue
        apart = context.models[component.material].along_axes
        if effect.target in (None, component.material) and len(numbers.intersection(apart)) > 1:
            found = f"{effect.name} has {' and '.join(apart)} apart, and the mesh says nothing of the direction of u"
            raise InputError(scene.source, f"component {component.name!r}", found, AXES_OF_A_MESH)


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
    warnings: list[str],
) -> ParameterSet:
    free: list[Free] = []
    fixed: dict[str, float] = {}

    def add(name: str, number: Number | None, quantity: Quantity) -> None:
        if name in pinned:
            fixed[name] = pinned[name]
        elif number is None and quantity.unless_set is not None:
            fixed[name] = quantity.unless_set
        elif number is None:
            prior = prior_of(quantity)
            start = quantity.mean if quantity.mean is not None else quantity.typical
            free.append(Free(name, prior, 0.0 if start is None else start, quantity.unit, quantity.meaning))
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
        elif name == POLE_LATITUDE.name:
            quantity = POLE_LATITUDE
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
