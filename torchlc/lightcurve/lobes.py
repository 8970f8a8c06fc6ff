"""How sharp the lobes of a scene's materials can be: facets of curved surfaces are as fine as these need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.parameters import EXPONENT, WIDTH
from torchlc.scene import Free as SceneFree
from torchlc.scene import Scene
from torchlc.shapes import Part
from torchlc.shapes.smooth import Smooth

RESOLVED_N = 1e4
"""Lobes are expected to be as sharp as this, or as a smaller upper bound of the exponent."""
WIDE = 200.0
"""Exponent of a lobe as wide as one of m = 0.1, below which edges within it cost more than 0.002 mag."""


def uneven(scene: Scene, material: str) -> bool:
    """Whether a material's lobe may be wider along u than along v."""
    given, shared = scene.materials[material].parameters, MODELS[scene.materials[material].model].shared
    widths = [[given[name] for name in long] for short, long in shared.items() if short not in given]
    return any(isinstance(width, SceneFree) or width != several[0] for several in widths for width in several)


def finest_lobes(scene: Scene, sharpest: float = math.inf) -> dict[str, float]:
    """The largest exponent of each material's lobe: of a free one the upper bound, up to ``sharpest``."""
    finest = {}
    for name, material in scene.materials.items():
        bounds = [1.0]
        law = MODELS[material.model]
        for key, number in material.parameters.items():
            role = law.quantity(key).role
            if role == EXPONENT:
                if isinstance(number, SceneFree):
                    top = number.high if number.high is not None else number.value + 3 * (number.sigma or 0.0)
                    bounds.append(min(top, max(sharpest, number.value)))
                else:
                    bounds.append(number)
            elif role == WIDTH:
                width = number.value if isinstance(number, SceneFree) else number
                bounds.append(min(exponent_of(role, width) or 1.0, sharpest))
        finest[name] = max(bounds)
    return finest


def exponent_of(role: str | None, number: float) -> float | None:
    """The exponent of a lobe that a number of its role makes; None if it makes none."""
    if role == EXPONENT:
        return number
    return 2 / max(number, 1e-3) ** 2 if role == WIDTH else None


def edges_within_lobes(
    parts: Sequence[Part], models: Mapping[str, type[Brdf]], lobes: Mapping[str, float]
) -> list[str]:
    """What has to be said of curved surfaces of a law whose light has edges within a wide lobe."""
    return [
        f"{part.name}: the masking of V-shaped cavities ({material}) has edges within so wide a lobe. The light of a curved "
        "surface is within 0.006 mag (rms), single rows 0.02 mag; that of ggx, or of a smaller m, within 0.002 mag (rms)"
        for part in parts
        if isinstance(part, Smooth)
        for material in sorted(set(part.materials))
        if models[material].edged and lobes[material] < WIDE
    ]
