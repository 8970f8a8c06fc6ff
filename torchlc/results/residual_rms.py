"""How far a recording is from a model, as root mean squares of its measured rows."""

from __future__ import annotations

import math

import numpy as np

from torchlc.noise.error_law import MAG_PER_LN
from torchlc.readers import Recording


def rms_mag(recording: Recording, prediction: np.ndarray) -> float:
    """Root mean square residual, mag, over rows in which both fluxes are positive; ``prediction`` (T,) in the recording's unit."""
    if recording.kind == "mag":
        return _rms((recording.observed - prediction)[~recording.upper_limit])
    ratio = _ratio(recording, prediction)
    return _rms(MAG_PER_LN * np.log(ratio[np.isfinite(ratio) & (ratio > 0)]))


def rms_relative(recording: Recording, prediction: np.ndarray) -> float:
    """Root mean square residual of flux over the model (magnitudes), or over the mean of its curve
    (relative flux).
    """
    measured = ~recording.upper_limit
    if recording.kind == "mag":
        return _rms(_ratio(recording, prediction) - 1)
    curve = recording.curve
    mean = {c: recording.observed[(curve == c) & measured].mean() for c in np.unique(curve[measured])}
    return _rms((recording.observed - prediction)[measured] / np.array([mean[c] for c in curve[measured]]))


def _ratio(recording: Recording, prediction: np.ndarray) -> np.ndarray:
    """Observed over predicted flux of the measured rows, (M,); inf where the model is dark."""
    measured = ~recording.upper_limit
    if recording.kind == "mag":
        return 10 ** (-0.4 * (recording.observed - prediction)[measured])
    with np.errstate(divide="ignore", invalid="ignore"):
        return recording.observed[measured] / prediction[measured]


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan
