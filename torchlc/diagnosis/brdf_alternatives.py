"""Other laws of reflection for the surfaces of a scene: tried where no effect explains a mismatch under the
scene's own, for a lobe of another shape bends every refit."""

from __future__ import annotations

from collections.abc import Mapping

from torchlc.brdf import MODELS, Brdf
from torchlc.files.numbers import Free
from torchlc.parameters import LOBE_ROLES
from torchlc.scene import Scene
from torchlc.scene.parts import Material


def under_other_laws(scene: Scene) -> dict[str, Scene]:
    """The scene with every lobe that has free numbers following another law, by the law's name: of each law that
    declares itself an ``alternative``.

    Lobes start anew, without what the scene says of them; the other numbers are kept, which the new law has to share.
    """
    scenes = {}
    for name, law in MODELS.items():
        if not law.alternative:
            continue
        materials = {key: _under(law, material) for key, material in scene.materials.items()}
        if any(materials[key] is not scene.materials[key] for key in materials):
            scenes[name] = scene.model_copy(update={"materials": materials})
    return scenes


def _under(law: type[Brdf], material: Material) -> Material:
    """A material under another law; itself where that cannot stand in for its own."""
    own = MODELS[material.model]
    if law in own.forms() or own.form_of == law.model:
        return material
    lobe, rest = _parted(own, material.parameters)
    if not lobe or not any(isinstance(number, Free) for number in material.parameters.values()):
        return material
    if {*law.alternative, *rest} != {quantity.name for quantity in law.quantities}:
        return material
    parameters = {key: _free(law, key, start) for key, start in law.alternative.items()} | rest
    return Material.model_construct(model=law.model, preset=None, parameters=parameters)


def _parted(
    law: type[Brdf], numbers: Mapping[str, float | Free]
) -> tuple[dict[str, float | Free], dict[str, float | Free]]:
    """A material's numbers: those of its lobe, and the others."""
    lobe = {key: number for key, number in numbers.items() if law.quantity(key).role in LOBE_ROLES}
    return lobe, {key: number for key, number in numbers.items() if key not in lobe}


def _free(law: type[Brdf], key: str, start: float) -> Free:
    quantity = law.quantity(key)
    prior = "loguniform" if quantity.prior == "loguniform" else "uniform"
    return Free(value=start, low=quantity.low, high=quantity.high, prior=prior)
