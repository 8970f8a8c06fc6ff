"""The detector answers less than linearly to bright light."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, Shown


class Saturation(Effect):
    """F (1 - q F/F_max), then cut at limit F_max: q = 3 % is 0.03 mag at the peak.

    F_max is the brightest row of the model, so that a limit of 1 or more cuts nothing. Neglects that counts
    also depend on seeing and exposure time, and a full well's soft shoulder.
    """

    name = "saturation"
    title = "a detector that saturates"
    shown = Shown(NIGHT, "flux", {"q": 0.05, "limit": 0.8})
    stage = "detector"
    order = 1
    quantities = (
        Quantity(
            "q", "", -0.1, 0.5, "share of the light lost at the brightest row",
            off=0.0, typical=0.03, prior="normal", mean=0.0, sigma=0.05,
        ),
        Quantity("limit", "", 0.05, 1.5, "largest flux recorded over F_max", off=1.1, typical=0.9),
    )  # fmt: skip

    def detector(self, brightness, p, context):
        flux = brightness.flux
        brightest = flux.amax(-1, keepdim=True)
        share = flux / torch.where(brightest > 0, brightest, 1.0)
        return replace(brightness, flux=torch.minimum(flux * (1 - p["q"] * share), p["limit"] * brightest))
