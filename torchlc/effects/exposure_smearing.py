"""A datum is the mean over its exposure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch.nn.functional import normalize

from torchlc.effects.base import Context, Effect, Nodes
from torchlc.parameters import Quantity
from torchlc.shape import tracking_pose
from torchlc.shape.part import like

DIFFUSE_RAD = 0.1
"""Path of the Sun or the observer, seen from a part, that counts as one width where facets rise and set."""
MOST_NODES = 801
MOST_PAIRS = 2e7
"""Facets, rows and instants together (160 MB an angle), beyond which fewer instants are taken."""


class ExposureSmearing(Effect):
    """Mean light over the exposure, which takes s seconds about the stamp where no exptime is recorded.

    As many Gauss-Legendre instants as the sharpest lobe asks of the row that turns most: 1 while the half
    vector moves by less than a twentieth of the lobe's width 1/sqrt(n), 2 or 3 up to one width, then one
    for each. Within 0.002 mag for n up to 1e4, or up to a sharper one that is fixed. Where s alone is free,
    light is interpolated over it (5e-4 mag at most). Neglects turns that
    only other effects bring (wobble), and what falls between the instants where n is fitted beyond 1e4, or
    where the caps on instants and memory are met.
    """

    name = "exposure_smearing"
    stage = "clock"
    known = True
    quantities = (
        Quantity("s", "s", 0.0, 3600.0, "exposure time, at most the cadence", off=0.0, typical=10.0),
    )  # fmt: skip

    def standard(self, context):
        return context.exptime is not None

    def missing(self, context):
        if not context.track.supports("time_offset"):
            return "the recording gives no motion within an exposure"
        if context.exptime is None:
            return None if context.cadence > 0 else "there is neither an exptime column nor a cadence"
        return None if bool((context.exptime > 0).any()) else "every exposure is of zero length"

    def prepared(self, context):
        exposure = context.exptime
        if exposure is None:
            exposure = torch.full_like(context.seconds, context.cadence)
            s = type(self).quantities[0]
            self.quantities = (replace(s, high=context.cadence, typical=0.5 * context.cadence),)
        else:
            self.quantities = ()
        facets = sum(len(part.faces) for part in context.parts)
        most = min(MOST_NODES, max(3, int(MOST_PAIRS / (facets * len(exposure)))))
        self.nodes = min(instants_for(widths_swept(context, exposure)), most)
        self.steps = 3 + 2 * self.nodes
        return self

    def clock(self, nodes, p, context):
        exposure = p["s"] if context.exptime is None else context.exptime.to(nodes.offset)
        rule = np.polynomial.legendre.leggauss(self.nodes)
        x, w = (torch.as_tensor(0.5 * half).to(nodes.offset) for half in rule)
        offset = nodes.offset + x[:, None, None] * exposure
        weight = (w[:, None, None] * nodes.weight).expand(-1, *nodes.weight.shape)
        return Nodes(offset.flatten(0, 1), weight.flatten(0, 1))


def instants_for(widths: float) -> int:
    """Gauss-Legendre instants while a Gaussian lobe over a floor of 1/1250 moves by so many widths, for an
    error of at most 1e-3 mag wherever it passes.
    """
    for instants, enough in ((1, 0.05), (2, 0.4), (3, 1.0)):
        if widths <= enough:
            return instants
    return math.ceil(widths) + 2 if widths < MOST_NODES else MOST_NODES


def widths_swept(context: Context, exposure: torch.Tensor) -> float:
    """The longest path in any exposure (T,): of the half vector over a part, in widths of its sharpest lobe,
    or of the Sun or the observer, in widths of what is diffuse.

    From the rates at five places of each exposure, at the scene's own values.
    """
    step = 1e-3 * exposure
    place = torch.linspace(-0.5, 0.5, 5, dtype=exposure.dtype)[:, None] * exposure
    offset = torch.cat([place - step / 2, place + step / 2])
    state = context.track.at(offset, offset, 0.0)
    rotation = context.attitude.rotation(state, {})
    to_sun = torch.einsum("...ij,...i->...j", rotation, normalize(state.sun, dim=-1))
    to_observer = torch.einsum("...ij,...i->...j", rotation, normalize(state.observer, dim=-1))
    longest = 0.0
    for part in context.parts:
        source, target = to_sun, to_observer
        if part.tracks_axis is not None:
            pose = tracking_pose(like(part.tracks_axis, to_sun), like(part.front, to_sun), to_sun)
            source, target = (torch.einsum("...ij,...i->...j", pose, one) for one in (source, target))
        lobe = min(DIFFUSE_RAD, max(context.lobes[material] for material in part.materials) ** -0.5)
        half = normalize(source + target, dim=-1)
        paths = [(half, lobe), (source, DIFFUSE_RAD), (target, DIFFUSE_RAD)]
        for direction, width in paths:
            swept = 1e3 * torch.linalg.vector_norm(direction[5:] - direction[:5], dim=-1).amax()
            longest = max(longest, float(swept) / width)
    return longest
