"""Many objects."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from torchlc.cli import completion
from torchlc.cli.app import app
from torchlc.cli.options import (
    Budget,
    Columns,
    Json,
    Out,
    Quiet,
    Seed,
    Threads,
    whole_number,
)
from torchlc.cli.printing import command_line, use_threads, warn
from torchlc.digits import number_of
from torchlc.terminal import printable, progress_bar, say, show_json


class ManifestFirst(TyperGroup):
    """A group whose first argument may be a manifest: what is none of its commands is handed to ``run``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        named = bool(args) and (args[0] in self.commands or args[0] in ("-h", "--help"))
        return super().parse_args(ctx, args if named else ["run", *args])


campaigns = typer.Typer(
    cls=ManifestFirst,
    help="Fit or diagnose many objects on Dask; with [bold]init[/bold], write the manifest and a scene for each.",
    epilog="Example: torchlc campaign init elements.txt nights/, then torchlc campaign nights/manifest.csv -o results",
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
app.add_typer(campaigns, name="campaign", rich_help_panel=None)


@campaigns.command(
    "run",
    epilog="Example: torchlc campaign catalogue.csv -o results --workers 8, then open results/index.html",
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
            metavar="ADDRESS",
            help="A running Dask scheduler, tls://HOST:PORT or tcp://HOST:PORT.",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        whole_number("Processes started here; default: one a core.", 1, 1024, show_default=False),
    ] = None,
    budget: Budget = None,
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
            manifest, out=out, scheduler=scheduler, workers=workers, threads=threads, seed=seed, budget=budget,
            progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(result.to_json())
    elif not quiet:
        print(printable(result.headline()))
        if scheduler is not None and not scheduler.startswith("tls://"):
            warn(
                [
                    f"--scheduler {scheduler}: not encrypted. Whoever can reach its port can run code as you; the page on "
                    "campaigns on several machines says how to close it"
                ]
            )
        warn(f"{name}: {reason}" for name, reason in result.failures)
        if result.failed > len(result.failures):
            warn([f"and {result.failed - len(result.failures)} more that failed"])
        print(f"written: {out / 'index.html'}, summary.parquet and summary.csv")


@campaigns.command(
    "init", epilog="Example: torchlc campaign init elements.txt nights/ --station weihai,37.5,122.1,110"
)
def init_campaign(
    elements: Annotated[
        Path, typer.Argument(metavar="ELEMENTS", help="Two-line elements of the objects.", show_default=False)
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Recordings, one object a file.", show_default=False)
    ],
    shape: Annotated[
        str,
        typer.Option(
            "--shape",
            "--preset",
            metavar="NAME",
            help="Shape of every scene, as of torchlc init.",
            autocompletion=completion.shapes,
        ),
    ] = "box-wing",
    station: Annotated[
        str | None, typer.Option(metavar="ID,LAT,LON,HEIGHT", help="Observer, deg and m.", show_default=False)
    ] = None,
    task: Annotated[str, typer.Option(help="fit or diagnose.")] = "diagnose",
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Sizes, attitude and errors as if known exactly: no priors on them."),
    ] = False,
    columns: Columns = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace scenes and a manifest that are there.")
    ] = False,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Write FOLDER/manifest.csv and a scene beside each recording, matched to its object by number or name."""
    from torchlc.cli.campaign_files import write_campaign
    from torchlc.cli.scaffold import read_station

    place = None if station is None else read_station(station)
    done = write_campaign(
        elements, folder, shape=shape, station=place, task=task, exact=exact, columns=columns, force=force
    )
    if json:
        show_json(
            {
                "manifest": str(done.manifest),
                "objects": {path.name: label for path, label in done.matched.items()},
                "left_out": {path.name: reason for path, reason in done.left_out.items()},
                "passed_over": list(done.passed_over),
            }
        )
    elif not quiet:
        for path, label in done.matched.items():
            print(printable(f"{path.name}: {label}"))
        warn(f"{path.name}: left out: {reason}" for path, reason in done.left_out.items())
        warn(done.passed_over)
        if place is None:
            say("warning: the station of every scene is a placeholder: edit [[stations]], or give --station")
        print(f"written: {done.manifest} and {number_of(len(done.matched), 'scene')}")
        print(f"next: torchlc campaign {shlex.quote(str(done.manifest))} -o results")
