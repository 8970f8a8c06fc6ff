"""A physical parameter as its class declares it: unit, bounds, meaning, the size worth suspecting, and its role."""

from __future__ import annotations

from dataclasses import dataclass

REFLECTANCE, LOBE_REFLECTANCE, FRESNEL = "reflectance", "reflectance of the lobe", "Fresnel reflectance"
EXPONENT, WIDTH, INDEX, SHARE = "exponent", "width", "refractive index", "share"
ROLES = {
    REFLECTANCE: "of diffuse light, or of all light: a factor of it",
    LOBE_REFLECTANCE: "a factor of the light of the lobe",
    FRESNEL: "reflectance at normal incidence: light of the lobe is linear in it, but it is no factor",
    EXPONENT: "of the cosine whose power the lobe is",
    WIDTH: "of the lobe: roughness, or slope of microfacets",
    INDEX: "of refraction, from which the lobe's reflectance follows",
    SHARE: "of an area that is another material: beyond one half the other is the first",
}


@dataclass(frozen=True)
class Quantity:
    """A physical parameter, declared once beside its physics.

    ``low`` and ``high`` are its bounds in ``unit``; ``off`` is the value at which it has no effect at all,
    ``typical`` the size worth suspecting; ``prior`` (one of PRIORS) is the default, with ``mean`` and ``sigma``.
    A latitude in degrees whose direction may point anywhere alike declares ``isotropic``. What has a value ``unless_set``
    keeps it where the scene says nothing. Where an offset is divided and its values are alike but for a few, which may lie anywhere
    within the bounds, ``apart`` is the width of the Cauchy distribution of these. ``role`` says what kind of number it is, where that decides how it is
    searched, sampled or judged: one of ROLES.
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
    unless_set: float | None = None
    role: str = ""
    apart: float | None = None

    def __post_init__(self) -> None:
        if self.role and self.role not in ROLES:
            raise ValueError(f"{self.name}: role {self.role!r}; expected one of {', '.join(ROLES)}")
