"""One command from its arguments to its exit code."""

from __future__ import annotations

import shlex
from collections.abc import Callable

import typer

from torchlc.cli import commands  # noqa: F401 - importing them registers them
from torchlc.cli.app import app
from torchlc.errors import at_a_shell
from torchlc.terminal import exit_code


def after_interrupt(arguments: list[str]) -> str:
    """How to go on after Ctrl-C."""
    match arguments[:1]:
        case ["fit"]:
            again = arguments if "--resume" in arguments else [*arguments, "--resume"]
            return f"; continue with: torchlc {shlex.join(again)}"
        case ["campaign"]:
            return f"; continue with: torchlc {shlex.join(arguments)}"
        case ["rotation"] if any(one.startswith(("-o", "--out")) for one in arguments):
            return f"; continue with: torchlc {shlex.join(arguments)}"
        case ["diagnose" | "demo" | "rotation"]:
            return f"; begin again with: torchlc {shlex.join(arguments)}"
    return ""


def run(
    arguments: list[str], around: Callable[[Callable[[], object]], object] = lambda action: action()
) -> int:
    """The command with its arguments, in this process; returns the exit code. ``around`` calls what it is given: the one
    part of the run in which an exception may come from a signal.
    """

    def action() -> object:
        command = typer.main.get_command(app)
        found = command.main(arguments, prog_name="torchlc", standalone_mode=False, obj=arguments)
        print(end="", flush=True)
        return found

    with at_a_shell():
        return exit_code(lambda: around(action), after_interrupt(arguments))
