"""Parameters: what each number means, its prior, and the map between natural values and the unconstrained space of Adam."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A physical parameter, declared once beside its physics.

    ``low`` and ``high`` are its bounds in ``unit``; ``off`` is the value at which it has no effect at all, ``typical`` the size
    worth suspecting; ``prior`` (uniform, loguniform, normal, halfnormal, lognormal) is the default, with ``mean`` and ``sigma``.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    off: float | None = None
    typical: float | None = None
    prior: str = "uniform"
    mean: float | None = None
    sigma: float | None = None
