"""Reflection models (BRDFs), one file each; ``MODELS`` holds them by the name a scene uses."""

from importlib import import_module
from pkgutil import iter_modules

from torchlc.brdf.base import MODELS, Brdf, Incidence, incidence

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = ["MODELS", "Brdf", "Incidence", "incidence"]
