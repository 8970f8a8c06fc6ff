"""The keys that every component of a scene has, whatever its shape."""

from __future__ import annotations

from typing import Any, Literal, get_args

from torchlc.files.numbers import Direction, Free, Name, Table, Vector

Side = Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z"]


class Tracks(Table):
    """The component turns about the line along ``axis`` (body frame) through its centre to face the Sun."""

    target: Literal["sun"]
    axis: Direction


class Component(Table):
    """What all shapes share: lengths in metres; ``rotation`` about body x, then y, then z, in degrees. A shape adds its
    keys; each that may be a free number (``Size``, ``Constant``) is a number of the model by its own name."""

    name: Name
    centre: Vector
    material: Name
    rotation: Vector = (0.0, 0.0, 0.0)
    tracks: Tracks | None = None
    shape: str

    def numbers(self) -> dict[str, float | Free]:
        """Sizes by the end of their full name, e.g. "size_x"."""
        fields = type(self).model_fields.items()
        numbers = {name: getattr(self, name) for name, field in fields if _may_be_free(field.annotation)}
        return {name: number for name, number in numbers.items() if number is not None}

    @classmethod
    def meaning(cls, number: str) -> str:
        """What one of the sizes is, in words: "length along its x axis" of "size_x"."""
        along = number.removeprefix("size_")
        return number.replace("_", " ") if along == number else f"length along its {along} axis"

    def materials(self) -> list[tuple[str, str]]:
        """(key, material name) of everything this component is made of."""
        return [("material", self.material)]

    def files(self) -> dict[str, str]:
        """Names of the files that it needs, by the key that names each."""
        return {}

    @property
    def axes_wanted(self) -> str | None:
        """What the scene has to add before its facets have an axis u, in words; None if they have one."""
        return None


def _may_be_free(annotation: Any) -> bool:
    """Whether a value of this type may be a free number by itself."""
    return annotation is Free or any(
        _may_be_free(argument) for argument in get_args(annotation) if not _is_tuple(annotation)
    )


def _is_tuple(annotation: Any) -> bool:
    return getattr(annotation, "__origin__", None) is tuple
