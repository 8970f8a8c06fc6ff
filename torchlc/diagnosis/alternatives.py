"""Scenes that a scene may have meant: surfaces of another law of reflection, for a lobe of another shape bends every refit;
and sizes that are only nominal, which stand for area that an effect adds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchlc.brdf.base import MODELS
from torchlc.files.numbers import Free
from torchlc.parameters import REFLECTANCE, Quantity
from torchlc.scene import Scene
from torchlc.scene.parts import Material

LEAST_OF_START = 1e-3
"""Share of its start down to which a number is searched by its logarithm, where the law's own bound is 0: at a thousandth,
a lobe of any exponent below 1000 is as wide as the hemisphere."""
SIZES = ("size", "radius", "length")
SIGMA = 0.1
"""What is believed of a size that the scene gives as certain: this share of it."""
NOMINAL = "nominal sizes"


def with_free_sizes(scene: Scene) -> Scene | None:
    """The scene with a normal prior about each size that it gives as certain; None where there is none."""
    components = [
        part.model_copy(update={name: _freed(getattr(part, name)) for name in SIZES if hasattr(part, name)})
        for part in scene.components
    ]
    if components == list(scene.components):
        return None
    return scene.model_copy(update={"components": components})


def _freed(size: Any) -> Any:
    if isinstance(size, tuple):
        return tuple(_freed(part) for part in size)
    if isinstance(size, Free):
        return size
    return Free(value=size, low=0.5 * size, high=2.0 * size, sigma=SIGMA * size, prior="normal")


def under_other_laws(scene: Scene) -> dict[str, Scene]:
    """The scene with every lobe that has free numbers following another law, by the law's name: one that its own law
    counts among its ``rivals``.

    Lobes start anew, without what the scene says of them. So do diffuse reflectances that are free, for what is known of one holds under
    the law that it was found under: it takes what that law's lobe leaves. Those that are certain stay.
    """
    scenes = {}
    laws = dict.fromkeys(
        law for material in scene.materials.values() for law in MODELS[material.model].rivals
    )
    for law in laws:
        materials = {name: _under(law, material) for name, material in scene.materials.items()}
        if any(material is not scene.materials[name] for name, material in materials.items()):
            scenes[law] = scene.model_copy(update={"materials": materials})
    return scenes


def _under(law: str, material: Material) -> Material:
    """The material under a law, if that is a rival of its own and anything of it is free; else itself."""
    own = MODELS[material.model]
    kept = {
        name: _anew(number, own.quantity(name)) if isinstance(number, Free) else number
        for name, number in material.parameters.items()
        if own.quantity(name).role == REFLECTANCE
    }
    lobe = own.rivals.get(law)
    if (
        lobe is None
        or not kept
        or not any(isinstance(number, Free) for number in material.parameters.values())
    ):
        return material
    return Material.model_construct(model=law, preset=None, parameters={**_free(law, lobe), **kept})


def _anew(number: Free, quantity: Quantity) -> Free:
    """A reflectance of which nothing is known but its bounds."""
    return Free(value=number.value, low=quantity.low, high=quantity.high, per=number.per)


def _free(law: str, starts: Mapping[str, float]) -> dict[str, Free]:
    """Numbers of a law, free between their bounds."""
    free = {}
    for name, start in starts.items():
        quantity = MODELS[law].quantity(name)
        logarithmic = quantity.prior == "loguniform"
        low = max(quantity.low, start * LEAST_OF_START) if logarithmic else quantity.low
        free[name] = Free(
            value=start, low=low, high=quantity.high, prior="loguniform" if logarithmic else "uniform"
        )
    return free
