"""Parameters: what each number means, its prior, and the vector of the free ones."""

from torchlc.parameters.prior import Prior
from torchlc.parameters.quantity import (
    EXPONENT,
    FRESNEL,
    INDEX,
    LOBE_REFLECTANCE,
    REFLECTANCE,
    ROLES,
    SHARE,
    WIDTH,
    Quantity,
)
from torchlc.parameters.vector import Free, ParameterSet

__all__ = [
    "EXPONENT",
    "FRESNEL",
    "INDEX",
    "LOBE_REFLECTANCE",
    "REFLECTANCE",
    "ROLES",
    "SHARE",
    "WIDTH",
    "Free",
    "ParameterSet",
    "Prior",
    "Quantity",
]
