"""Other laws of reflection for the surfaces of a scene: tried where no effect explains a mismatch under the
scene's own, for a lobe of another shape bends every refit."""

from __future__ import annotations

from torchlc.scene import Scene
from torchlc.scene.numbers import Free
from torchlc.scene.parts import Material

OTHER_LAWS = {
    "ggx": {
        "alpha": Free(value=0.2, low=1e-3, high=1.0, prior="loguniform"),
        "f0": Free(value=0.2, low=0.0, high=1.0),
    },
    "cook-torrance": {
        "m": Free(value=0.2, low=1e-3, high=1.0, prior="loguniform"),
        "f0": Free(value=0.2, low=0.0, high=1.0),
    },
}
"""Microfacets with a long and with a short tail, and the numbers of their lobes."""


def under_other_laws(scene: Scene) -> dict[str, Scene]:
    """The scene with every lobe that has free numbers following another law, by the law's name.

    Lobes start anew, without what the scene says of them; the diffuse reflectance is kept.
    """
    scenes = {}
    for law, lobe in OTHER_LAWS.items():
        materials = {
            name: Material.model_construct(
                model=law, preset=None, parameters={**lobe, "r_diff": material.parameters["r_diff"]}
            )
            if material.model == "ashikhmin-shirley"
            and any(isinstance(number, Free) for number in material.parameters.values())
            and "r_diff" in material.parameters
            else material
            for name, material in scene.materials.items()
        }
        if any(material.model == law for material in materials.values()):
            scenes[law] = scene.model_copy(update={"materials": materials})
    return scenes
