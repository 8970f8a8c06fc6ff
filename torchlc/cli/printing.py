"""What commands print, and what they ask of the process."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from torchlc.terminal import printable, say, show_json

if TYPE_CHECKING:
    from torchlc.results.fit_result import FitResult


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
