"""Recordings: light curves as measured, read and checked."""

from torchlc.recording.reader import load_recording
from torchlc.recording.recording import Recording, counted, left_out, seconds_since

__all__ = ["Recording", "counted", "left_out", "load_recording", "seconds_since"]
