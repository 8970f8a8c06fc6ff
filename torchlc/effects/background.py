"""Light that does not come from the object was left in the aperture, or too much was taken out."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, Shown


def median(flux: torch.Tensor) -> torch.Tensor:
    """Median over the rows of (..., T), kept as (..., 1); the mean of the middle two of an even number."""
    ordered = flux.sort(-1).values
    middle = (flux.shape[-1] - 1) // 2, flux.shape[-1] // 2
    return 0.5 * (ordered[..., middle[0], None] + ordered[..., middle[1], None])


class Background(Effect):
    """Constant extra light, a fraction of the model's median flux: 5 % is 0.05 mag at the median, none at a
    glint.

    Negative where too much sky was taken out, so that a row may have no light left. Neglects that a sky
    changes and that stars pass.
    """

    name = "background"
    title = "constant light that is not the object's"
    shown = Shown(NIGHT, "inverse_flux", {"fraction": 0.1})
    stage = "detector"
    divisible = True
    quantities = (
        Quantity(
            "fraction", "", -0.9, 3.0, "constant light over the median flux of the model",
            off=0.0, typical=0.05, prior="normal", mean=0.0, sigma=0.1,
        ),
    )  # fmt: skip

    def detector(self, brightness, p, context):
        return replace(brightness, flux=brightness.flux + p["fraction"] * median(brightness.flux))
