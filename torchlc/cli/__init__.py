"""The command line: each command is a verb, whose import waits until it is needed."""

from __future__ import annotations

import sys

from torchlc.cli import signals

__all__ = ["main", "run"]


def run(arguments: list[str]) -> int:
    """The command with its arguments, in this process; returns the exit code."""
    from torchlc.cli import program

    return program.run(arguments)


def main() -> None:
    """Entry point of the ``torchlc`` command."""
    signals.leave_at_once()
    from torchlc.cli import program
    from torchlc.terminal import prepare_process

    prepare_process()
    code = program.run(sys.argv[1:], signals.unwinding)
    signals.ignore()
    signals.leave(code)
