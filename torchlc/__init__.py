"""torchlc: what is it made of, and what does the model leave out? Differentiable light curves of satellites
and debris.

The verbs are :func:`load`, :func:`simulate`, :func:`predict`, :func:`visibility`, :func:`fit`, :func:`diagnose`,
:func:`rotation` and :func:`campaign`; :class:`LightCurve` is the model, a torch module. Everything is imported on first use.
"""

from __future__ import annotations

from torchlc.version import __version__

TYPE_CHECKING = False
"""As that of typing, whose import takes as long as all else that stands before the program's handler of Ctrl-C."""
if TYPE_CHECKING:
    from typing import Any

    from torchlc.api import diagnose, fit, load, predict, rotation, simulate, visibility
    from torchlc.campaigns.run import CampaignResult, campaign
    from torchlc.errors import InputError, TorchlcError
    from torchlc.inference.likelihood import Likelihood
    from torchlc.lightcurve.model import LightCurve
    from torchlc.prediction.result import Prediction
    from torchlc.prediction.visibility import Visibility
    from torchlc.readers import Recording
    from torchlc.report.write import write_report
    from torchlc.results.fit_result import FitResult
    from torchlc.results.rotation_result import RotationResult
    from torchlc.results.simulated_curve import SimulatedCurve
    from torchlc.results.stored_fit import StoredFit, load_fit
    from torchlc.scene import Scene

_HOME = {
    "load": "api", "simulate": "api", "fit": "api", "diagnose": "api",
    "rotation": "api", "RotationResult": "results.rotation_result",
    "predict": "api", "visibility": "api", "Prediction": "prediction.result", "Visibility": "prediction.visibility",
    "write_report": "report.write", "campaign": "campaigns.run", "CampaignResult": "campaigns.run",
    "LightCurve": "lightcurve.model", "Likelihood": "inference.likelihood",
    "Scene": "scene", "Recording": "readers",
    "FitResult": "results.fit_result", "SimulatedCurve": "results.simulated_curve",
    "StoredFit": "results.stored_fit", "load_fit": "results.stored_fit",
    "InputError": "errors", "TorchlcError": "errors",
}  # fmt: skip
"""Public name: the module it comes from."""

__all__ = [
    "CampaignResult",
    "FitResult",
    "InputError",
    "LightCurve",
    "Likelihood",
    "Prediction",
    "Recording",
    "RotationResult",
    "Scene",
    "SimulatedCurve",
    "StoredFit",
    "TorchlcError",
    "Visibility",
    "__version__",
    "campaign",
    "diagnose",
    "fit",
    "load",
    "load_fit",
    "predict",
    "rotation",
    "simulate",
    "visibility",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # here: loading it takes longer than all else that this file does

    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
