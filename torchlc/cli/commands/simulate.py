"""The light curve of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli.app import app
from torchlc.cli.options import (
    Columns,
    Json,
    Out,
    Quiet,
    SceneFile,
    Seed,
    Threads,
    Trust,
    moment,
    number,
)
from torchlc.cli.printing import use_threads, warn
from torchlc.terminal import printable, show_json


@app.command(
    epilog="Example: torchlc simulate scene.toml --start 2020-10-17T10:00 --hours 10 --cadence 60 -o out"
)
def simulate(
    scene: SceneFile,
    out: Out,
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="[OBS]", help="Recording at whose rows to simulate.", show_default=False),
    ] = None,
    start: Annotated[str | None, typer.Option(help="First time, ISO UTC or JD.", show_default=False)] = None,
    hours: Annotated[float | None, number("Length, h.", show_default=False)] = None,
    cadence: Annotated[float | None, number("Time between rows, s.", show_default=False)] = None,
    noise: Annotated[
        float | None, number("Standard error, mag: makes a recording of it.", show_default=False)
    ] = None,
    columns: Columns = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Write curve.ecsv: the light curve of a scene at a recording's rows or on a grid of times."""
    use_threads(threads)
    from torchlc import api
    from torchlc.files.writing import OutputDirectory

    read = api.load(scene, trust=trust)
    inputs = [*api.input_files(read), *([] if recording is None else [recording])]
    with OutputDirectory(out, ["curve.ecsv"], inputs) as directory:
        curve = api.simulate(
            read,
            recording,
            start=None if start is None else moment(start),
            hours=hours,
            cadence=cadence,
            noise=noise,
            seed=seed,
            columns=columns,
        )
        directory.write("curve.ecsv", curve.write)
    if json:
        show_json(curve.to_json() | {"file": str(out / "curve.ecsv")})
    elif not quiet:
        print(printable(curve.headline()))
        print(f"written: {out / 'curve.ecsv'}")
        warn(curve.warnings)
