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
        rows = torch.broadcast_shapes(
            view.to_sun.shape[:-1], view.to_observer.shape[:-1], *(pose.shape[:-2] for pose in poses)
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
    corners = [own.vertices for own in facets]

    def of(instants):
        turns = [None if pose is None else pose[instants].flatten(0, 1) for pose in poses]
        found = visible_fractions(
            context.shape,
            list(facets),
            turns,
            to_sun[instants].flatten(0, 1),
            to_observer[instants].flatten(0, 1),
        )
        return [one.unflatten(0, (-1, to_sun.shape[1])) for one in found]

    if traced():
        return of(slice(None))
    alone = [
        [to_sun[k], to_observer[k], *(pose[k] for pose in poses if pose is not None), *corners]
        for k in range(len(to_sun))
    ]
    return context.memory.recall(alone, of)
