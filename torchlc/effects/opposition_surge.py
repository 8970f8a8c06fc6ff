"""Rough surfaces brighten towards zero phase angle."""

from __future__ import annotations

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, Shown


class OppositionSurge(Effect):
    """Diffuse light times 1 + b0 / (1 + tan(phase/2) / h), the shadow-hiding term of Hapke (2002).

    0.07 mag between phase angles of 17 and 60 deg at b0 = 0.5, h = 0.05. Neglected: the loss of energy
    balance, and light that does not come from the Sun, which has another phase angle.
    """

    name = "opposition_surge"
    title = "more light where the Sun is behind the observer"
    shown = Shown(NIGHT, "phase_angle_deg", {"b0": 0.8, "h": 0.05}, "body")
    stage = "material"
    order = 3
    per = "material"
    quantities = (
        Quantity("b0", "", 0.0, 1.0, "height of the surge over the diffuse light", off=0.0, typical=0.5),
        Quantity("h", "", 0.01, 0.2, "tangent of half the phase angle at which it has halved", typical=0.05),
    )

    def material(self, reflect, surface, values, p):
        if not surface.sunlit:
            return reflect
        surge = 1 + p["b0"] / (1 + torch.tan(0.5 * surface.phase_angle) / p["h"])

        def surging(material):
            specular, diffuse = reflect(material)
            return specular, diffuse * surge

        return surging
