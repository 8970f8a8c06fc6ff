"""Recordings: light curves as measured, read and checked."""

from torchlc.readers.format import Format, Head
from torchlc.readers.measurements import (
    counted,
    iso_times,
    left_out,
    place_of_row,
    seconds_since,
    too_few_rows,
)
from torchlc.readers.recording import Recording, load_recording, recording_of
from torchlc.readers.table import Header

__all__ = [
    "Format",
    "Head",
    "Header",
    "Recording",
    "counted",
    "iso_times",
    "left_out",
    "load_recording",
    "place_of_row",
    "recording_of",
    "seconds_since",
    "too_few_rows",
]
