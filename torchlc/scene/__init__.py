"""Scenes: TOML in, checked tables out."""

from torchlc.scene.numbers import Free, value_of
from torchlc.scene.parts import (
    Attitude,
    Box,
    Component,
    Cone,
    Cylinder,
    Dish,
    Material,
    Mesh,
    Model,
    Orbit,
    Plate,
    Sphere,
    Station,
    Tracks,
)
from torchlc.scene.scene import Scene, content_of_scene, load_scene
from torchlc.scene.tle import PLACEHOLDER

Number = float | Free

__all__ = [
    "PLACEHOLDER",
    "Attitude",
    "Box",
    "Component",
    "Cone",
    "Cylinder",
    "Dish",
    "Free",
    "Material",
    "Mesh",
    "Model",
    "Number",
    "Orbit",
    "Plate",
    "Scene",
    "Sphere",
    "Station",
    "Tracks",
    "content_of_scene",
    "load_scene",
    "value_of",
]
