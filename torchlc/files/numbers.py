"""The atoms of a scene: strict tables, numbers that are fixed or free, vectors and names."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic.functional_validators import ModelWrapValidatorHandler
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

MOST_NAME, MOST_TITLE = 100, 300
"""Characters of a name, which stands in tables and figures, and of a scene's title."""
CONTROLS = ("Cc", "Cs", "Zl", "Zp")
"""Unicode's categories of control characters, surrogates and separators of lines."""
FIXED, FREE = "#fixed", "#free"
WHOLE, SIDES = "#whole", "#sides"
SINGLE, SEVERAL = "#single", "#several"
"""Tags of the two forms of a number, of a mesh's directions, and of epochs; they never reach a person."""

LARGEST, SMALLEST = 1e30, 1e-30
"""Of a number, and of a standard deviation: their squares are still numbers."""
Real = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]


def problem(found: str, expected: str, key: str = "", hint: str = "") -> PydanticCustomError:
    """An error in our own words; ``key`` is the entry below the table at fault."""
    return PydanticCustomError(
        "torchlc", "{found}", {"found": found, "expected": expected, "key": key, "hint": hint}
    )


@dataclass(frozen=True)
class Unknown:
    """A key that a table may not have, those that it may, and ``of`` what these are. ``typed`` is what the person wrote where
    the place of the problem names the key already.
    """

    key: str
    allowed: Sequence[str]
    of: str = ""
    typed: str = ""

    def problem(self) -> PydanticCustomError:
        of = f" ({self.of})" if self.of else ""
        expected = f"one of {', '.join(self.allowed)}{of}"
        context = {
            "key": self.key,
            "typed": self.typed or self.key,
            "allowed": list(self.allowed),
            "expected": expected,
        }
        return PydanticCustomError("unknown_key", "unknown key", context)


def _again(detail: ErrorDetails) -> InitErrorDetails:
    """A problem as it can be raised with others."""
    kind, context = detail["type"], detail.get("ctx", {})
    ours = kind in ("torchlc", "unknown_key")
    problem = PydanticCustomError(kind, detail["msg"], context) if ours else kind  # type: ignore[arg-type]
    return InitErrorDetails(type=problem, loc=detail["loc"], input=detail["input"], ctx=context)


