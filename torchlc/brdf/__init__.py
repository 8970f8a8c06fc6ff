"""Reflection models (BRDFs), one file each; ``MODELS`` holds them by the name a scene uses."""

from torchlc.brdf.base import MODELS, Brdf, Incidence, incidence
from torchlc.naming import import_modules

import_modules(__name__, __path__)

__all__ = ["MODELS", "Brdf", "Incidence", "incidence"]
