"""The command line: each command is a verb, whose import waits until it is needed."""

from torchlc.cli.program import main, run

__all__ = ["main", "run"]
