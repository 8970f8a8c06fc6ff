"""The command line: each command is a verb of :mod:`torchlc.api`, whose import waits until it is needed."""

from __future__ import annotations

import math
import os
import re
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchlc.cli import completion
from torchlc.files.decimals import advice, decimal
from torchlc.terminal import exit_code, printable, progress_bar, say, show_json
from torchlc.version import __version__

if TYPE_CHECKING:
    from torchlc.results.fit_result import FitResult

app = typer.Typer(
    name="torchlc",
    help="What is a satellite made of, and what does its model leave out? Light curves fitted and diagnosed.",
    epilog="Start with: [bold]torchlc demo[/bold], or [bold]torchlc init my.toml --tle elements.txt[/bold].",
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def number(text: str, low: float = -math.inf, *, metavar: str = "FLOAT", show_default: bool = True) -> Any:
    """An option that takes a finite number from ``low`` on, written as in a file: no underscores, no digits
    of other scripts.
    """
    return typer.Option(
        help=text, metavar=metavar, show_default=show_default, parser=partial(typed, low, math.inf)
    )


def whole_number(text: str, low: int, high: int | None = None, *, show_default: bool = True) -> Any:
    """An option that takes a whole number from ``low`` to ``high``."""
    metavar = f"INTEGER [{low} or more]" if high is None else f"INTEGER [{low} to {high}]"
    parser = partial(typed, low, math.inf if high is None else high, whole=True)
    return typer.Option(help=text, metavar=metavar, show_default=show_default, parser=parser)


def typed(low: float, high: float, value: Any, *, whole: bool = False) -> Any:
    """The number that was typed; the parser of an option. A default is one already."""
    if not isinstance(value, str):
        return value
    kind = "whole number" if whole else "number"
    try:
        found = decimal(value)
        if whole:
            found = int(value) if math.isfinite(found) else math.nan
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise typer.BadParameter(f"{value[:40]!r}; expected a {kind}. {advice(value) or ''}".rstrip(". "))
    if not low <= found <= high:
        expected = f"{low:g} or more" if high == math.inf else f"{low:g} to {high:.0f}"
        raise typer.BadParameter(f"{value[:40]}; expected {expected}")
    return found


SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).", show_default=False)]
RecordingFile = Annotated[
    Path, typer.Argument(metavar="OBS", help="Recording (ECSV or CSV).", show_default=False)
]
Out = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Directory for the results.", show_default=False)
]
Seed = Annotated[int, whole_number("Seed of everything random.", 0, 2**32 - 1)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Threads = Annotated[int | None, whole_number("Threads of the computation.", 1, 1024, show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
Use = Annotated[
    str | None,
    typer.Option(
        help="mag or flux, of a recording that has both.", show_default=False, autocompletion=completion.kinds
    ),
]
Trust = Annotated[bool, typer.Option("--trust", help="Let the scene name files outside its own folder.")]


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    if version:
        print(f"torchlc {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit


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
        )
        directory.write("curve.ecsv", curve.write)
    if json:
        show_json(curve.to_json() | {"file": str(out / "curve.ecsv")})
    elif not quiet:
        print(printable(curve.headline()))
        print(f"written: {out / 'curve.ecsv'}")
        warn(curve.warnings)


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
    resume: Annotated[bool, typer.Option("--resume", help="Continue the chain found in DIR.")] = False,
    use: Use = None,
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
            scene, recording, out=out, steps=steps, walkers=walkers, resume=resume, use=use, seed=seed,
            trust=trust, progress=progress, command=command_line(context),
        )  # fmt: skip
    show_fit(result, out, quiet=quiet, json=json)


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
    quick: Annotated[bool, typer.Option("--quick", help="No sampler, few refits.")] = False,
    use: Use = None,
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
            scene, recording, out=out, quick=quick, effects=candidates, seed=seed, use=use, trust=trust,
            progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(without_nan(result.to_json()))
    elif not quiet:
        print("\n".join(map(printable, result.lines())))
        warn(result.warnings)
        print(f"written: {out / 'report.html'}, diagnosis.json and figures")


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


@app.command()
def effects(quiet: Quiet = False, seed: Seed = 0, threads: Threads = None, json: Json = False) -> None:
    """List the library of effects: name, parameters with units and bounds, and one sentence each."""
    from torchlc.report.listing import effects_lines, effects_listing

    if json:
        show_json({"effects": effects_listing()})
    elif not quiet:
        print("\n".join(effects_lines()))


@app.command(epilog="Example: torchlc period recording.ecsv --shortest 5 --longest 600")
def period(
    recording: RecordingFile,
    shortest: Annotated[
        float | None, number("Shortest period, s; default: two rows a turn.", show_default=False)
    ] = None,
    longest: Annotated[
        float | None,
        number("Longest period, s; default: half the longest run.", show_default=False),
    ] = None,
    use: Use = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Find an unknown spin: a periodogram's candidates with their aliases."""
    use_threads(threads)
    from torchlc.inference.period import find_period
    from torchlc.readers import load_recording

    found = find_period(load_recording(recording, use=use), shortest_s=shortest, longest_s=longest)
    if json:
        show_json(found.to_json())
    elif not quiet:
        print(found)


@app.command(epilog="Example: torchlc rotation scene.toml night1.ecsv night2.ecsv -o out")
def rotation(
    context: typer.Context,
    scene: SceneFile,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="OBS...", help="Recordings (ECSV or CSV).", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Directory for the results.", show_default=False),
    ] = None,
    shortest: Annotated[
        float | None, number("Shortest turn, s; default: the scene's bound.", show_default=False)
    ] = None,
    longest: Annotated[
        float | None, number("Longest turn, s; default: the scene's bound.", show_default=False)
    ] = None,
    use: Use = None,
    seed: Seed = 0,
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
            scene, *recordings, shortest=shortest, longest=longest, seed=seed, out=out, use=use, trust=trust,
            progress=progress, command=command_line(context),
        )  # fmt: skip
    if json:
        show_json(result.to_json())
    elif not quiet:
        print("\n".join(map(printable, result.lines())))
        warn(result.warnings)
        if out is not None:
            print(f"written: {out / 'rotation.json'}, scene.toml and figures")


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


@app.command(
    epilog="Example: torchlc init my.toml --tle elements.txt --shape cubesat --station weihai,37.5,122.1,110"
)
def init(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file to write.", show_default=False)],
    tle: Annotated[
        Path, typer.Option(metavar="FILE", help="Two-line elements of one object.", show_default=False)
    ],
    shape: Annotated[
        str,
        typer.Option(
            help="box-wing, cubesat, rocket body, cylinder or mesh.", autocompletion=completion.shapes
        ),
    ] = "box-wing",
    station: Annotated[
        str | None, typer.Option(metavar="ID,LAT,LON,HEIGHT", help="Observer, deg and m.", show_default=False)
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the object.", show_default=False)] = None,
    date: Annotated[
        str | None,
        typer.Option(help="Take the elements nearest to this; default: the latest.", show_default=False),
    ] = None,
    mesh: Annotated[
        str | None, typer.Option(metavar="FILE", help="Mesh beside the scene.", show_default=False)
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Write a commented scene to start from: elements, a preset shape, free materials."""
    from torchlc.cli import scaffold
    from torchlc.errors import InputError
    from torchlc.files.writing import check_replaceable, write_whole

    check_replaceable(scene, [tle, *([] if mesh is None else [scene.parent / mesh])])
    if scene.exists() and not force:
        raise InputError(scene, None, "exists", "a new file", "--force replaces it.")
    if not scene.parent.is_dir():
        raise InputError(scene, None, f"no directory {scene.parent}", "a directory that is there")
    wanted = None if date is None else moment(date)
    chosen = scaffold.elements_for(tle, wanted)
    place = None if station is None else scaffold.read_station(station)
    text = scaffold.new_scene(chosen, shape, name=name, station=place, mesh=mesh)
    read = scaffold.check_scene(text, scene.parent, scene)
    write_whole(scene, lambda partial: partial.write_text(text, encoding="utf-8"))
    if json:
        show_json({"scene": str(scene), "name": read.name, "tle": list(chosen.lines)})
    elif not quiet:
        print(f"written: {scene}")
        if place is None:
            say("warning: the station is a placeholder: edit [[stations]] before use")
        print(f"next: torchlc simulate {shlex.quote(str(scene))} --start ... --hours 8 --cadence 60 -o out")


@app.command(epilog="Example: torchlc demo, then open torchlc-demo/report.html")
def demo(
    context: typer.Context,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Directory for the results.")
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


def moment(text: str) -> str | float:
    """A time as typed: a Julian date, a date alone (from 0 h), or ISO text as it is."""
    try:
        return decimal(text)
    except ValueError:
        return f"{text}T00:00:00" if re.fullmatch(r"\d{4}-\d\d-\d\d", text, re.ASCII) else text


def use_threads(threads: int | None) -> None:
    """Limit the threads of torch and of the libraries below it, before they are loaded."""
    if threads is None:
        return
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(threads)
    import torch

    torch.set_num_threads(threads)


def command_line(context: typer.Context) -> str:
    """The command as typed, quoted so that it can be run again."""
    return shlex.join(["torchlc", *context.obj])


def warn(warnings: Any) -> None:
    for text in warnings:
        say(f"warning: {text}")


def show_fit(result: FitResult, out: Path, *, quiet: bool, json: bool) -> None:
    """The conclusion of a fit on standard output, its warnings on standard error."""
    if json:
        show_json(result.to_json())
        return
    if quiet:
        return
    print(printable(result.headline()))
    rows = result.lines()
    width = max((len(name) for name, _ in rows), default=0)
    for name, text in rows:
        print(f"  {printable(name):{width}}  {text}")
    warn(result.all_warnings)
    print(f"written: {out / 'report.html'}, fit.json and more")


def after_interrupt(arguments: list[str]) -> str:
    """How to go on after Ctrl-C."""
    match arguments[:1]:
        case ["fit"]:
            again = arguments if "--resume" in arguments else [*arguments, "--resume"]
            return f"; continue with: torchlc {shlex.join(again)}"
        case ["campaign"]:
            return f"; continue with: torchlc {shlex.join(arguments)}"
        case ["diagnose" | "demo"]:
            return f"; begin again with: torchlc {shlex.join(arguments)}"
    return ""


def run(arguments: list[str]) -> int:
    """The command with its arguments, in this process; returns the exit code."""
    command = typer.main.get_command(app)
    return exit_code(
        lambda: command.main(arguments, prog_name="torchlc", standalone_mode=False, obj=arguments),
        after_interrupt(arguments),
    )


def main() -> None:
    """Entry point of the ``torchlc`` command."""
    sys.exit(run(sys.argv[1:]))
