"""What an object is made of."""

from __future__ import annotations

from typing import Annotated

import typer

from torchlc.cli.app import app
from torchlc.cli.options import (
    Budget,
    Columns,
    Json,
    Out,
    Quiet,
    RecordingFile,
    SceneFile,
    Seed,
    Threads,
    Trust,
    Use,
    whole_number,
)
from torchlc.cli.printing import command_line, show_fit, use_threads
from torchlc.terminal import progress_bar


@app.command(epilog="Example: torchlc fit scene.toml recording.ecsv -o out, then open out/report.html")
def fit(
    context: typer.Context,
    scene: SceneFile,
    recording: RecordingFile,
    out: Out,
    steps: Annotated[
        int | None,
        whole_number("Length of the chain; default: until long enough.", 1, show_default=False),
    ] = None,
    walkers: Annotated[
        int | None,
        whole_number("Walkers of the ensemble; default 6 a parameter.", 2, show_default=False),
    ] = None,
    budget: Budget = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the chain found in DIR.")] = False,
    use: Use = None,
    columns: Columns = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Find what the object is made of: Adam, then emcee; fit.json, posterior.nc, chain.h5, report.html."""
    use_threads(threads)
    from torchlc import api

    with progress_bar(not (quiet or json)) as progress:
        result = api.fit(
            scene, recording, out=out, steps=steps, walkers=walkers, budget=budget, resume=resume, use=use, columns=columns, seed=seed,
            trust=trust, progress=progress, command=command_line(context),
        )  # fmt: skip
    show_fit(result, out, quiet=quiet, json=json)
