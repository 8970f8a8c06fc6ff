"""One part of the object hides another from the Sun or from the observer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from torchlc.occlusion import may_meet, visible_fractions
from torchlc.stages.effect import Effect
from torchlc.stages.showing import SLOW, Shown
from torchlc.tensors.autodiff_state import readable, traced, transformed


class SelfShadowing(Effect):
    """Shadow from the Sun and occlusion to the observer, as the union of both: up to 1.7 mag on tumbling
    box-wings.

    Neglected: the Sun's disc, which blurs a shadow's edge by 9 mm at 2 m, 0.01 mag while one crosses; the
    shadows of light from elsewhere (earthshine), which is only hidden from the observer.
    """

    name = "self_shadowing"
    title = "parts that shade and hide each other"
    shown = Shown(SLOW, "sun_lon_body")
    stage = "surface"
    joins_parts = True
    known = True

    def jumps(self, context):
        traced = [part.name for part in context.parts if part.hull is None]
        return f"shadows on an object with {', '.join(traced)}, which rays trace," if traced else None

    def surface(self, patches, view, p, context):
        poses = [pose for pose in view.poses if pose is not None]
        sized = any(facets.vertices.ndim > 3 for facets in view.facets)
        count = len(view.nodes.offset) // (view.batch if len(view.nodes.offset) > 1 else 1) * view.batch
        rows = np.broadcast_shapes(
            view.to_sun.shape[:-1],
            view.to_observer.shape[:-1],
            *(pose.shape[:-2] for pose in poses),
            (count if sized else 1, 1),
        )

        def fractions(source):
            shares = _visible(context, view, rows, source)
            if shares is None:
                clear = source.new_ones(()).expand(rows[0], 1, 1)
                return [
                    None if patch.part is None else clear.expand(-1, -1, len(patch.normal))
                    for patch in patches
                ]
            return [
                None if patch.part is None else shares[patch.part][..., patch.select] for patch in patches
            ]

        visible = fractions(view.to_sun)
        seen = visible if all(light.primary for light in view.lights) else fractions(view.to_observer)
        return tuple(
            replace(patch, visible=by_sun, seen=by_observer)
            for patch, by_sun, by_observer in zip(patches, visible, seen, strict=True)
        )


def _visible(context, view, rows, to_sun):
    """Fractions (Q, T, F) of each part, for ``rows`` (Q, T). Only rows in which parts may meet are worked out; what was
    worked out for an instant before is remembered. None if there are no such rows."""
    count, each = rows
    meeting = _meeting(context, view, rows, to_sun)
    instants = torch.nonzero(meeting.any(-1))[:, 0].tolist() if meeting is not None else list(range(count))
    if not instants:
        return None
    sun, observer = to_sun.expand(*rows, 3), view.to_observer.expand(*rows, 3)
    poses = [None if pose is None else pose.expand(*rows, 3, 3) for pose in view.poses]

    def sized(tensor, ends, instant):
        """What belongs to an instant, of facets that are the same in all or differ within a batch B, the last axis of Q."""
        return tensor if tensor.ndim == ends else tensor[instant % len(tensor)]

    def of(which):
        """Fractions (instants, T, F) at the instants ``which``."""
        which = torch.as_tensor(which, device=sun.device)
        if meeting is None:
            item, row = (
                which.repeat_interleave(each),
                torch.arange(each, device=which.device).repeat(len(which)),
            )
        else:
            item, row = torch.nonzero(meeting[which], as_tuple=True)
        instant = which[item] if meeting is not None else item
        shares = visible_fractions(
            context.shape,
            [
                replace(facets, vertices=sized(facets.vertices, 3, instant))
                if facets.vertices.ndim > 3
                else facets
                for facets in view.facets
            ],
            [None if pose is None else pose[instant, row] for pose in poses],
            sun[instant, row],
            observer[instant, row],
        )
        if meeting is None:
            return [share.unflatten(0, (-1, each)) for share in shares]
        blank = [share.new_ones(len(which), each, share.shape[-1]) for share in shares]
        return [whole.index_put((item, row), share) for whole, share in zip(blank, shares, strict=True)]

    if traced():
        shares = of(instants)
    else:
        alone = [
            [
                sun[k],
                observer[k],
                *(pose[k] for pose in poses if pose is not None),
                *(sized(facets.vertices, 3, k) for facets in view.facets),
            ]
            for k in instants
        ]
        shares = context.memory.recall(alone, lambda new: of([instants[k] for k in new]))
    if len(instants) == count:
        return shares
    index = (torch.tensor(instants, device=sun.device),)
    return [share.new_ones(*rows, share.shape[-1]).index_put(index, share) for share in shares]


def _meeting(context, view, rows, to_sun):
    """Rows (Q, T) in which parts may meet; None where a transform hides which they are."""
    known = (to_sun, view.to_observer, *(facets.vertices for facets in view.facets))
    if transformed() or not all(map(readable, known)):
        return None
    return may_meet(context.parts, view.facets, rows, (to_sun, view.to_observer))
