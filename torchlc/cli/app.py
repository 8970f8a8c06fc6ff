"""The program itself; its commands are in :mod:`torchlc.cli.commands`."""

from __future__ import annotations

from typing import Annotated

import typer

from torchlc.version import __version__

app = typer.Typer(
    name="torchlc",
    help="What is a satellite made of, and what does its model leave out? Light curves fitted and diagnosed.",
    epilog="Start with: [bold]torchlc demo[/bold], or [bold]torchlc init my.toml --tle elements.txt[/bold].",
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
