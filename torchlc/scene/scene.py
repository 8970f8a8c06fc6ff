"""A scene: what is seen, from where, how it is turned, what it is made of, which physics is modelled."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from torchlc.errors import InputError
from torchlc.files.encodings import wide_encoding
from torchlc.files.numbers import Table
from torchlc.files.reading import changed, readable_file, sha256_of, unchanged
from torchlc.files.toml import parse_toml
from torchlc.scene.checks import checked, file_inside
from torchlc.scene.problems import of_validation
from torchlc.scene.tables import SceneTables
from torchlc.scene.tle import is_elements
from torchlc.scene.writer import toml_key, toml_table, toml_value

MAX_TOML_BYTES = 1 << 20
"""Scenes are a few kB."""
OF_TABLES = (".csv", ".ecsv", ".tsv", ".tbl", ".dat")
"""Names of files of recordings end so."""


class Scene(SceneTables):
    """The checked content of one scene file; see docs/formats for the meaning of every key."""

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
        data = parse_toml(text, source)
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

    def with_spin_epoch(self, epoch: str) -> Scene:
        """This scene with ``epoch``, ISO text, for that of a spin which would count from a recording's first row."""
        if not self.attitude.spins_from_first_row:
            return self
        return self.model_copy(update={"attitude": self.attitude.model_copy(update={"spin_epoch": epoch})})

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
    _check_kind(path, text)
    scene = Scene.from_toml(text, path.parent, path, trust=trust, known_effects=known_effects)
    scene._sha256 = digest
    return scene


def _check_kind(path: Path, text: str) -> None:
    """InputError where the file is plainly another one that torchlc takes."""
    if any(line.startswith(("1 ", "2 ")) and is_elements(line) for line in text.splitlines()):
        hint = "torchlc init my.toml --tle FILE makes a scene of them"
        raise InputError(path, None, "two-line elements", "a scene in TOML", hint)
    if path.suffix.lower() in OF_TABLES and "torchlc-scene" not in text:
        hint = "The scene is given first, then the recording"
        raise InputError(path, None, "no scene", "a scene in TOML", hint)


def content_of_scene(path: str | Path, *, trust: bool = False) -> tuple[str, dict[str, Path]]:
    """Hash of a scene's bytes, and where the files lie that its text names, by their names, whether or not the scene is
    sound.

    Nothing is opened but the scene. A name is left out that reading the scene will refuse: a file that is not there, that
    lies outside the scene's folder unless ``trust`` allows it, or that is too large.
    """
    path = Path(path)
    text, digest = _text(path)
    files: dict[str, Path] = {}
    with contextlib.suppress(InputError):  # its reader will say what is wrong with the text
        for name in _file_names(parse_toml(text, path)):
            with contextlib.suppress(PydanticCustomError):
                files[name] = file_inside(path.parent, name, trust=trust)
    return digest, files


def _file_names(node: Any) -> Iterator[str]:
    """Meshes, quaternions, elements and ephemerides in a scene's tables."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key in ("file", "tle_file", "oem_file") and isinstance(value, str):
                yield value
            else:
                yield from _file_names(value)
    elif isinstance(node, list):
        for value in node:
            yield from _file_names(value)


def _text(path: Path) -> tuple[str, str]:
    """The text of a scene file, and the hash of its bytes."""
    with readable_file(path, "a scene in TOML").open("rb") as stream:
        content = stream.read(MAX_TOML_BYTES + 1)
    if len(content) > MAX_TOML_BYTES:
        raise InputError(path, None, "more than 1 MiB", "a scene of at most 1 MiB")
    try:
        text = content.decode(wide_encoding(content) or "utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError(path, f"line {line}", "not UTF-8 text", "UTF-8 text") from None
    return text, hashlib.sha256(content).hexdigest()


def _given(table: Table) -> dict[str, Any]:
    """The fields that differ from their defaults, or that were given."""
    return {name: getattr(table, name) for name in type(table).model_fields if name in table.model_fields_set}
