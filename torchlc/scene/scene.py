"""A scene: what is seen, from where, how it is turned, what it is made of, which physics is modelled."""

from __future__ import annotations

import contextlib
import hashlib
import html
import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError

from torchlc.errors import InputError
from torchlc.files.reading import changed, readable_file, sha256_of, unchanged
from torchlc.naming import Origin, full_names
from torchlc.scene.checks import checked
from torchlc.scene.numbers import Free, Name, Table, Title
from torchlc.scene.parts import Attitude, Component, Material, Mesh, Model, Orbit, Station
from torchlc.scene.problems import of_toml, of_validation
from torchlc.scene.reading import Reading
from torchlc.scene.writer import toml_key, toml_table, toml_value

MAX_TOML_BYTES = 1 << 20


class Scene(Table):
    """The checked content of one scene file; see docs/formats for the meaning of every key."""

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

    @classmethod
    def from_toml(
        cls,
        text: str,
        directory: str | Path | None = None,
        source: str | Path | None = None,
        *,
        trust: bool = False,
        known_effects: Collection[str] | None = None,
    ) -> Scene:
        """Parse and check a scene.

        ``trust`` lets file names leave ``directory``; effects are checked against ``known_effects`` if given.
        """
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise of_toml(source, error) from None
        except (RecursionError, ValueError) as error:
            raise InputError(source, None, f"unreadable TOML: {error}", "TOML without deep nesting") from None
        try:
            scene = cls.model_validate(data)
        except ValidationError as error:
            raise of_validation(source, error) from None
        scene._directory = None if directory is None else Path(directory)
        scene._source = source
        scene._sha256 = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
        return checked(scene, trust=trust, known_effects=known_effects)

    def to_toml(self) -> str:
        """This scene as TOML; reading it again gives an equal scene."""
        head = f"format = {toml_value(self.format)}\nname = {toml_value(self.name)}\n"
        tables = [head, toml_table("orbit", _given(self.orbit))]
        tables += [toml_table("stations", _given(station), array=True) for station in self.stations]
        tables.append(toml_table("attitude", _given(self.attitude)))
        tables += [toml_table("components", _given(component), array=True) for component in self.components]
        for name, material in self.materials.items():
            content = {"model": material.model, "preset": material.preset, **material.parameters}
            tables.append(toml_table(toml_key("materials", name), content))
        parameters: dict[str, Any] = dict(self.model.parameters)
        if self.model.band_sun_magnitude is not None:
            parameters["band_sun_magnitude"] = self.model.band_sun_magnitude
        tables.append(toml_table("model", {"effects": self.model.effects}))
        tables.append(toml_table("model.parameters", parameters))
        if self.recording.model_fields_set:
            tables.append(toml_table("recording", _given(self.recording)))
        return "\n".join(tables)

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

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Read in the block what files the scene names; the hashes of their bytes are kept.

        They are read once more for each model that is built. Raises InputError if one has changed since the
        first time, so that a result never comes from two versions of a file.
        """
        paths = {name: self.file_path(name) for name in self.files().values()}
        with unchanged(*paths.values()):
            yield
            hashes = {name: sha256_of(path) for name, path in paths.items()}
        for name, digest in hashes.items():
            if self._hashes.setdefault(name, digest) != digest:
                raise changed(paths[name], "since it was first read")

    @property
    def sha256(self) -> str | None:
        """Hash of the bytes that the scene was read from."""
        return self._sha256

    @property
    def hashes(self) -> Mapping[str, str]:
        """Hash of the bytes of each file that the scene names and that has been read, by its name."""
        return self._hashes


def load_scene(
    path: str | Path, *, trust: bool = False, known_effects: Collection[str] | None = None
) -> Scene:
    """Read a scene file; every defect is one InputError with its place. Options: see Scene.from_toml."""
    path = Path(path)
    text, digest = _text(path)
    scene = Scene.from_toml(text, path.parent, path, trust=trust, known_effects=known_effects)
    scene._sha256 = digest
    return scene


def _text(path: Path) -> tuple[str, str]:
    """The text of a scene file, and the hash of its bytes."""
    with readable_file(path, "a scene in TOML").open("rb") as stream:
        content = stream.read(MAX_TOML_BYTES + 1)
    if len(content) > MAX_TOML_BYTES:
        raise InputError(path, None, "more than 1 MiB", "a scene of at most 1 MiB")
    try:
        text = content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError(path, f"line {line}", "not UTF-8 text", "UTF-8 text") from None
    return text, hashlib.sha256(content).hexdigest()


def _given(table: Table) -> dict[str, Any]:
    """The fields that differ from their defaults, or that were given."""
    return {name: getattr(table, name) for name in type(table).model_fields if name in table.model_fields_set}
