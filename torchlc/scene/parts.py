"""The tables of a scene: orbit, stations, attitude, components, materials, model."""

from __future__ import annotations

import datetime
import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from torchlc.scene.numbers import (
    SIDES,
    WHOLE,
    Constant,
    Direction,
    Free,
    Name,
    Number,
    Positive,
    Real,
    Size,
    Table,
    Vector,
    between,
    problem,
)
from torchlc.scene.timestamps import ISO, UnreadableTime, instant
from torchlc.scene.tle import checked_lines

MAX_PLATE_SKEW = 1e-3
"""Largest |cos| of the angle between a plate's u and v that counts as a right angle."""
ROUNDING = 1e-9
"""By which the moments of a flat body may miss the sum of the other two."""


def _iso_text(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime.datetime) else value


def _epoch(value: str | float) -> str | float:
    try:
        zoned = isinstance(value, str) and (match := ISO.fullmatch(value)) and match.group("zone")
        instant(value, "utc" if zoned else "tdb")
    except UnreadableTime as error:
        raise problem(repr(error.found[:40]), error.expected) from None
    return value


Epoch = Annotated[
    Annotated[str, Field(strict=True)] | Real, BeforeValidator(_iso_text), AfterValidator(_epoch)
]
"""ISO text or a Julian date."""


class Orbit(Table):
    """Where the object is: elements, a file of elements of many epochs or of an ephemeris, or in the
    recording as vectors (in this frame) or as alt-az rows.
    """

    tle: Annotated[tuple[str, str], AfterValidator(checked_lines)] | None = None
    tle_file: str | None = None
    oem_file: str | None = None
    vectors: Literal["icrs", "ecliptic"] | None = None
    altaz: Annotated[bool, Field(strict=True)] = False

    @property
    def known(self) -> bool:
        """Is the orbit known at other times than those of the recording?"""
        return self.tle is not None or self.tle_file is not None or self.oem_file is not None

    @model_validator(mode="after")
    def _exactly_one(self) -> Orbit:
        given = (self.tle, self.tle_file, self.oem_file, self.vectors)
        count = sum(one is not None for one in given) + self.altaz
        if count != 1:
            raise problem(
                "none of them" if count == 0 else "more than one",
                "one of tle, tle_file, oem_file, vectors, altaz = true",
            )
        return self


class Station(Table):
    """A site: geodetic latitude and east longitude in degrees, height in metres above the ellipsoid."""

    id: Name
    latitude: Annotated[Real, between(-90, 90)]
    longitude: Annotated[Real, between(-180, 360)]
    height: Annotated[Real, between(-1000, 100_000)]


Latitude = Annotated[Number, between(-90, 90)]


