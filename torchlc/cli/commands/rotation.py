"""How a body turns."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli.app import app
from torchlc.cli.options import (
    Budget,
    Columns,
    Json,
    OutIfWanted,
    Quiet,
    SceneFile,
    Seed,
    Threads,
    Trust,
    Use,
    number,
)
from torchlc.cli.printing import command_line, use_threads, warn
from torchlc.terminal import printable, progress_bar, show_json


@app.command(epilog="Example: torchlc rotation scene.toml night1.ecsv night2.ecsv -o out")
def rotation(
    context: typer.Context,
    scene: SceneFile,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="OBS...", help="Recordings (ECSV or CSV).", show_default=False)
    ],
    out: OutIfWanted = None,
    shortest: Annotated[
        float | None, number("Shortest turn, s; default: the scene's bound.", show_default=False)
    ] = None,
    longest: Annotated[
        float | None, number("Longest turn, s; default: the scene's bound.", show_default=False)
    ] = None,
    use: Use = None,
    columns: Columns = None,
    seed: Seed = 0,
    budget: Budget = None,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Find how a body turns: pole, period and phase, all that fits; rotation.json, scene.toml and figures."""
    use_threads(threads)
    from torchlc import api

    with progress_bar(not (quiet or json)) as progress:
        result = api.rotation(
            scene, *recordings, shortest=shortest, longest=longest, seed=seed, budget=budget, out=out, use=use, columns=columns,
            trust=trust, progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(result.to_json())
    elif not quiet:
        print("\n".join(map(printable, result.lines())))
        warn(result.warnings)
        if out is not None:
            print(f"written: {out / 'rotation.json'}, scene.toml and figures")
