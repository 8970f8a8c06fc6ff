"""What is injected, and what arrives at the telescope before the detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sky import Array

Effects = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Curve:
    """What arrives at the telescope before the detector; T rows, C components."""

    t: Array  # (T,) s since 2000-01-01 UTC, as stamped
    flux: Array  # (T,) irradiance over the Sun's at 1 au
    components: tuple[str, ...]
    component_flux: Array  # (T, C)
    sunlit: Array  # (T,) 1 full sunlight, 0 umbra
    range_km: Array
    phase_deg: Array
    elevation_deg: Array
    sun_elevation_deg: Array
    airmass: Array
