"""What every reflection model shares: bounded learnable values, the evaluation contract.

Shapes: T epochs, K = facets x quadrature nodes, ``...`` any batch; the last axis of a direction is 3.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchlc.brdf.angles import Incidence, incidence
from torchlc.errors import InputError
from torchlc.naming import Registry
from torchlc.parameters import Quantity

MODELS: Registry[type[Brdf]] = Registry("law of reflection")
"""Every reflection model by the name a scene uses; a class enters by being defined."""


class Brdf(nn.Module):
    """A reflection model with learnable values that cannot leave their bounds, whatever an optimiser does.

    ``AshikhminShirley(n=200.0, r_spec=0.05, r_diff=0.05)`` holds one unconstrained ``nn.Parameter`` per
    value (``raw_n``, ...): the logit of its place between the bounds, on a logarithmic scale for exponents
    and widths. Values that share one unit of light (``simplex``) break a stick in turn, r_spec =
    sigmoid(a), r_diff = (1 - r_spec) sigmoid(b). A learnable value on a bound is moved inside by 1e-9; with
    ``learnable=False`` every value is kept exactly, as a buffer. Numbers may be tensors of one batch shape.

    A model adds ``quantities`` and two pure functions, ``tabulate`` and ``parts``; all evaluation goes
    through them. One that learns makes its modules in ``build``, and its ``parts`` is a method that uses them.
    """

    model: ClassVar[str]
    quantities: ClassVar[tuple[Quantity, ...]]
    simplex: ClassVar[tuple[str, ...]] = ()
    coupled: ClassVar[bool] = False
    """True if the diffuse part is in proportion to the last of ``simplex`` times one minus the first: what the lobe leaves."""
    """Names of the values whose sum may not exceed 1."""
    shared: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """A name that stands for several quantities at once."""
    along_axes: ClassVar[tuple[str, ...]] = ()
    """Quantities along a facet's u and v axes; given apart, the material is anisotropic and the axes matter."""
    defaults: ClassVar[Mapping[str, float]] = {}
    form_of: ClassVar[str] = ""
    """The law under whose name a scene may ask for this one too, by the keys that it gives."""
    curved: ClassVar[tuple[str, ...]] = ()
    """Reflectances in which light is not linear, for more than one factor of them is in it."""
    rivals: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    """Laws of another shape of lobe that a diagnosis tries in the place of this one, with where their lobes start."""
    condensed_over: ClassVar[str] = ""
    """The one number of the lobe over which ``condense`` tabulates its sums, by the name that a scene gives it."""
    radiance_as_irradiance: ClassVar[bool] = False
    """True if its radiance is the irradiance times a number, in all directions."""
    edged: ClassVar[bool] = False
    """True if light has an edge within a wide lobe, where its slope jumps or it ends all but at once, which points on a curved surface do not
    follow."""
    additive: ClassVar[bool] = False
    """True if the tables of two sets of facets can be added, so that a mesh is tabulated piece by piece."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        MODELS.declared(cls, "model")

    def __init__(
        self,
        *,
        learnable: bool = True,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str | None = None,
        **numbers: float | Tensor,
    ) -> None:
        super().__init__()
        self.build()
        self.learnable = learnable
        natural = {
            name: torch.as_tensor(number, dtype=dtype, device=device).detach().clone()
            for name, number in {**self.defaults, **numbers}.items()
        }
        self.names = self.check(natural)
        natural = {name: natural[name] for name in self.names}
        if learnable:
            for name, value in self.to_raw(natural).items():
                self.register_parameter(f"raw_{name}", nn.Parameter(value))
        else:
            for name, value in natural.items():
                self.register_buffer(f"fixed_{name}", value)

    def build(self) -> None:
        """Make what the law learns beside its values: modules that ``parts`` uses. The tables of ``tabulate`` are kept,
        so that it has to do without them."""

    @classmethod
    def of_material(cls) -> type[Brdf]:
        """The law as a light curve uses it for one material: itself, or, where it learns, an object that answers as the
        class does and has modules of its own."""
        if cls.build is Brdf.build:
            return cls
        law = cls.__new__(cls)
        nn.Module.__init__(law)
        law.names, law.learnable = (), False
        law.build()
        return law  # pyright: ignore[reportReturnType]

    @classmethod
    def forms(cls) -> list[type[Brdf]]:
        """This law and those that a scene may ask for under its name: what is in all of them is no choice."""
        return [cls, *(other for other in MODELS.values() if other.form_of == cls.model)]

    @classmethod
    def keys_known(cls) -> tuple[str, ...]:
        """Names of its numbers, long and shared."""
        return (*cls.shared, *(quantity.name for quantity in cls.quantities))

    @classmethod
    def quantity(cls, name: str) -> Quantity:
        """The quantity called ``name``; a shared name answers with the first it stands for."""
        wanted = cls.shared[name][0] if name in cls.shared else name
        return next(quantity for quantity in cls.quantities if quantity.name == wanted)

    @classmethod
    def anisotropic(cls, numbers: Mapping[str, Any]) -> bool:
        """Whether a facet's u axis matters to a material of these ``numbers``, fixed or free, by name: what lies
        along u and v is given apart, and is not one fixed number."""
        apart = [numbers[name] for name in cls.along_axes if name in numbers]
        return len(apart) > 1 and not (
            all(isinstance(number, int | float) for number in apart) and len(set(apart)) == 1
        )

    @classmethod
    def check(cls, values: Mapping[str, Tensor]) -> tuple[str, ...]:
        """Names of ``values`` in declared order; InputError if one is missing, unknown or out of bounds."""
        order = [quantity.name for quantity in cls.quantities]
        for short, long in cls.shared.items():
            if short in values:
                order = [short if name == long[0] else name for name in order if name not in long[1:]]
        for name in values:
            if name not in order:
                raise InputError(
                    None, f"{cls.model}.{name}", "unknown parameter", f"one of {', '.join(order)}"
                )
        for name in order:
            if name not in values:
                raise InputError(None, f"{cls.model}.{name}", "missing", cls.quantity(name).meaning)
            low, high = cls.quantity(name).low, cls.quantity(name).high
            if not bool(((values[name] >= low) & (values[name] <= high)).all()):
                raise InputError(
                    None, f"{cls.model}.{name}", f"{values[name].tolist()}", f"{low:g} to {high:g}"
                )
        if cls.simplex:
            total = torch.stack(torch.broadcast_tensors(*(values[name] for name in cls.simplex))).sum(0)
            if bool((total > 1 + 1e-12).any()):
                raise InputError(
                    None, cls.model, f"{' + '.join(cls.simplex)} = {total.tolist()}", "at most 1"
                )
        return tuple(order)

    @classmethod
    def to_raw(cls, natural: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Unconstrained numbers from natural values in declared order; a value on a bound moves inside."""
        raw, left = {}, 1.0
        for name, value in natural.items():
            margin = max(1e-9, 2 * torch.finfo(value.dtype).eps)
            in_stick = name in cls.simplex
            share = (value / left if in_stick else _to_unit(cls.quantity(name), value)).clamp(
                margin, 1 - margin
            )
            raw[name] = torch.logit(share)
            left = left * (1 - share) if in_stick else left
        return raw

    @classmethod
    def from_raw(cls, raw: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Natural values from unconstrained numbers in declared order, within the bounds for any input."""
        natural, left = {}, 1.0
        for name, number in raw.items():
            share = torch.sigmoid(number)
            in_stick = name in cls.simplex
            natural[name] = left * share if in_stick else _from_unit(cls.quantity(name), share)
            left = left * (1 - share) if in_stick else left
        return natural

    def values(self) -> dict[str, Tensor]:
        """Natural values by quantity name; a shared value appears under each name as the same tensor."""
        if self.learnable:
            natural = self.from_raw({name: getattr(self, f"raw_{name}") for name in self.names})
        else:
            natural = {name: getattr(self, f"fixed_{name}") for name in self.names}
        return {long: value for name, value in natural.items() for long in self.shared.get(name, (name,))}

    def __getattr__(self, name: str) -> Any:
        long = self.shared.get(name, (name,))[0]
        if any(quantity.name == long for quantity in self.quantities):
            return self.values()[long]
        return super().__getattr__(name)

    def extra_repr(self) -> str:
        values = {name: value.detach() for name, value in self.values().items()}
        texts = []
        for name in self.names:
            value = values[self.shared.get(name, (name,))[0]]
            texts.append(f"{name}={value.item():.6g}" if value.ndim == 0 else f"{name}={tuple(value.shape)}")
        return ", ".join([*texts, "learnable" if self.learnable else "fixed"])

    @staticmethod
    @abstractmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        """All that is free of the material's values, summed over K where the model is linear.

        ``angles`` and ``weight`` (K, T): weight = area x visible fraction x irradiance / range^2, and 0 for
        a pair that is not lit and seen, which then adds nothing to value or gradient.
        """

    @staticmethod
    @abstractmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Lobe and diffuse flux (..., T): sum over K of weight f_r mu0 mu, eqs. 8-10; values are (...).

        ``spread`` (K, T) in the table, if it is there, is the least variance, rad^2, that a lobe is given.
        """

    @staticmethod
    def condense(table: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The table with the lobe's sums over K as functions of the number ``condensed_over``, which ``parts`` takes too."""
        raise TypeError("the lobe of this law has no table over a number")

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        """Variance of the lobe in the glint angle per in-plane axis, rad^2, (...); inf without a lobe."""
        return torch.full_like(next(iter(values.values())), math.inf)

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        """Values after the normals are spread by ``variance``, rad^2 per axis, added in the lobe's core."""
        return dict(values)

    def forward(self, normal: Tensor, u: Tensor, to_sun: Tensor, to_observer: Tensor) -> Tensor:
        """f_r, 1/sr, (batch of values..., batch of directions...); 0 if the facet is not lit and seen."""
        angles = incidence(normal, u, to_sun, to_observer)
        lit = angles.lit_and_seen
        weight = torch.where(lit, 1 / torch.where(lit, angles.cos_i * angles.cos_r, 1.0), 0.0)
        row = angles.flattened()
        values = self.values()
        specular, diffuse = self.parts(self.tabulate(row, weight.reshape(1, -1)), values)
        batch = np.broadcast_shapes(*(value.shape for value in values.values()))
        return (specular + diffuse).reshape((*batch, *weight.shape))


def _offset(quantity: Quantity) -> float:
    """A logarithmic scale that includes zero is that of 1 + value."""
    return 0.0 if quantity.low > 0 else 1.0


def _to_unit(quantity: Quantity, value: Tensor) -> Tensor:
    """Where ``value`` lies between the bounds, 0 to 1."""
    if quantity.prior != "loguniform":
        return (value - quantity.low) / (quantity.high - quantity.low)
    low, high = (bound + _offset(quantity) for bound in (quantity.low, quantity.high))
    return torch.log((value + _offset(quantity)) / low) / math.log(high / low)


def _from_unit(quantity: Quantity, share: Tensor) -> Tensor:
    if quantity.prior != "loguniform":
        natural = quantity.low + (quantity.high - quantity.low) * share
    else:
        low, high = (bound + _offset(quantity) for bound in (quantity.low, quantity.high))
        natural = low * torch.exp(share * math.log(high / low)) - _offset(quantity)
    return natural.clamp(quantity.low, quantity.high)
