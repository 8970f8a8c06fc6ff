"""A datum is the mean over its exposure."""

from __future__ import annotations

import numpy as np
import torch

from torchlc.effects.base import Effect, Nodes
from torchlc.parameters import Quantity

NODES = 15


class ExposureSmearing(Effect):
    """Mean light over the exposure by 15 Gauss-Legendre instants; with a shutter open for s seconds where no exptime is recorded.

    Resolves glints that last longer than a tenth of the exposure; a shorter one is counted to a few per cent of its light.
    """

    name = "exposure_smearing"
    stage = "clock"
    known = True
    nodes = NODES

    def missing(self, context):
        if context.exptime is None:
            return "the recording has no exptime column"
        if not bool((context.exptime > 0).any()):
            return "every exposure is of zero length"
        if not context.track.supports("time_offset"):
            return "the recording gives no motion within an exposure"
        return None

    def clock(self, nodes, p, context):
        x, w = np.polynomial.legendre.leggauss(NODES)
        place = torch.as_tensor(0.5 * x).to(nodes.offset)
        weight = torch.as_tensor(0.5 * w).to(nodes.offset)
        offset = nodes.offset + place[:, None] * context.exptime.to(nodes.offset)
        return Nodes(offset, weight[:, None] * nodes.weight)
