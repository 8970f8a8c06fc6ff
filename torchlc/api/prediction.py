"""The verb predict."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from torchlc.api.inputs import Moment, Progress, amount, moment, read_scene
from torchlc.api.outputs import held, input_files, made_with
from torchlc.files.reading import sha256_of
from torchlc.results.fit_result import FitResult
from torchlc.results.stored_fit import StoredFit
from torchlc.scene import Scene, Station, station_of
from torchlc.tensors.moving import on_cpu

if TYPE_CHECKING:
    from torchlc.prediction.result import Prediction


@on_cpu
def predict(
    scene: str | Path | Scene | FitResult | StoredFit,
    *,
    elements: str | Path | None = None,
    stations: str | Sequence[str | Station] | None = None,
    date: str | None = None,
    start: Moment | None = None,
    hours: float | None = None,
    cadence: float = 10.0,
    elevation: float = 10.0,
    sun: float = -6.0,
    extinction: float = 0.0,
    scatter: float = 0.0,
    faintest: float | None = None,
    draws: int = 256,
    seed: int = 0,
    out: str | Path | None = None,
    trust: bool = False,
    progress: Progress | None = None,
    command: str | None = None,
) -> Prediction:
    """How bright, and when: passes over stations in the dark, with magnitudes and their 68 and 95 % intervals.

    ``scene`` is a scene, whose priors are drawn from, or a fit, as made, as stored or as its directory, whose posterior is. ``elements``, a file
    of two-line elements of any number of objects, takes the place of the scene's orbit: every object is taken for one of
    the scene's shape and materials. ``stations``, as "id,latitude,longitude,height" (deg, m), take the place of the scene's. ``date`` is a night by its evening's date;
    or ``hours`` from ``start`` (ISO UTC or JD). Passes are above ``elevation`` deg while the Sun is below ``sun``, deg, on a
    grid of ``cadence`` s.

    ``extinction`` (mag an airmass) gives apparent magnitudes beside those outside the air. ``scatter`` (mag) is the
    standard deviation between objects of one kind, which the intervals hold. Passes fainter than ``faintest`` are left
    out. With ``out`` prediction.json, prediction.ecsv, passes.ecsv, passes.ics and passes.png are written there.
    """
    from torchlc.prediction import run as predicting
    from torchlc.prediction.passes import no_station
    from torchlc.prediction.posterior import read_fit
    from torchlc.prediction.result import PREDICTION_FILES

    wanted = predicting.Wanted(elevation, sun, extinction, scatter, faintest, draws, seed)
    predicting.check(wanted)
    read, posterior, inputs = read_fit(scene, lambda given: read_scene(given, trust))
    places = list(read.stations) if stations is None else _stations(stations)
    if not places:
        raise no_station(read.source)
    inputs += input_files(read) + ([] if elements is None else [Path(elements)])
    with ExitStack() as stack:
        directory = held(stack, out, PREDICTION_FILES, inputs)
        lasting, step = amount(hours, "h", "hours"), amount(cadence, "s", "cadence")
        span = predicting.span_of(places, None if date is None else str(date), moment(start), lasting, step)
        if elements is None:
            orbiters, said = [predicting.orbiter_of(read, span)], []
        else:
            orbiters, said = predicting.orbiters_of(elements, span)
        prediction = predicting.run(read, orbiters, span, wanted, posterior, progress)
        digests = {file.name: sha256_of(file) for file in inputs if file.is_file()}
        made = made_with(digests, seed, command)
        prediction = replace(prediction, warnings=[*said, *prediction.warnings], provenance=made)
        if directory is not None:
            prediction.write_into(directory)
    return prediction


def _stations(given: str | Sequence[str | Station]) -> list[Station]:
    several = [given] if isinstance(given, str) else given
    return [place if isinstance(place, Station) else station_of(place) for place in several]
