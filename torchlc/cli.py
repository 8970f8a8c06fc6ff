"""The command line: each command is a verb of :mod:`torchlc.api`, whose import waits until it is needed."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchlc import __version__
from torchlc.terminal import exit_code, printable, progress_bar, say, show_json

if TYPE_CHECKING:
    from torchlc.results import FitResult

app = typer.Typer(
    name="torchlc",
    help="What is a satellite made of, and what does its model leave out? Simulate, fit and diagnose light curves.",
    epilog="Start with: [bold]torchlc demo[/bold], or [bold]torchlc init my.toml --tle elements.txt[/bold].",
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).", show_default=False)]
RecordingFile = Annotated[
    Path, typer.Argument(metavar="OBS", help="Recording (ECSV or CSV).", show_default=False)
]
Out = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Directory for the results.", show_default=False)
]
Seed = Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**32 - 1)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Threads = Annotated[
    int | None, typer.Option(help="Threads of the computation.", min=1, max=1024, show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
Use = Annotated[
    str | None, typer.Option(help="mag or flux, of a recording that has both.", show_default=False)
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
    hours: Annotated[float | None, typer.Option(help="Length, h.", show_default=False)] = None,
    cadence: Annotated[float | None, typer.Option(help="Time between rows, s.", show_default=False)] = None,
    noise: Annotated[
        float | None, typer.Option(help="Standard error, mag: makes a recording of it.", show_default=False)
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
    from torchlc.output import OutputDirectory

    first: str | float | None = start
    if start is not None and start.replace(".", "", 1).isdigit():
        first = float(start)
    curve = api.simulate(
        scene, recording, start=first, hours=hours, cadence=cadence, noise=noise, seed=seed, trust=trust
    )
    with OutputDirectory(out) as directory:
        curve.write(directory.path / "curve.ecsv")
    if json:
        show_json(curve.to_json() | {"file": str(out / "curve.ecsv")})
    elif not quiet:
        print(printable(curve.headline()))
        print(f"written: {out / 'curve.ecsv'}")
        warn(curve.warnings)


@app.command(epilog="Example: torchlc fit scene.toml recording.ecsv -o out, then open out/report.html")
def fit(
    scene: SceneFile,
    recording: RecordingFile,
    out: Out,
    steps: Annotated[
        int | None,
        typer.Option(help="Length of the chain; default: until long enough.", min=1, show_default=False),
    ] = None,
    walkers: Annotated[
        int | None,
        typer.Option(help="Walkers of the ensemble; default 6 a parameter.", min=2, show_default=False),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the chain found in DIR.")] = False,
    use: Use = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
    trust: Trust = False,
) -> None:
    """Find what the object is made of: Adam, then emcee; fit.json, posterior.nc, chain.h5, report.html and
    figures.
    """
    use_threads(threads)
    from torchlc import api

    with progress_bar(not (quiet or json)) as progress:
        result = api.fit(
            scene, recording, out=out, steps=steps, walkers=walkers, resume=resume, use=use, seed=seed, trust=trust,
            progress=progress, command=command_line(),
        )  # fmt: skip
    show_fit(result, out, quiet=quiet, json=json)


@app.command(
    epilog="Example: torchlc diagnose scene.toml recording.ecsv -o out --effects panel_offset,earthshine"
)
def diagnose(
    scene: SceneFile,
    recording: RecordingFile,
    out: Out,
    effects: Annotated[
        str | None,
        typer.Option(help="The only candidates, comma-separated; noise is always added.", show_default=False),
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
    from torchlc.output import without_nan

    candidates = None if effects is None else [name.strip() for name in effects.split(",") if name.strip()]
    with progress_bar(not (quiet or json)) as progress:
        result = api.diagnose(
            scene, recording, out=out, quick=quick, effects=candidates, seed=seed, use=use, trust=trust,
            progress=progress, command=command_line(),
        )  # fmt: skip
    if json:
        show_json(without_nan(result.to_json()))
    elif not quiet:
        print(printable(repr(result)))
        print(f"written: {out / 'diagnosis.json'}")


@app.command()
def effects(quiet: Quiet = False, seed: Seed = 0, threads: Threads = None, json: Json = False) -> None:
    """List the library of effects: name, parameters with units and bounds, and one sentence each."""
    from torchlc.listing import effects_lines, effects_listing

    if json:
        show_json({"effects": effects_listing()})
    elif not quiet:
        print("\n".join(effects_lines()))


def use_threads(threads: int | None) -> None:
    """Limit the threads of torch and of the libraries below it, before they are loaded."""
    if threads is None:
        return
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(threads)
    import torch

    torch.set_num_threads(threads)


def command_line() -> list[str]:
    """The command as typed, quoted so that it can be run again."""
    return ["torchlc", *map(shlex.quote, sys.argv[1:])]


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
    if arguments[:1] != ["fit"]:
        return ""
    again = arguments if "--resume" in arguments else [*arguments, "--resume"]
    return f"; continue with: torchlc {shlex.join(again)}"


def main() -> None:
    """Entry point of the ``torchlc`` command."""
    arguments = sys.argv[1:]
    command = typer.main.get_command(app)
    sys.exit(
        exit_code(
            lambda: command.main(arguments, prog_name="torchlc", standalone_mode=False),
            after_interrupt(arguments),
        )
    )
