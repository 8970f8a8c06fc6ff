"""The quoted errors are too small."""

from __future__ import annotations

import math

from torchlc.noise.kind import NoiseKind
from torchlc.parameters import Quantity
from torchlc.stages.showing import NIGHT, Shown


class Jitter(NoiseKind):
    """White noise in magnitudes, added in quadrature to every quoted error; 0.01 to 0.05 mag is usual.

    Neglects that scintillation grows with airmass and that faint rows may be noisier.
    """

    name = "jitter"
    title = "errors larger than quoted"
    shown = Shown(NIGHT, "mag", {"mag": 0.05})
    widens = True
    mends_errors = True
    quantities = (
        Quantity(
            "mag", "mag", 0.0, 2.0, "added in quadrature to the errors",
            off=0.0, typical=0.02, prior="halfnormal", sigma=0.05,
        ),
    )  # fmt: skip

    def missing(self, context):
        return self.held_already(context)

    def held_already(self, context):
        return None if context.errors else "the errors are fitted, and jitter is part of them"

    def noise(self, noise, p, context):
        return noise.wider(p["mag"])

    def trials(self, facts):
        """About what makes up for the excess of the mean square, or a tenth of the quoted error if there is none."""
        guess = math.sqrt(max(facts.excess, (0.1 * facts.sigma) ** 2))
        return [{"mag": guess * factor} for factor in (0.3, 0.55, 0.8, 1.0, 1.25, 1.8)]

    def closer(self, best, facts):
        return []
