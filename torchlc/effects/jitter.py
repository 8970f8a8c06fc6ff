"""The quoted errors are too small."""

from __future__ import annotations

from dataclasses import replace

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect


class Jitter(Effect):
    """White noise in magnitudes, added in quadrature to every quoted error; 0.01 to 0.05 mag is usual.

    Neglects that scintillation grows with airmass and that faint rows may be noisier.
    """

    name = "jitter"
    stage = "noise"
    quantities = (
        Quantity(
            "mag", "mag", 0.0, 2.0, "added in quadrature to the errors",
            off=0.0, typical=0.02, prior="halfnormal", sigma=0.05,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.errors else "the errors are fitted, and jitter is part of them"

    def noise(self, noise, p, context):
        return replace(noise, jitter=p["mag"])
