"""The tables of one scene file together, and the numbers and files that they name."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PrivateAttr

from torchlc.errors import InputError
from torchlc.files.numbers import Free, Name, Table, Title, value_of
from torchlc.files.svg import polygons
from torchlc.naming import Origin, full_names
from torchlc.scene.parts import Attitude, ComponentOfAnyShape, Material, Model, Orbit, Station
from torchlc.scene.reading import Reading

ASIDE = np.array([[-0.55, 0.84, 0.0], [-0.32, -0.21, 0.92], [0.77, 0.50, 0.38]])
"""Rows: right, up and towards the reader in the body frame, for a picture that shows +X, +Y and +Z."""
MOST_DRAWN = 5000
"""Facets of a picture: each is some 150 bytes of a notebook."""


class SceneTables(Table):
    """What a scene file says, before one table has been held against another."""

    format: Literal["torchlc-scene/1"]
    name: Title
    orbit: Orbit
    stations: list[Station] = Field(default_factory=list)
    attitude: Attitude
    components: Annotated[list[ComponentOfAnyShape], Field(min_length=1, max_length=1000)]
    materials: dict[Name, Material]
    model: Model = Model()
    recording: Reading = Reading()
    _directory: Path | None = PrivateAttr(None)
    _source: str | Path | None = PrivateAttr(None)
    _warnings: list[str] = PrivateAttr(default_factory=list)
    _sha256: str | None = PrivateAttr(None)
    _hashes: dict[str, str] = PrivateAttr(default_factory=dict)

    def __repr__(self) -> str:
        orbit = next(key for key in type(self.orbit).model_fields if getattr(self.orbit, key))
        numbers = [*self.numbers().items(), *self.model.parameters.items()]
        free = [name for name, number in numbers if isinstance(number, Free) and not number.fixed]
        effects = "known physics" if self.model.effects is None else ", ".join(self.model.effects) or "none"
        lines = [
            f"Scene: {self.name}",
            f"  orbit       {orbit}",
            f"  stations    {', '.join(station.id for station in self.stations) or 'none'}",
            f"  attitude    {self.attitude.mode}",
            f"  components  {', '.join(f'{component.name} ({component.shape})' for component in self.components)}",
            f"  materials   {', '.join(f'{name} ({material.model})' for name, material in self.materials.items())}",
            f"  effects     {effects}",
            f"  free        {', '.join(free) or 'nothing'}",
        ]
        return "\n".join([*lines, *(f"  ! {text}" for text in self.warnings)])

    def __eq__(self, other: object) -> bool:
        """Of the same content, whose file names mean the same files; not of where and how it was written."""
        if not isinstance(other, type(self)):
            return NotImplemented
        return self.__dict__ == other.__dict__ and self.directory == other.directory

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        return f"<div>{self._picture()}<pre>{html.escape(repr(self))}</pre></div>"

    def _picture(self) -> str:
        """The object at rest from aside as SVG, a colour a component; empty where its shape cannot be made."""
        import torch  # a command that only reads a scene does without it

        from torchlc.shapes import Shape

        try:
            parts = Shape(self, {}).parts
        except InputError:
            return ""
        values = {
            name: torch.tensor(value_of(number), dtype=torch.float64, device="cpu")
            for name, number in self.numbers().items()
        }
        if sum(len(part.faces) for part in parts) > MOST_DRAWN:
            return ""
        drawn: list[tuple[float, np.ndarray, int, float]] = []
        for index, part in enumerate(parts):
            facets = part.facets(values)
            towards = facets.normal.numpy() @ ASIDE[2]
            for corners, facing in zip(facets.vertices.numpy(), towards, strict=True):
                if facing > 0:
                    placed = corners @ ASIDE.T
                    drawn.append((float(placed[:, 2].mean()), placed[:, :2], index, float(facing)))
        drawn.sort(key=lambda polygon: polygon[0])
        _, shapes, colours, shades = zip(*drawn, strict=True) if drawn else ((), (), (), ())
        return polygons(shapes, colours, shades, f"{self.name}: {', '.join(part.name for part in parts)}")

    @property
    def directory(self) -> Path | None:
        """Where relative file names start."""
        return self._directory

    @property
    def source(self) -> str | Path | None:
        """The file this scene was read from."""
        return self._source

    @property
    def warnings(self) -> list[str]:
        """What was accepted but deserves to be known."""
        return self._warnings

    def numbers(self) -> dict[str, float | Free]:
        """Numbers of materials, attitude and components by full name, e.g. "panel.n", "body.size_x"."""
        values = self._values()
        return {name: values[origin] for name, origin in full_names(values).items()}

    def origins(self) -> dict[str, Origin]:
        """Whose each of :meth:`numbers` is."""
        return full_names(self._values())

    def _values(self) -> dict[Origin, float | Free]:
        values: dict[Origin, float | Free] = {}
        for name, material in self.materials.items():
            values |= {Origin("materials", name, key): number for key, number in material.parameters.items()}
        attitude = self.attitude.numbers()
        values |= {Origin("attitude", "attitude", key): number for key, number in attitude.items()}
        for component in self.components:
            sizes = component.numbers()
            values |= {Origin("components", component.name, key): number for key, number in sizes.items()}
        return values

    def files(self) -> dict[str, str]:
        """Names of the files that the scene needs, by their place in it."""
        named = {"attitude.file": self.attitude.file}
        named |= {f"orbit.{key}": getattr(self.orbit, key) for key in ("tle_file", "oem_file")}
        for index, component in enumerate(self.components):
            named |= {f"components[{index}].{key}": name for key, name in component.files().items()}
        return {place: name for place, name in named.items() if name is not None}

    def file_path(self, name: str) -> Path:
        """The path of a file that the scene names."""
        return (self._directory or Path()) / name
