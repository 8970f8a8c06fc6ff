"""The Sun's irradiance falls with the square of its distance."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.geometry.orbit.earth import AU_KM
from torchlc.stages.effect import Effect
from torchlc.stages.showing import YEAR, Shown


class SunDistance(Effect):
    """Sunlight at the object's true distance d, (1 au / d)^2; at 1 au it is wrong by up to 0.036 mag over
    the year.

    Neglects the Sun's own variation, 0.001 mag.
    """

    name = "sun_distance"
    title = "the changing distance of the Sun"
    shown = Shown(YEAR, "distance of the Sun, au")
    stage = "light"
    known = True

    def light(self, lights, view, p, context):
        factor = (AU_KM / torch.linalg.vector_norm(view.state.sun, dim=-1)) ** 2
        return tuple(replace(light, irradiance=light.irradiance * factor) for light in lights)