class Attitude(Table):
    """How the object is turned: angles in degrees, spin_rate in rev/h, period in h, period_rate in ms a day.

    ``inertia`` holds the moments about the first two principal axes over that about the third.
    """

    SPIN: ClassVar = ("spin_axis", "spin_rate", "spin_phase", "spin_epoch")
    TURN: ClassVar = ("pole", "period", "phase", "epoch")
    MODE_KEYS: ClassVar[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
        "nadir": ((), SPIN),
        "yaw-steering": ((), SPIN),
        "sun": ((), SPIN),
        "inertial": ((), ("x_angle", *SPIN)),
        "quaternions": (("file",), ()),
        "spin-pole": (TURN, ("period_rate", "tilt")),
        "rigid-body": ((*TURN, "nutation", "inertia"), ("polhode_phase", "period_rate", "tilt")),
    }
    """Mode: keys it needs, keys it may have."""
    ALWAYS: ClassVar = ("spin_rate", "spin_phase", "x_angle", "period", "phase", "nutation", "polhode_phase")
    """Numbers that a mode has, whether the scene gives them or not, if the mode knows them."""

    mode: Literal["nadir", "yaw-steering", "sun", "inertial", "quaternions", "spin-pole", "rigid-body"]
    spin_axis: Direction | None = None
    spin_rate: Number = 0.0
    spin_phase: Number = 0.0
    spin_epoch: Epoch | None = None
    x_angle: Number = 0.0
    pole: tuple[Number, Latitude] | None = None
    period: Positive | None = None
    phase: Number = 0.0
    epoch: Epoch | None = None
    period_rate: Number = 0.0
    tilt: tuple[Number, Number, Number] | None = None
    nutation: Annotated[Number, between(0, 90)] | None = None
    polhode_phase: Number = 0.0
    inertia: tuple[Positive, Positive] | None = None
    file: str | None = None

    def numbers(self) -> dict[str, float | Free]:
        """The numbers of this mode by the end of their full name, e.g. "spin_rate"."""
        needed, allowed = self.MODE_KEYS[self.mode]
        numbers: dict[str, float | Free] = {
            key: getattr(self, key) for key in self.ALWAYS if key in needed + allowed
        }
        if self.pole is not None:
            numbers["pole_lon"], numbers["pole_lat"] = self.pole
        if "period_rate" in self.model_fields_set:
            numbers["period_rate"] = self.period_rate
        if self.inertia is not None:
            numbers |= {f"inertia_{axis}": one for axis, one in zip("xy", self.inertia, strict=True)}
        if self.tilt is not None:
            numbers |= {f"tilt_{axis}": one for axis, one in zip("xyz", self.tilt, strict=True)}
        return numbers

    @property
    def spins_from_first_row(self) -> bool:
        """Is there a spin whose phase is that at the first row of a recording?"""
        return self.spin_axis is not None and self.spin_epoch is None

    @field_validator("inertia")
    @classmethod
    def _is_a_body(cls, inertia: tuple[float | Free, float | Free] | None) -> Any:
        """No moment may exceed the sum of the other two, wherever within their bounds the numbers go."""
        if inertia is None:
            return None
        ends = []
        for one in inertia:
            low, high = (one.low, one.high) if isinstance(one, Free) else (one, one)
            if low is None or high is None:
                raise problem("no bounds", "low and high: moments of inertia of a body have them")
            ends.append((low, high))
        (x_low, x_high), (y_low, y_high) = ends
        worst = min(x_low + y_low - 1, 1 + y_low - x_high, 1 + x_low - y_high)
        if worst < -ROUNDING:
            raise problem(
                f"{x_low:g} to {x_high:g} and {y_low:g} to {y_high:g}, with 1 for the third",
                "moments of which none exceeds the sum of the other two: low_x + low_y >= 1, high_x <= 1 + low_y, "
                "high_y <= 1 + low_x",
            )
        return inertia

    @model_validator(mode="after")
    def _keys_suit_the_mode(self) -> Attitude:
        needed, allowed = self.MODE_KEYS[self.mode]
        given = self.model_fields_set - {"mode"}
        for key in needed:
            if key not in given:
                raise problem("missing", f'a value: mode "{self.mode}" needs it', key)
        for key in sorted(given - {*needed, *allowed}):
            also = ", ".join((*needed, *allowed)) or "none"
            raise problem("a key that does not belong to this mode", f'for mode "{self.mode}": {also}', key)
        if given & set(self.SPIN) and not {"spin_axis", "spin_rate"} <= given:
            raise problem("a spin without its axis or rate", "spin_axis and spin_rate", "spin_axis")
        return self


class Tracks(Table):
    """The component turns about the line along ``axis`` (body frame) through its centre to face the Sun."""

    target: Literal["sun"]
    axis: Direction


class _Component(Table):
    """What all shapes share: lengths in metres; ``rotation`` about body x, then y, then z, in degrees."""

    name: Name
    centre: Vector
    material: Name
    rotation: Vector = (0.0, 0.0, 0.0)
    tracks: Tracks | None = None

    def numbers(self) -> dict[str, float | Free]:
        """Sizes by the end of their full name, e.g. "size_x"."""
        return {}

    def materials(self) -> list[tuple[str, str]]:
        """(key, material name) of everything this component is made of."""
        return [("material", self.material)]


Side = Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z"]


class Box(_Component):
    """``size`` along body X, Y, Z before ``rotation``."""

    shape: Literal["box"]
    size: tuple[Size, Size, Size]
    face_materials: dict[Side, Name] = Field(default_factory=dict)

    def numbers(self) -> dict[str, float | Free]:
        return {f"size_{axis}": size for axis, size in zip("xyz", self.size, strict=True)}

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *((f"face_materials.{face}", name) for face, name in self.face_materials.items()),
        ]


