"""One part of the object hides another from the Sun or from the observer."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchlc.occlusion import visible_fractions
from torchlc.stages.effect import Effect
from torchlc.stages.showing import SLOW, Shown
from torchlc.tensors.autodiff_state import traced


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
        sized = any(own.vertices.ndim > 3 for own in view.facets)
        count = len(view.nodes.offset) // (view.batch if len(view.nodes.offset) > 1 else 1) * view.batch
        rows = torch.broadcast_shapes(
            view.to_sun.shape[:-1],
            view.to_observer.shape[:-1],
            *(pose.shape[:-2] for pose in poses),
            (count if sized else 1, 1),
        )
        to_sun, to_observer = view.to_sun.expand(*rows, 3), view.to_observer.expand(*rows, 3)
        turns = [None if pose is None else pose.expand(*rows, 3, 3) for pose in view.poses]

        def fractions(source):
            found = _visible(context, view.facets, turns, source, to_observer)
            return [None if patch.part is None else found[patch.part][..., patch.select] for patch in patches]

        visible = fractions(to_sun)
        seen = visible if all(light.primary for light in view.lights) else fractions(to_observer)
        return tuple(
            replace(patch, visible=one, seen=other)
            for patch, one, other in zip(patches, visible, seen, strict=True)
        )


def _visible(context, facets, poses, to_sun, to_observer):
    """Fractions (Q, T, F) of each part; what was worked out for an instant before is remembered."""
    count, rows = to_sun.shape[:2]

    def sized(tensor, ends, instants):
        """What belongs to an instant, of facets that are the same in all or differ within a batch B, the last axis of Q."""
        return tensor if tensor.ndim == ends else tensor[instants % len(tensor)]

    def of(instants):
        turns = [None if pose is None else pose[instants].flatten(0, 1) for pose in poses]
        shapes = [
            replace(own, vertices=sized(own.vertices, 3, instants).repeat_interleave(rows, 0))
            if own.vertices.ndim > 3
            else own
            for own in facets
        ]
        found = visible_fractions(
            context.shape,
            shapes,
            turns,
            to_sun[instants].flatten(0, 1),
            to_observer[instants].flatten(0, 1),
        )
        return [one.unflatten(0, (-1, rows)) for one in found]

    if traced():
        return of(torch.arange(count))
    alone = [
        [
            to_sun[k],
            to_observer[k],
            *(pose[k] for pose in poses if pose is not None),
            *(sized(own.vertices, 3, k) for own in facets),
        ]
        for k in range(count)
    ]
    return context.memory.recall(alone, lambda new: of(torch.tensor(new)))
