"""Recordings: light curves as measured, read and checked."""

from torchlc.readers.reader import load_recording
from torchlc.readers.recording import Recording, counted, iso_times, left_out, seconds_since

__all__ = ["Recording", "counted", "iso_times", "left_out", "load_recording", "seconds_since"]
