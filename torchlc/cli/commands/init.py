"""A scene to start from."""

from __future__ import annotations

import shlex
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
    moment,
)
from torchlc.cli.printing import warn
from torchlc.terminal import printable, say, show_json


@app.command(
    epilog="Example: torchlc init my.toml --tle elements.txt --shape cubesat --station weihai,37.5,122.1,110"
)
def init(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file to write.", show_default=False)],
    tle: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Two-line elements, with names or without.", show_default=False),
    ],
    shape: Annotated[
        str,
        typer.Option(
            "--shape",
            "--preset",
            metavar="NAME",
            help="What it is: box-wing, oneweb, iridium-next, starlink-v2-mini, cubesat-6u, rocket-body-sl-16, iss, mesh ...; "
            "a wrong name lists them all.",
            autocompletion=completion.shapes,
        ),
    ] = "box-wing",
    object_: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="NAME|NUMBER",
            help="Which object of the file: its number, its name or a part of its name.",
            show_default=False,
        ),
    ] = None,
    station: Annotated[
        str | None, typer.Option(metavar="ID,LAT,LON,HEIGHT", help="Observer, deg and m.", show_default=False)
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the object.", show_default=False)] = None,
    date: Annotated[
        str | None,
        typer.Option(help="Take the elements nearest to this; default: the latest.", show_default=False),
    ] = None,
    mesh: Annotated[
        str | None, typer.Option(metavar="FILE", help="Mesh in the folder of the scene.", show_default=False)
    ] = None,
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Sizes, attitude and errors as if known exactly: no priors on them."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Write a commented scene to start from: elements, a preset shape, free materials, and priors on what nobody knows exactly."""
    from torchlc.cli import scaffold
    from torchlc.errors import InputError
    from torchlc.files.writing import check_replaceable, write_whole

    mesh = None if mesh is None else scaffold.beside(scene.parent, mesh)
    check_replaceable(scene, [tle, *([] if mesh is None else [scene.parent / mesh])])
    if scene.exists() and not force:
        raise InputError(scene, None, "exists", "a new file", "--force replaces it.")
    if not scene.parent.is_dir():
        raise InputError(scene, None, f"no directory {scene.parent}", "a directory that is there")
    wanted = None if date is None else moment(date)
    chosen, passed_over = scaffold.elements_for(tle, wanted, object_)
    warn(passed_over)
    place = None if station is None else scaffold.read_station(station)
    text = scaffold.new_scene(chosen, shape, name=name, station=place, mesh=mesh, exact=exact)
    read = scaffold.check_scene(text, scene.parent, scene)
    write_whole(scene, lambda partial: partial.write_text(text, encoding="utf-8"))
    if json:
        show_json({"scene": str(scene), "name": read.name, "tle": list(chosen.lines)})
    elif not quiet:
        print(
            f"written: {scene}, of {printable(chosen.label)}, elements of {scaffold.to_the_minute(chosen.epoch)[:10]}"
        )
        if wanted is not None:
            warn(scaffold.old_elements(chosen, wanted))
        if place is None:
            say("warning: the station is a placeholder: edit [[stations]] before use")
        start = scaffold.to_the_minute(chosen.epoch if wanted is None else wanted)
        file = shlex.quote(str(scene))
        if place is None:
            print(f"next: torchlc simulate {file} --start {start} --hours 24 --cadence 60 -o out")
        else:
            print(f"next: torchlc predict {file} --start {start} --hours 24 -o out")
