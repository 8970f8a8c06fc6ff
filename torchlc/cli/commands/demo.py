"""The main job on the embedded example."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli.app import app
from torchlc.cli.options import (
    Json,
    Quiet,
    Seed,
    Threads,
    directory,
)
from torchlc.cli.printing import command_line, show_fit, use_threads
from torchlc.terminal import printable, progress_bar


@app.command(epilog="Example: torchlc demo, then open torchlc-demo/report.html")
def demo(
    context: typer.Context,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Directory for the results.", parser=directory)
    ] = Path("torchlc-demo"),
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Do the whole main job on the embedded example, in under a minute."""
    use_threads(threads)
    from torchlc import api

    with progress_bar(not (quiet or json)) as progress:
        diagnosis, result = api.demo(out, seed=seed, progress=progress, command=command_line(context))
    if not (quiet or json):
        from torchlc.diagnosis.words import headline

        print(printable(headline(diagnosis.content)))
    show_fit(result, out, quiet=quiet, json=json)
