"""Recordings: light curves as measured, read and checked."""

from torchlc.recording.reader import load_recording
from torchlc.recording.recording import Recording, seconds_since

__all__ = ["Recording", "load_recording", "seconds_since"]
