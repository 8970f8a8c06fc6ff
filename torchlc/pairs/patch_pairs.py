"""Pairs of the facets of one patch with one light: the cosines and projections of each, and its weight.

Letters: L lights, Q instants, T rows, F facets, K points of a curved surface.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchlc.shapes.curved import Band, Dome, Plane, Points, share_near
from torchlc.stages.light import Light, Patch, Response, View
from torchlc.tensors.vectors import dot, turned_back

DARKEST_RADIANCE = 1e-9
"""Of that of a surface that faces its source: what is left is light of no account, and a power below 1 has no slope at 0."""


def as_one_facet(patch: Patch) -> Patch:
    """A patch whose facets are pieces of one plane as one facet."""
    if not isinstance(patch.surface, Plane):
        return patch
    visible, seen = (
        None
        if share is None
        else (patch.area * share).sum(-1, keepdim=True) / patch.area.sum(-1, keepdim=True)
        for share in (patch.visible, patch.seen)
    )
    area = patch.area.sum(-1, keepdim=True)
    normal, u = patch.normal[..., :1, :], patch.u[..., :1, :]
    return replace(patch, normal=normal, u=u, area=area, visible=visible, seen=seen, surface=None)


def falling_light(patch: Patch, light: Light) -> Light:
    """A light from as many directions as a patch needs."""
    if not isinstance(patch.surface, Band | Dome):
        return light if light.disc is None or not patch.by_facet else light.disc.spread(light, -1)
    if light.disc is not None:
        return light.disc.spread(light, 2 - patch.surface.axes)
    return light if light.fewer is None else light.fewer[patch.surface.axes - 1]


def pair_projections(patch: Patch, source: Tensor, observer: Tensor) -> tuple[Tensor, ...]:
    """What :func:`~torchlc.brdf.angles.projected` asks for, of directions to light (L, Q, T, 3) and observer
    (Q, T, 3) in the patch's frame: (L, Q, F, T) each, with an axis of 1 where it is the same along it."""
    bisector = source + observer
    v = torch.linalg.cross(patch.normal, patch.u)
    pairs = ((source, patch.normal), (observer, patch.normal), (bisector, patch.u), (bisector, v))
    return *((direction @ axis.mT).mT for direction, axis in pairs), dot(bisector, bisector)[..., None, :]


def pairs_by_facet(
    view: View, patch: Patch, light: Light, source: Tensor, observer: Tensor, rows: slice
) -> tuple[Tensor, ...]:
    """The projections of :func:`pair_projections` and the weight of a patch, (L, Q, F, T) each, whose facets have directions of
    their own to lamp and camera, and whose radiance is not recorded linearly.

    With s the direction from the body's origin and d the distance, a facet at c sees the lamp along s - c / d, whose length r takes
    1 / r^2 of the light; likewise the camera.
    """
    cos_i, cos_r = ((direction @ patch.normal.mT).mT for direction in (source, observer))
    v = torch.linalg.cross(patch.normal, patch.u)
    axes = () if patch.model.additive else (patch.u, v)
    light_along, sight_along = (
        [(direction @ axis.mT).mT for axis in axes] for direction in (source, observer)
    )
    cosine = dot(source, observer)[..., None, :]
    gain: Tensor | None = None
    radiance = cos_i
    if patch.near is not None:
        point = patch.near.point
        lamp, camera = (
            tensor if tensor.shape[-1] == 1 else tensor[:, rows]
            for tensor in (patch.near.lamp, patch.near.camera)
        )
        lamp, camera = lamp[:, None] * light.primary, camera[:, None]
        size, off = dot(point, point)[..., None], dot(point, patch.normal)[..., None]
        to_lamp, to_camera = ((direction @ point.mT).mT for direction in (source, observer))
        nearer = torch.rsqrt(1 - 2 * lamp * to_lamp + lamp**2 * size)
        closer = torch.rsqrt(1 - 2 * camera * to_camera + camera**2 * size)
        cos_i, cos_r = (cos_i - lamp * off) * nearer, (cos_r - camera * off) * closer
        places = [dot(point, axis)[..., None] for axis in axes]
        light_along = [
            (component - lamp * at) * nearer for component, at in zip(light_along, places, strict=True)
        ]
        sight_along = [
            (component - camera * at) * closer for component, at in zip(sight_along, places, strict=True)
        ]
        cosine = cosine - camera * to_lamp - lamp * to_camera + lamp * camera * size
        cosine = cosine * nearer * closer
        radiance = cos_i * nearer**2
        gain = (nearer * closer) ** 2
    weight = pair_weight(view, patch, light, cos_i, cos_r, rows)
    if gain is not None:
        weight = weight * gain
    if patch.response is not None and light.primary:
        weight = weight * _recorded(patch.response, radiance, rows)
    along = [
        along_light + along_sight for along_light, along_sight in zip(light_along, sight_along, strict=True)
    ] or [cosine, cosine]
    return cos_i, cos_r, *along, 2 + 2 * cosine, weight


