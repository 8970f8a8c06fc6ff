"""The extinction that was taken out of the magnitudes was not the true one."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import PASS, Shown

LEAST_SPREAD = 1e-3
"""Of the airmass: its slope could not be told from the zero point, for 1 mag an airmass would be 1e-3 mag."""


class ExtinctionResidual(Effect):
    """Adds mag_per_airmass (X - 1): 0.08 mag for 0.05 over a MEO pass from X = 1.1 to 2.7.

    X is the airmass of Kasten & Young (1989). Neglects the colour of the object (second-order extinction)
    and changes of the sky during the night.
    """

    name = "extinction_residual"
    title = "extinction that was corrected with a wrong coefficient"
    shown = Shown(PASS, "airmass", {"mag_per_airmass": 0.1})
    stage = "detector"
    divisible = True
    order = 2
    quantities = (
        Quantity(
            "mag_per_airmass", "mag/airmass", -1.0, 1.0, "true less assumed extinction coefficient",
            off=0.0, typical=0.05, prior="normal", mean=0.0, sigma=0.05,
        ),
    )  # fmt: skip

    def missing(self, context):
        if context.airmass is None:
            return "the airmass is unknown"
        if float(context.airmass.max() - context.airmass.min()) < LEAST_SPREAD:
            return "the airmass does not change"
        return None

    def detector(self, brightness, p, context):
        assert context.airmass is not None  # see `missing`
        fainter = p["mag_per_airmass"] * (context.airmass.to(brightness.flux) - 1)
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * fainter))