class Plate(_Component):
    """A two-sided rectangle, ``size`` along u and v; the normal of its front is u x v."""

    shape: Literal["plate"]
    size: tuple[Size, Size]
    u: Direction
    v: Direction
    back_material: Name | None = None

    @model_validator(mode="after")
    def _right_angle(self) -> Plate:
        cosine = sum(a * b for a, b in zip(self.u, self.v, strict=True)) / (
            math.hypot(*self.u) * math.hypot(*self.v)
        )
        if abs(cosine) > MAX_PLATE_SKEW:
            raise problem(
                f"{math.degrees(math.acos(max(-1.0, min(1.0, cosine)))):.3f} deg between u and v",
                "90 deg",
                "v",
            )
        return self

    def numbers(self) -> dict[str, float | Free]:
        return {"size_u": self.size[0], "size_v": self.size[1]}

    def materials(self) -> list[tuple[str, str]]:
        return [
            *super().materials(),
            *([("back_material", self.back_material)] if self.back_material else []),
        ]


Facets = Annotated[int, Field(strict=True, ge=3, le=100_000)]


class Cylinder(_Component):
    """Closed by two caps; ``axis`` points to cap+, ``facets`` is the least number of side facets."""

    shape: Literal["cylinder"]
    radius: Size
    length: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Facets | None = None

    def numbers(self) -> dict[str, float | Free]:
        return {"radius": self.radius, "length": self.length}


class Cone(_Component):
    """A frustum from ``radius`` to ``radius_top`` along ``axis``."""

    shape: Literal["cone"]
    radius: Size
    radius_top: Annotated[Constant, between(0.0)] = 0.0
    length: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Facets | None = None

    def numbers(self) -> dict[str, float | Free]:
        return {"radius": self.radius, "radius_top": self.radius_top, "length": self.length}


class Dish(_Component):
    """An open two-sided bowl; ``axis`` points out of its opening."""

    shape: Literal["dish"]
    radius: Size
    depth: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Facets | None = None

    def numbers(self) -> dict[str, float | Free]:
        return {"radius": self.radius, "depth": self.depth}


class Sphere(_Component):
    shape: Literal["sphere"]
    radius: Size

    def numbers(self) -> dict[str, float | Free]:
        return {"radius": self.radius}


AXES_OF_A_MESH = "u = [x, y, z], projected on each facet, or u_around = [x, y, z], an axis that u runs round"
"""What a mesh needs for an anisotropic material."""


def _whole_or_by_side(given: Any) -> str:
    return SIDES if isinstance(given, dict) else WHOLE


class Mesh(_Component):
    """Triangles of ``file``, ``scale`` metres per unit of the file.

    The axis u of anisotropic materials is the direction ``u`` projected on each facet, or runs round the axis
    ``u_around``; both turn with ``rotation``. ``u`` may be a table of directions by the side that facets face.
    """

    shape: Literal["mesh"]
    file: str
    scale: Annotated[Real, between(0.0, above=True)] = 1.0
    u: (
        Annotated[
            Annotated[Direction, Tag(WHOLE)] | Annotated[dict[Side, Direction], Tag(SIDES)],
            Discriminator(_whole_or_by_side),
        ]
        | None
    ) = None
    u_around: Direction | None = None

    @property
    def has_axes(self) -> bool:
        """Whether the scene says where u is on its facets."""
        return self.u is not None or self.u_around is not None

    @model_validator(mode="after")
    def _one_way(self) -> Mesh:
        if self.u is not None and self.u_around is not None:
            raise problem("given beside u", "u or u_around", "u_around")
        return self


Component = Annotated[Box | Plate | Cylinder | Cone | Dish | Sphere | Mesh, Field(discriminator="shape")]


class Material(Table):
    """A reflection model and its numbers; those that the scene leaves out come from ``preset``."""

    model: str = "ashikhmin-shirley"
    preset: str | None = None
    parameters: dict[str, Constant] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather_parameters(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        own = {key: value for key, value in data.items() if key in ("model", "preset")}
        return {**own, "parameters": {key: value for key, value in data.items() if key not in own}}


class Model(Table):
    """What the model holds. ``effects`` None: the known physics that the data allow; an empty list: none."""

    effects: list[str] | None = None
    parameters: dict[str, Number] = Field(default_factory=dict)
    band_sun_magnitude: Real | dict[str, Real] | None = None

    @model_validator(mode="before")
    @classmethod
    def _split_parameters(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        if "band_sun_magnitude" in data:
            raise problem("unknown key", "it in [model.parameters]", "band_sun_magnitude")
        if not isinstance(data.get("parameters"), dict):
            return data
        parameters = dict(data["parameters"])
        if "band_sun_magnitude" in parameters:
            return {
                **data,
                "parameters": parameters,
                "band_sun_magnitude": parameters.pop("band_sun_magnitude"),
            }
        return data
