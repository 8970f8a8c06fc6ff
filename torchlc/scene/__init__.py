"""Scenes: TOML in, checked tables out."""

from torchlc.files.numbers import Free, value_of
from torchlc.scene.parts import (
    Attitude,
    Material,
    Model,
    Orbit,
    Station,
    station_of,
)
from torchlc.scene.scene import Scene, content_of_scene, load_scene
from torchlc.scene.tle import PLACEHOLDER
from torchlc.shapes import Component, Tracks

Number = float | Free

__all__ = [
    "PLACEHOLDER",
    "Attitude",
    "Component",
    "Free",
    "Material",
    "Model",
    "Number",
    "Orbit",
    "Scene",
    "Station",
    "Tracks",
    "content_of_scene",
    "load_scene",
    "station_of",
    "value_of",
]
