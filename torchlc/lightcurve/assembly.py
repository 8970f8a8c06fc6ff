"""From a scene and a recording to everything a light curve needs: track, attitude, shape, effects and the
parameter set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.effects import with_title
from torchlc.errors import InputError
from torchlc.geometry.orbit import Track, make_track
from torchlc.geometry.rotation.attitude import Attitude
from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.chosen import effects_of, held_already, prepared
from torchlc.lightcurve.given import check_given, unused
from torchlc.lightcurve.lobes import RESOLVED_N, edges_within_lobes, finest_lobes, uneven
from torchlc.lightcurve.numbers import Numbers
from torchlc.readers import Recording
from torchlc.scene import Free as SceneFree
from torchlc.scene import Scene
from torchlc.shapes import Facets, Shape
from torchlc.stages.effect import Context, Effect
from torchlc.tensors.moving import on_cpu

DEFAULT_SUN_MAGNITUDE = -26.7
"""mag in V at 1 au, as the paper has it (Willmer 2018: -26.76); told where it is taken."""


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
    models = {name: _law(MODELS[material.model], name, base) for name, material in scene.materials.items()}
    track, attitude, shape, context = (
        _read(scene, recording, models)
        if base is None
        else (base.track, base.attitude, base.shape, base.context)
    )
    context = replace(context, finer=finer)
    check_given(scene, context)
    wanted = scene.model.effects if effects is None else list(effects)
    held = {} if effects is not None else held_already(wanted or [], context)
    listed = None if wanted is None else [entry for entry in wanted if entry not in held]
    chosen, context = prepared(effects_of(listed, scene, context), scene, context, pinned or {})
    if base is not None:
        _share_learnt(chosen, base)
    models |= {effect.material_key: effect.brdf for effect in chosen if effect.brdf is not None}
    for effect in chosen:
        models |= {name: effect.law(law) for name, law in models.items() if name == effect.target}
    row_index = _row_index(context, recording)
    sun, warnings = _sun_magnitude(scene, recording)
    numbers = Numbers.of(scene, chosen, models, row_index, pinned or {})
    warnings += numbers.warnings
    if effects is None:
        warnings += unused(scene, chosen) + [
            f"{with_title(entry)} is left out: {why}" for entry, why in held.items()
        ]
    warnings += edges_within_lobes(shape.parts, models, context.lobes)
    instants = next((given for effect in chosen if (given := effect.instants(context)) is not None), None)
    notes = (*scene.warnings, *recording.warnings, *track.warnings, *shape.warnings, *warnings)
    return Assembly(
        scene,
        recording,
        track,
        attitude,
        shape,
        chosen,
        numbers.parameters(chosen),
        models,
        context,
        torch.as_tensor(sun, dtype=torch.float64),
        row_index,
        numbers.divided,
        numbers.origins,
        tuple(dict.fromkeys(notes)),
        context if instants is None else context.at_rows(instants.row),
        instants,
        pinned or {},
    )


def _read(
    scene: Scene, recording: Recording, models: Mapping[str, type[Brdf]]
) -> tuple[Track, Attitude, Shape, Context]:
    """What no list of effects changes."""
    with scene.reading():
        track = make_track(scene, recording)
        attitude = Attitude(scene, recording)
        lobes = finest_lobes(scene, RESOLVED_N)
        shape = Shape(scene, {name: lobes[name] for name in scene.materials if uneven(scene, name)})
    return track, attitude, shape, _context(scene, recording, track, attitude, shape, models, lobes)


def _row_index(context: Context, recording: Recording) -> dict[str, tuple[Tensor, Sequence[str]]]:
    """Codes of the rows (T,), and their names, by what a number may differ with."""
    index: dict[str, tuple[Tensor, Sequence[str]]] = {
        "curve": (context.curve, recording.curve_ids),
        "station": (context.station, recording.station_ids),
        "night": (context.night, recording.night_ids),
    }
    if context.object is not None:
        index["object"] = (context.object, recording.object_ids)
    return index


def _share_learnt(chosen: Sequence[Effect], base: Assembly) -> None:
    """What effects of the ``base`` have learnt, those of the same entry have too."""
    for effect in chosen:
        for learned in base.effects:
            if type(effect) is type(learned) and effect.entry == learned.entry and learned.learns:
                effect.share(learned)


def _law(law: type[Brdf], material: str, base: Assembly | None) -> type[Brdf]:
    """The law of a material; that of ``base`` if it is the same, with what it has learnt."""
    known = None if base is None else base.context.models.get(material)
    return law.of_material() if known is None or known.__class__ is not law else known


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
        lobe_bounds=finest_lobes(scene),
        materials=list(scene.materials),
        models=dict(models),
        mode=scene.attitude.mode,
        light_time_corrected=recording.light_time_corrected,
        kind=recording.kind,
        errors=recording.error is not None,
        limits=int(np.bincount(recording.curve[recording.upper_limit], minlength=1).max()),
    )


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
