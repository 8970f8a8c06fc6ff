"""Reflection models (BRDFs), one file each; ``MODELS`` holds them by the name a scene uses."""

from torchlc.brdf.angles import Incidence, incidence
from torchlc.brdf.base import MODELS, Brdf
from torchlc.naming import import_modules

import_modules(__name__, __path__)

__all__ = ["MODELS", "Brdf", "Incidence", "incidence"]
