"""The command line."""

from torchlc.cli.commands import main

__all__ = ["main"]
