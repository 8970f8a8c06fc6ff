"""Many objects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli.app import app
from torchlc.cli.options import (
    Json,
    Out,
    Quiet,
    Seed,
    whole_number,
)
from torchlc.cli.printing import command_line, use_threads, warn
from torchlc.terminal import printable, progress_bar, show_json


@app.command(
    epilog="Example: torchlc campaign catalogue.csv -o results --workers 8, then open results/index.html"
)
def campaign(
    context: typer.Context,
    manifest: Annotated[
        Path,
        typer.Argument(
            metavar="MANIFEST",
            help="CSV, one object a row: scene, recording, task (fit or diagnose); if wanted id and options, "
            "such as --steps 500 or --quick.",
            show_default=False,
        ),
    ],
    out: Out,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="A running Dask scheduler, tcp://HOST:PORT.", show_default=False
        ),
    ] = None,
    workers: Annotated[
        int | None,
        whole_number("Processes started here; default: one a core.", 1, 1024, show_default=False),
    ] = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Annotated[int, whole_number("Threads of each worker.", 1, 1024)] = 1,
    json: Json = False,
) -> None:
    """Fit or diagnose many objects on Dask. Repeated, it does what is not done yet."""
    use_threads(threads)
    from torchlc.campaigns.run import campaign as run

    with progress_bar(not (quiet or json)) as progress:
        result = run(
            manifest, out=out, scheduler=scheduler, workers=workers, threads=threads, seed=seed,
            progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(result.to_json())
    elif not quiet:
        print(printable(result.headline()))
        warn(f"{name}: {reason}" for name, reason in result.failures)
        if result.failed > len(result.failures):
            warn([f"and {result.failed - len(result.failures)} more that failed"])
        print(f"written: {out / 'index.html'}, summary.parquet and summary.csv")