class Table(BaseModel):
    """A TOML table: immutable, no key beyond those known, all others told at once."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def unknown_keys(cls, data: Mapping[str, Any]) -> list[Unknown]:
        """Those of ``data`` that no such table has."""
        return [Unknown(str(key), list(cls.model_fields)) for key in data if key not in cls.model_fields]

    @model_validator(mode="wrap")
    @classmethod
    def _keys_are_known(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """What else is wrong with the table is told beside its unknown keys."""
        unknown = cls.unknown_keys(data) if isinstance(data, dict) else []
        if not unknown:
            return handler(data)
        problems = [InitErrorDetails(type=stranger.problem(), input=None) for stranger in unknown]
        strangers = {stranger.key for stranger in unknown}
        try:
            handler({key: value for key, value in data.items() if str(key) not in strangers})
        except ValidationError as error:
            problems += map(_again, error.errors(include_url=False))
        raise ValidationError.from_exception_data(cls.__name__, problems)


class Free(Table):
    """A number to be fitted: where to start and what is believed of it before the data.

    ``sigma`` is the standard deviation of a normal prior centred on ``value``, that of the logarithm for a
    lognormal one with median ``value``, the scale of a halfnormal one, or half the width that holds half of a cauchy one. ``low`` and ``high`` truncate it; a
    bound that the scene leaves open is the physical one where there is one. An isotropic prior is for the latitude
    of a direction, deg, from pole to pole unless bounds are given.

    ``per`` divides the number: a value for each curve, station, night or object. ``values`` says by its name where each of
    these starts, and is centred, in place of ``value``; without bounds and sigma they are fixed there.
    """

    value: Real
    low: Real | None = None
    high: Real | None = None
    sigma: Annotated[Real, Field(ge=SMALLEST)] | None = None
    prior: Literal["uniform", "loguniform", "isotropic", "normal", "lognormal", "halfnormal", "cauchy"] = (
        "uniform"
    )
    per: Literal["curve", "station", "night", "object"] | None = None
    values: dict[str, Real] | None = None

    @property
    def fixed(self) -> bool:
        """Whether it is a value for each of ``per``, none of which is free."""
        return self.values is not None and self.sigma is self.low is self.high is None

    @property
    def starts(self) -> tuple[float, ...]:
        """Every value that it may start at."""
        return (self.value, *(self.values or {}).values())

    def of(self, member: str) -> Free:
        """The number of one of ``per``, by its name."""
        value = (self.values or {}).get(member, self.value)
        return self.model_copy(update={"value": value, "values": None, "per": None})

    @model_validator(mode="before")
    @classmethod
    def _default_prior(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        if "prior" not in data and data.get("sigma") is not None:
            return {**data, "prior": "normal"}
        return {"low": -90.0, "high": 90.0, **data} if data.get("prior") == "isotropic" else data

    @model_validator(mode="after")
    def _is_a_prior(self) -> Free:
        if self.values is not None and self.per is None:
            raise problem("values without per", 'per = "night", say, of which each has its value', "values")
        if self.fixed and self.model_fields_set.isdisjoint({"prior", "low", "high", "sigma"}):
            return self
        both = self.low is not None and self.high is not None
        if self.sigma is None and not both:
            raise problem(
                "only a value" if self.low is self.high else "one bound only", "low and high, or sigma"
            )
        if both and not self.low < self.high:  # type: ignore[operator]
            raise problem(f"low {self.low:g} and high {self.high:g}", "low < high")
        if self.prior in ("uniform", "loguniform", "isotropic"):
            if self.sigma is not None:
                raise problem(
                    f"a sigma with a {self.prior} prior", 'low and high alone, or prior = "normal"', "sigma"
                )
            if not both:
                raise problem("missing bounds", f"low and high for a {self.prior} prior", "prior")
        elif self.sigma is None:
            raise problem("no sigma", f"a sigma for a {self.prior} prior", "prior")
        if self.prior == "isotropic":
            for key, bound in (("low", self.low), ("high", self.high)):
                if not -90.0 <= bound <= 90.0:  # type: ignore[operator]
                    raise problem(f"{bound:g}", "-90 to 90, a latitude, for an isotropic prior", key)
        if self.prior == "loguniform" and not self.low > 0:  # type: ignore[operator]
            raise problem(f"{self.low:g}", "> 0 for a loguniform prior", "low")
        for key, value in _starts(self):
            self._may_start_at(key, value)
        return self

    def _may_start_at(self, key: str, value: float) -> None:
        if self.prior == "lognormal" and not (value > 0 and (self.low is None or self.low >= 0)):
            raise problem(f"{value:g}", "> 0, with low >= 0, for a lognormal prior", key)
        if self.prior == "halfnormal" and not value >= max(0.0, self.low or 0.0):
            raise problem(f"{value:g}", ">= 0 for a halfnormal prior", key)
        low, high = -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high
        if not low <= value <= high:
            raise problem(f"{value:g}", f"between low {low:g} and high {high:g}", key)


def _starts(number: Free) -> list[tuple[str, float]]:
    """Where a number may start, by the key that says so."""
    return [
        ("value", number.value),
        *((f'values."{name}"', value) for name, value in (number.values or {}).items()),
    ]


def _fixed_or_free(data: Any) -> str:
    return FREE if isinstance(data, dict | Free) else FIXED


Number = Annotated[
    Annotated[Real, Tag(FIXED)] | Annotated[Free, Tag(FREE)],
    Discriminator(_fixed_or_free),
]


def value_of(number: float | Free) -> float:
    return number.value if isinstance(number, Free) else number


def within(number: float | Free, low: float, high: float, *, above: bool = False) -> float | Free:
    """``number`` if it cannot leave [low, high], open bounds filled in; ``above``: its value is not low."""
    expected = (f"> {low:g}" if above else f">= {low:g}") if high == math.inf else f"{low:g} to {high:g}"
    for key, value in _starts(number) if isinstance(number, Free) else [("", number)]:
        if not low <= value <= high or (above and value == low):
            raise problem(f"{value:g}", expected, key)
    if not isinstance(number, Free) or number.fixed:
        return number
    for key, bound in (("low", number.low), ("high", number.high)):
        if bound is not None and not low <= bound <= high:
            raise problem(f"{bound:g}", expected, key)
    return number.model_copy(
        update={
            "low": low if number.low is None and low > -math.inf else number.low,
            "high": high if number.high is None and high < math.inf else number.high,
        }
    )


def between(low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> AfterValidator:
    return AfterValidator(lambda number: within(number, low, high, above=above))


def _one_for_all(number: float | Free) -> float | Free:
    if isinstance(number, Free) and number.per is not None:
        expected = "one value for the whole recording, which sizes and materials have"
        raise problem(f'"{number.per}"', expected, "per")
    return number


def _direction(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not math.hypot(*vector) > 1e-9:
        raise problem(f"{list(vector)}", "a direction, not of length 0")
    return vector


def _name(text: str) -> str:
    if (
        not text
        or text != text.strip()
        or len(text) > MOST_NAME
        or not text.isprintable()
        or set(text) & set("[]")
    ):
        raise problem(
            repr(text[:40]),
            f"a name of 1 to {MOST_NAME} printable characters without brackets or outer blanks",
        )
    return text


def _title(text: str) -> str:
    if len(text) > MOST_TITLE or any(unicodedata.category(sign) in CONTROLS for sign in text):
        raise problem(repr(text[:40]), f"at most {MOST_TITLE} characters, in one line, none for control")
    return text


Positive = Annotated[Number, between(0.0, above=True)]
Constant = Annotated[Number, AfterValidator(_one_for_all)]
"""A number that is one for the whole recording."""
Size = Annotated[Constant, between(0.0, above=True)]
Vector = tuple[Real, Real, Real]
Direction = Annotated[tuple[Real, Real, Real], AfterValidator(_direction)]
Name = Annotated[str, AfterValidator(_name)]
Title = Annotated[str, AfterValidator(_title)]
