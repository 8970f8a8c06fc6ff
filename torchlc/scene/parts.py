"""The tables of a scene: orbit, stations, attitude, components, materials, model."""

from __future__ import annotations

import contextlib
import datetime
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    SerializeAsAny,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from torchlc import brdf
from torchlc.errors import InputError, option
from torchlc.files.decimals import decimal
from torchlc.files.numbers import (
    SEVERAL,
    SINGLE,
    Constant,
    Direction,
    Free,
    Name,
    Number,
    Positive,
    Real,
    Table,
    Unknown,
    between,
    problem,
)
from torchlc.materials.known import preset
from torchlc.scene.problems import of_validation, shown
from torchlc.scene.timestamps import ISO, UnreadableTime, instant
from torchlc.scene.tle import checked_lines
from torchlc.shapes import SHAPES, Component
from torchlc.suggest import did_you_mean

PARAMETER_KEY = re.compile(
    r"(?P<effect>[a-z][a-z0-9_]*)\.(?P<quantity>[a-z][a-z0-9_]*)(\[(?P<target>[^\[\]]+)\])?"
)
"""Key of [model.parameters] that is an effect's number."""
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
Epochs = Annotated[
    Annotated[Epoch, Tag(SINGLE)] | Annotated[tuple[Epoch, ...], Field(min_length=1), Tag(SEVERAL)],
    Discriminator(lambda data: SEVERAL if isinstance(data, list | tuple) else SINGLE),
]
"""One epoch, or several, from the nearest of which a row counts."""


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
        count = sum(value is not None for value in given) + self.altaz
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


def station_of(text: str) -> Station:
    """A station from "id,latitude,longitude,height"."""
    place = option("station", argument="stations")
    try:
        parts = [part.strip() for part in text.split(",")]
        name, latitude, longitude, height = parts[0], *map(decimal, parts[1:])
    except (ValueError, TypeError, AttributeError):  # also of what is no text
        expected = "id,latitude,longitude,height as in weihai,37.536,122.05,110"
        raise InputError(None, place, repr(text)[:60], expected) from None
    try:
        return Station(id=name, latitude=latitude, longitude=longitude, height=height)
    except ValidationError as error:
        raise of_validation(place, error) from None


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

    MEANINGS: ClassVar[dict[str, tuple[str, str]]] = {
        "spin_rate": ("rate of the spin", "rev/h"),
        "spin_phase": ("angle of the spin at its epoch", "deg"),
        "x_angle": ("turn of the body about its z axis", "deg"),
        "pole_lon": ("longitude of the pole", "deg"),
        "pole_lat": ("latitude of the pole", "deg"),
        "period": ("period of the rotation", "h"),
        "phase": ("angle of the rotation at its epoch", "deg"),
        "period_rate": ("change of the period in a day", "ms/d"),
        "nutation": ("angle between the axis and the angular momentum", "deg"),
        "polhode_phase": ("angle of the nutation at its epoch", "deg"),
        "inertia_x": ("moment of inertia about x over that about z", ""),
        "inertia_y": ("moment of inertia about y over that about z", ""),
        "tilt_x": ("turn of the axes of rotation about body x", "deg"),
        "tilt_y": ("turn of the axes of rotation about body y", "deg"),
        "tilt_z": ("turn of the axes of rotation about body z", "deg"),
    }
    """What each number is, and its unit."""

    mode: Literal["nadir", "yaw-steering", "sun", "inertial", "quaternions", "spin-pole", "rigid-body"]
    spin_axis: Direction | None = None
    spin_rate: Number = 0.0
    spin_phase: Number = 0.0
    spin_epoch: Epochs | None = None
    x_angle: Number = 0.0
    pole: tuple[Number, Latitude] | None = None
    period: Positive | None = None
    phase: Number = 0.0
    epoch: Epochs | None = None
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
            numbers |= {f"inertia_{axis}": moment for axis, moment in zip("xy", self.inertia, strict=True)}
        if self.tilt is not None:
            numbers |= {f"tilt_{axis}": angle for axis, angle in zip("xyz", self.tilt, strict=True)}
        return numbers

    @property
    def tumbles(self) -> bool:
        """Whether the mode is a free rotation about no axis fixed in the body."""
        return "inertia" in self.MODE_KEYS[self.mode][0]

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
        for moment in inertia:
            low, high = (moment.low, moment.high) if isinstance(moment, Free) else (moment, moment)
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
        absent = [key for key in needed if key not in given]
        if absent:
            more = f"Missing too: {', '.join(f'attitude.{key}' for key in absent[1:])}" if absent[1:] else ""
            raise problem("missing", f'a value: mode "{self.mode}" needs it', absent[0], more)
        for key in sorted(given - {*needed, *allowed}):
            also = ", ".join((*needed, *allowed)) or "none"
            raise problem("a key that does not belong to this mode", f'for mode "{self.mode}": {also}', key)
        if given & set(self.SPIN) and not {"spin_axis", "spin_rate"} <= given:
            raise problem("a spin without its axis or rate", "spin_axis and spin_rate", "spin_axis")
        return self


def _of_its_shape(given: Any) -> Any:
    """A component's table, read by the keys of its shape."""
    if not isinstance(given, Mapping):
        return given
    if "shape" not in given:
        raise problem("missing", 'a shape, such as "box"', "shape")
    shape = given["shape"]
    if not isinstance(shape, str) or shape not in SHAPES:
        expected = f"one of {', '.join(SHAPES)}"
        raise problem(shown(shape), expected, "shape", did_you_mean(str(shape), SHAPES) or "")
    return SHAPES[shape].keys.model_validate(given)


ComponentOfAnyShape = Annotated[SerializeAsAny[Component], BeforeValidator(_of_its_shape)]


class Material(Table):
    """A reflection model and its numbers; those that the scene leaves out come from ``preset``."""

    of_the_table: ClassVar[tuple[str, ...]] = ("model", "preset")
    model: str = "ashikhmin-shirley"
    preset: str | None = None
    parameters: dict[str, Constant] = Field(default_factory=dict)

    @classmethod
    def unknown_keys(cls, data: Mapping[str, Any]) -> list[Unknown]:
        """Those that the law has in none of its forms; none where the law itself is unknown or told in two ways, which
        is told later."""
        default = cls.model_fields["model"].default
        with contextlib.suppress(InputError):
            default = preset(str(data["preset"]))[0] if "preset" in data else default
        law = data.get("model", default)
        if not isinstance(law, str) or law not in brdf.MODELS or ("preset" in data and law != default):
            return []
        forms = brdf.MODELS[law].forms()
        numbers = list(dict.fromkeys(key for form in forms for key in form.keys_known()))
        return [
            Unknown(str(key), numbers, of=law) for key in data if key not in (*numbers, *cls.of_the_table)
        ]

    @model_validator(mode="before")
    @classmethod
    def _gather_parameters(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        own = {key: value for key, value in data.items() if key in cls.of_the_table}
        return {**own, "parameters": {key: value for key, value in data.items() if key not in own}}


def _parameter_key(key: str) -> str:
    if key != "zero_point" and PARAMETER_KEY.fullmatch(key) is None:
        raise Unknown("", ["zero_point", "band_sun_magnitude", '"effect.parameter"'], typed=key).problem()
    return key


class Model(Table):
    """What the model holds. ``effects`` None: the known physics that the data allow; an empty list: none."""

    effects: list[str] | None = None
    parameters: dict[Annotated[str, AfterValidator(_parameter_key)], Number] = Field(default_factory=dict)
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
