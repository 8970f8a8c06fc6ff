"""The verbs: load, simulate, predict, visibility, fit, diagnose, rotation. Each takes paths or objects, checks everything before it works,
and returns one object.
"""

from torchlc.api.demonstration import demo
from torchlc.api.diagnosis import diagnose
from torchlc.api.fitting import fit
from torchlc.api.inputs import load, usable
from torchlc.api.outputs import input_files
from torchlc.api.prediction import predict
from torchlc.api.rotation_states import rotation
from torchlc.api.simulation import simulate, visibility

__all__ = [
    "demo",
    "diagnose",
    "fit",
    "input_files",
    "load",
    "predict",
    "rotation",
    "simulate",
    "usable",
    "visibility",
]
