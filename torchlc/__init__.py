"""torchlc: what is it made of, and what does the model leave out? Differentiable light curves of satellites
and debris.

The verbs are :func:`load`, :func:`simulate`, :func:`fit`, :func:`diagnose` and :func:`campaign`;
:class:`LightCurve` is the model, a torch module. Everything is imported on first use.
"""

from __future__ import annotations

import importlib
import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchlc.api import campaign, diagnose, fit, load, simulate
    from torchlc.campaigns.run import CampaignResult
    from torchlc.errors import InputError, TorchlcError
    from torchlc.inference.likelihood import Likelihood
    from torchlc.lightcurve.model import LightCurve
    from torchlc.readers import Recording
    from torchlc.results.fit_result import FitResult
    from torchlc.results.simulated_curve import SimulatedCurve
    from torchlc.scene import Scene

__version__ = "0.1.0"

_HOME = {
    "load": "api", "simulate": "api", "fit": "api", "diagnose": "api",
    "campaign": "api", "CampaignResult": "campaign.run",
    "LightCurve": "model", "Likelihood": "likelihood", "Scene": "scene", "Recording": "recording",
    "FitResult": "results", "SimulatedCurve": "simulated", "InputError": "errors", "TorchlcError": "errors",
}  # fmt: skip
"""Public name: the module it comes from."""

__all__ = [
    "CampaignResult",
    "FitResult",
    "InputError",
    "LightCurve",
    "Likelihood",
    "Recording",
    "Scene",
    "SimulatedCurve",
    "TorchlcError",
    "__version__",
    "campaign",
    "diagnose",
    "fit",
    "load",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(types.ModuleType):
    """Keeps ``torchlc.fit``, ``diagnose`` and ``campaign`` the verbs: importing the modules of those names would
    put them in their place.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (_HOME.get(name) == "api" and isinstance(value, types.ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
