"""One component has another colour than the stars that calibrate the magnitudes."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, Shown


class ColorTerm(Effect):
    """Adds mag times the component's share of the light: 0.02 to 0.15 mag as a panel's glint takes over.

    Neglects second-order extinction, the part of a colour term that grows with airmass.
    """

    name = "color_term"
    title = "components that differ in colour"
    shown = Shown(NIGHT, "share of panel +Y", {"mag": 0.2}, "panel +Y")
    stage = "detector"
    per = "component"
    order = 2
    needs_shares = True
    quantities = (
        Quantity(
            "mag", "mag", -1.0, 1.0, "added where all light is the component's",
            off=0.0, typical=0.1, prior="normal", mean=0.0, sigma=0.1,
        ),
    )  # fmt: skip
    unable = "the object has one component: its colour is a zero point"

    @classmethod
    def targets(cls, context):
        names = super().targets(context)
        return names if len(names) > 1 else []

    def detector(self, brightness, p, context):
        assert brightness.shares is not None and self.target is not None  # by `needs_shares` and `per`
        share = brightness.shares[..., list(brightness.components).index(self.target), :]
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * p["mag"] * share))
