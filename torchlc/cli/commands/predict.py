"""How bright, and when."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli import completion
from torchlc.cli.app import app
from torchlc.cli.options import (
    Json,
    OutIfWanted,
    Quiet,
    Seed,
    Threads,
    Trust,
    moment,
    number,
    whole_number,
)
from torchlc.cli.printing import command_line, use_threads, warn
from torchlc.terminal import printable, progress_bar, show_json


@app.command(
    epilog="Example: torchlc predict elements.txt --preset starlink-v2-mini --station home,52.1,5.2,10 "
    "--date 2026-11-28 -o tonight"
)
def predict(
    context: typer.Context,
    model: Annotated[
        Path,
        typer.Argument(
            metavar="SCENE|FIT|ELEMENTS",
            help="A scene (TOML), the directory of a fit, or two-line elements of many objects, with --preset or --like.",
            show_default=False,
        ),
    ],
    out: OutIfWanted = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="Take the objects for one of these.", autocompletion=completion.shapes, show_default=False
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENE|FIT", help="Take the objects for that of a scene or fit.", show_default=False
        ),
    ] = None,
    station: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID[,LAT,LON,HEIGHT]",
            help="Observer, deg and m, or one of the scene's; repeatable.",
            show_default=False,
        ),
    ] = None,
    date: Annotated[
        str | None,
        typer.Option(metavar="NIGHT", help="Date of the evening at the station.", show_default=False),
    ] = None,
    start: Annotated[str | None, typer.Option(help="First time, ISO UTC or JD.", show_default=False)] = None,
    hours: Annotated[float | None, number("Length, h.", show_default=False)] = None,
    cadence: Annotated[float, number("Time between rows, s.")] = 10.0,
    elevation: Annotated[float, number("Least elevation, deg.")] = 10.0,
    sun: Annotated[float, number("The Sun is below this elevation, deg; 90 for any.")] = -6.0,
    extinction: Annotated[float, number("Extinction, mag an airmass, for apparent magnitudes.")] = 0.0,
    scatter: Annotated[
        float | None,
        number(
            "Standard deviation between objects of one kind, mag; default: the preset's, else 0.",
            show_default=False,
        ),
    ] = None,
    faintest: Annotated[
        float | None, number("Leave out passes fainter than this, mag.", show_default=False)
    ] = None,
    draws: Annotated[int, whole_number("Draws of the posterior or the priors.", 2, 100_000)] = 256,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Say how bright and when: passes over a station, magnitudes with intervals, shadow, glints; table, calendar, figure."""
    use_threads(threads)
    from torchlc import api
    from torchlc.cli import scaffold

    asked = scaffold.prediction_of(model, preset, like, station or [], trust)
    with progress_bar(not (quiet or json)) as progress:
        result = api.predict(
            asked.scene, elements=asked.elements, stations=asked.stations, date=date,
            start=None if start is None else moment(start), hours=hours, cadence=cadence, elevation=elevation,
            sun=sun, extinction=extinction, scatter=asked.scatter if scatter is None else scatter,
            faintest=faintest, draws=draws, seed=seed, out=out, trust=trust, progress=progress,
            command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(result.to_json())
    elif not quiet:
        print(printable(result.headline()))
        print("\n".join(map(printable, result.lines())))
        warn(result.warnings)
        if out is not None:
            figure = ", passes.png" if (out / "passes.png").exists() else ""
            print(f"written: {out / 'prediction.ecsv'}, passes.ecsv, passes.ics{figure} and prediction.json")
