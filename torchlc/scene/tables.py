"""The tables of one scene file together, and the numbers and files that they name."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from torchlc.naming import Origin, full_names
from torchlc.scene.numbers import Free, Name, Table, Title
from torchlc.scene.parts import Attitude, Component, Material, Mesh, Model, Orbit, Station
from torchlc.scene.reading import Reading


class SceneTables(Table):
    """What a scene file says, before one table has been held against another."""

    format: Literal["torchlc-scene/1"]
    name: Title
    orbit: Orbit
    stations: list[Station] = Field(default_factory=list)
    attitude: Attitude
    components: Annotated[list[Component], Field(min_length=1, max_length=1000)]
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
        free = [name for name, number in self.numbers().items() if isinstance(number, Free)]
        free += [name for name, number in self.model.parameters.items() if isinstance(number, Free)]
        effects = "known physics" if self.model.effects is None else ", ".join(self.model.effects) or "none"
        lines = [
            f"Scene: {self.name}",
            f"  orbit       {orbit}",
            f"  stations    {', '.join(station.id for station in self.stations) or 'none'}",
            f"  attitude    {self.attitude.mode}",
            f"  components  {', '.join(f'{one.name} ({one.shape})' for one in self.components)}",
            f"  materials   {', '.join(f'{name} ({one.model})' for name, one in self.materials.items())}",
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
        return f"<pre>{html.escape(repr(self))}</pre>"

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
        meshes = enumerate(self.components)
        named |= {f"components[{i}].file": one.file for i, one in meshes if isinstance(one, Mesh)}
        return {place: name for place, name in named.items() if name is not None}

    def file_path(self, name: str) -> Path:
        """The path of a file that the scene names."""
        return (self._directory or Path()) / name
