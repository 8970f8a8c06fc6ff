"""What a model leaves out."""

from __future__ import annotations

from typing import Annotated

import typer

from torchlc.cli import completion
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
)
from torchlc.cli.printing import command_line, use_threads, warn
from torchlc.terminal import INTERRUPTED, printable, progress_bar, show_json


@app.command(
    epilog="Example: torchlc diagnose scene.toml recording.ecsv -o out --effects panel_offset,earthshine"
)
def diagnose(
    context: typer.Context,
    scene: SceneFile,
    recording: RecordingFile,
    out: Out,
    effects: Annotated[
        str | None,
        typer.Option(
            help="The only candidates, comma-separated; noise is always added.",
            show_default=False,
            autocompletion=completion.effects,
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A budget of 20 s.")] = False,
    budget: Budget = None,
    use: Use = None,
    columns: Columns = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Find physics that the model lacks: which, where in the recording, and what it does to the materials."""
    use_threads(threads)
    from torchlc import api
    from torchlc.effects import Entry
    from torchlc.files.writing import without_nan

    candidates = None if effects is None else Entry.split(effects)
    with progress_bar(not (quiet or json)) as progress:
        result = api.diagnose(
            scene, recording, out=out, quick=quick, effects=candidates, seed=seed, budget=budget, use=use, columns=columns, trust=trust,
            progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(without_nan(result.to_json()))
    elif not quiet:
        print("\n".join(map(printable, result.lines())))
        warn(result.warnings)
        print(f"written: {out / 'report.html'}, diagnosis.json and figures")
    if result.search.clock.stopped:
        raise typer.Exit(INTERRUPTED)
