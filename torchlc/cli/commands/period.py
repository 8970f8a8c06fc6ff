"""An unknown spin."""

from __future__ import annotations

from typing import Annotated

from torchlc.cli.app import app
from torchlc.cli.options import (
    Columns,
    Json,
    Quiet,
    RecordingFile,
    Seed,
    Threads,
    Use,
    number,
)
from torchlc.cli.printing import use_threads, warn
from torchlc.terminal import show_json


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
    columns: Columns = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Find an unknown spin: a periodogram's candidates with their aliases."""
    use_threads(threads)
    from torchlc.inference.period import find_period
    from torchlc.readers import left_out, load_recording

    rows = load_recording(recording, use=use, columns=columns)
    found = find_period(rows, shortest_s=shortest, longest_s=longest)
    if json:
        show_json(found.to_json())
    elif not quiet:
        print(found)
        warn([*left_out(rows), *rows.warnings])
