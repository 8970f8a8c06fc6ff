"""Orbit, observer and Sun: what a scene and a recording say about where everything is."""

from torchlc.geometry.orbit.grid import observation_grid
from torchlc.geometry.orbit.shadow import ShadowCoordinate, shadow_coordinate
from torchlc.geometry.orbit.sources import make_track
from torchlc.geometry.orbit.track import (
    State,
    Track,
    above_horizon,
    airmass,
    angle_between,
    elevation_deg,
    sun_elevation_deg,
)

__all__ = [
    "ShadowCoordinate",
    "State",
    "Track",
    "above_horizon",
    "airmass",
    "angle_between",
    "elevation_deg",
    "make_track",
    "observation_grid",
    "shadow_coordinate",
    "sun_elevation_deg",
]
