"""The library of effects."""

from __future__ import annotations

from torchlc.cli.app import app
from torchlc.cli.options import (
    Json,
    Quiet,
    Seed,
    Threads,
)
from torchlc.terminal import show_json


@app.command()
def effects(quiet: Quiet = False, seed: Seed = 0, threads: Threads = None, json: Json = False) -> None:
    """List the library of effects: name, parameters with units and bounds, and one sentence each."""
    from torchlc.effects import unlisted
    from torchlc.report.listing import effects_lines, effects_listing

    if json:
        show_json({"effects": effects_listing(), "looked_for": effects_listing(unlisted())})
    elif not quiet:
        print("\n".join(effects_lines()))
