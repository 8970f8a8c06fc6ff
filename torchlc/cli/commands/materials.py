"""Known materials, and fits of laboratory tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchlc.cli import completion
from torchlc.cli.app import app
from torchlc.cli.options import (
    Json,
    Quiet,
    Seed,
    Threads,
    number,
)
from torchlc.cli.printing import use_threads
from torchlc.terminal import show_json

materials = typer.Typer(
    help="Known materials, what a posterior matches, and fits to laboratory tables.",
    pretty_exceptions_enable=False,
)
app.add_typer(materials, name="materials", rich_help_panel=None)


@materials.callback(invoke_without_command=True)
def list_materials(
    context: typer.Context,
    posterior: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Results of a fit: what its materials match.", show_default=False),
    ] = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """List the known materials, or with --posterior what the materials of a fit match."""
    if context.invoked_subcommand is not None:
        return
    from torchlc.report import listing

    if posterior is not None:
        found = listing.matches_of(posterior)
        if json:
            show_json({"materials": found})
        elif not quiet:
            print("\n".join(listing.matches_lines(found)))
    elif json:
        show_json({"materials": listing.materials_listing()})
    elif not quiet:
        print("\n".join(listing.materials_lines()))


@materials.command("fit", epilog="Example: torchlc materials fit lab_brdf_array.csv --model ggx")
def fit_material(
    table: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="CSV with incidence, azimuth, exit, brdf.", show_default=False),
    ],
    model: Annotated[
        str, typer.Option(help="Reflection model.", autocompletion=completion.laws)
    ] = "ashikhmin-shirley",
    without_peak: Annotated[
        float, number("Leave out rows this near the mirror direction.", 0.0, metavar="DEG")
    ] = 0.0,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Fit a reflection model to a goniometer's table of the BRDF."""
    use_threads(threads)
    from torchlc.materials import goniometer
    from torchlc.report import listing

    measured = goniometer.read_table(table)
    if without_peak:
        measured = measured.without_peak(without_peak)
    found = goniometer.fit_table(measured, model, seed=seed)
    if json:
        show_json(listing.reflectance_told(found, measured.dropped))
    elif not quiet:
        print("\n".join(listing.reflectance_lines(found, measured.dropped)))
