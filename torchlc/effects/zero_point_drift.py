"""The zero point changes steadily."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.showing import NIGHT, TIME, Shown


def hours_from_mean(seconds: torch.Tensor, *groups: torch.Tensor) -> torch.Tensor:
    """Hours (T,) since the mean time of the rows with the same index (T,) in every one of ``groups``."""
    _, group = torch.unique(torch.stack(groups), dim=1, return_inverse=True)
    zero = seconds.new_zeros(int(group.max()) + 1)
    mean = zero.index_add(0, group, seconds) / zero.index_add(0, group, torch.ones_like(seconds))
    return (seconds - mean[group]) / 3600


class ZeroPointDrift(Effect):
    """Adds mag_per_hour (t - mean time): 0.01 to 0.1 mag a night.

    The mean is over the rows of one curve in one night. Neglects anything but a straight line: clouds, and
    a step where the camera was restarted.
    """

    name = "zero_point_drift"
    title = "a zero point that drifts"
    shown = Shown(NIGHT, TIME, {"mag_per_hour": 0.03})
    stage = "detector"
    divisible = True
    order = 2
    quantities = (
        Quantity(
            "mag_per_hour", "mag/h", -1.0, 1.0, "slope of the zero point, fainter with time where positive",
            off=0.0, typical=0.02, prior="normal", mean=0.0, sigma=0.02,
        ),
    )  # fmt: skip

    def missing(self, context):
        hours = hours_from_mean(context.seconds, context.curve, context.night)
        return None if bool((hours != 0).any()) else "no two rows of a curve lie in the same night"

    def prepared(self, context):
        self.hours = hours_from_mean(context.seconds, context.curve, context.night)
        return self

    def detector(self, brightness, p, context):
        fainter = p["mag_per_hour"] * self.hours.to(brightness.flux)
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * fainter))