def _recorded(response: Response, radiance: Tensor, rows: slice) -> Tensor:
    """What is recorded of a radiance (L, Q, F, T) over the radiance itself; 1 where there is none."""
    power, threshold, pedestal = (
        (number if number.shape[-1] == 1 else number[:, rows])[:, None]
        for number in (response.power, response.threshold, response.pedestal)
    )
    lit = radiance > DARKEST_RADIANCE
    safe = torch.where(lit, radiance, 1.0)
    recorded = (safe**power - threshold).clamp(min=0) + pedestal
    return torch.where(lit, recorded / safe, 1.0)


def curved_pairs(view: View, patch: Patch, light: Light, rows: slice) -> list[tuple[Tensor, ...]]:
    """The projections of :func:`pair_projections` and the weight of a curved patch, (L, Q, K, T) each: of points that follow
    Sun and observer, and where others may hide facets also of these, which then share the light with the points."""
    surface = patch.surface
    assert isinstance(surface, Band | Dome)
    pose = None if patch.pose is None else patch.pose[..., rows, :, :]
    source = into_part(pose, light.direction[:, :, rows])
    observer = into_part(pose, view.to_observer[:, rows])
    visible = patch.visible if light.primary else patch.seen
    options = {"mirrored": visible is None} if isinstance(surface, Dome) else {}
    points = surface.points(source, observer, **options)
    points = Points(*(values.movedim(-1, -2) for values in vars(points).values()))
    square = dot(source + observer, source + observer)[..., None, :]
    gain = (
        light.irradiance[..., rows]
        * view.nodes.weight.expand(view.range_m.shape)[:, rows]
        / view.range_m[:, rows] ** 2
    )[:, :, None]
    weight = gain * points.area * (torch.minimum(points.cos_i, points.cos_r) > 0)
    pairs = []
    if visible is not None:
        share = visible.expand(-1, view.range_m.shape[-1], -1)[:, rows].mT.expand(
            *points.facet.shape[:2], -1, -1
        )
        weight = weight * share_near(points.apart2, surface.bump) * share.gather(2, points.facet)
        cos_i, cos_r, *bisector = pair_projections(patch, source, observer)
        nearest = surface.nearest(source + observer)
        far = 1 - share_near(2 * (1 - (nearest @ patch.normal.mT).mT), surface.bump)
        pairs.append((cos_i, cos_r, *bisector, far * pair_weight(view, patch, light, cos_i, cos_r, rows)))
    return [(points.cos_i, points.cos_r, points.along_u, points.along_v, square, weight), *pairs]


def pair_weight(view: View, patch: Patch, light: Light, cos_i: Tensor, cos_r: Tensor, rows: slice) -> Tensor:
    """What a facet turned to both Sun and observer counts, (L, Q, F, rows); 0 if it is not."""
    gain = (
        light.irradiance[..., rows]
        * view.nodes.weight.expand(view.range_m.shape)[:, rows]
        / view.range_m[:, rows] ** 2
    )
    weight = gain[:, :, None] * patch.area[:, None]
    visible = patch.visible if light.primary else patch.seen
    if visible is not None:
        weight = weight * (visible if visible.shape[1] == 1 else visible[:, rows]).mT
    return weight * (torch.minimum(cos_i, cos_r) > 0)


def into_part(pose: Tensor | None, direction: Tensor) -> Tensor:
    """A body-frame direction (..., Q, T, 3) seen in the rest frame of a posed part; the facet axis is added
    by the caller."""
    if pose is None:
        return direction
    return turned_back(pose, direction)
