"""Curved surfaces as the points at which their light is summed: where they are depends on Sun and observer.

The normals of a curved surface run past the half vector h of Sun and observer, and its lobe is a spike there, as narrow
as the material is sharp. Points lie at equal steps of asinh(angle from h / NEAREST): a lobe is smooth in that, so that
the same few points serve exponents from 1 to 1e6, with a lobe of any form about h. Between the limits at which a
surface turns from Sun or observer, which are exact, they are Gauss-Legendre points that are spread more evenly by
the map of Hale and Trefethen (2008, SIAM J. Numer. Anal. 46, 930): g(x) = arcsin(a x)/arcsin(a). Neglected, in mag of a
lobe cos^n on a cylinder: 7e-4 at most for n up to 1e6 (rms 3e-4), twice that on a sphere or dish; lobes that peak
elsewhere than at h.

Letters: N points of a surface, ... any rows (lights, instants, epochs).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchlc.tensors.vectors import dot, least_axis

NEAREST = 1e-3
"""Angle, rad, within which points are evenly spread: the width of the sharpest lobe, 1/sqrt(1e6)."""
ONCE, FLARED = 16, 22
"""Points on each side of h: along the arc of a cylinder, of a cone, which may be all of a turn."""
MERIDIANS, PARALLELS = 18, 16
"""Points on each side of h along the two arcs of a surface curved about two axes. Meridians cross a dish's rim and
terminators at an angle: with 16 a lobe of n = 1 on a dish is 2.8e-3 mag off, with 18 1.9e-3. What a law has in it of edges
that no rule is cut at, as the masking of V-shaped cavities, costs more (`Brdf.edged`)."""
NEAR_KINK = 0.15
"""rad: a kink nearer to a cut that is there needs none of its own."""
AFTER = 8
"""Points beyond the azimuth at which n.s = n.o, where laws that take the smaller of the two have a kink."""
BEHIND = 10
"""Points on a second arc that is lit and seen, which only a cone has; it is away from h."""
EVENNESS = 0.9
"""The a of the map; 14, 16 and 18 points a side at 0.9 leave 1.4e-3, 5e-4 and 2e-4 of the lobe, plain Gauss-Legendre
points 6e-3, 3e-3 and 1e-3."""
BUMP = 3.0
"""Width of what `share_near` takes from the facets, in steps between them; below 2.5 a lobe of half a step shows them."""
TINY = 1e-12
"""Distance kept from a cosine of 1 or -1, where its angle has no slope."""
PARALLEL = 1e-18
"""Squared length below which a projection has no direction."""


@dataclass(frozen=True)
class Points:
    """Where a curved surface is asked for its light, (..., N) each.

    cos_i, cos_r: n.s and n.o; along_u, along_v: components of s + o along the in-plane axes; area (m2) that a
    point stands for; apart2: squared distance of its normal from the one nearest to h; facet: which it lies in.
    """

    cos_i: Tensor
    cos_r: Tensor
    along_u: Tensor
    along_v: Tensor
    area: Tensor
    apart2: Tensor
    facet: Tensor


@dataclass(frozen=True)
class Plane:
    """Facets that are pieces of one plane, as the sectors of a disc."""

    axes: ClassVar[int] = 0


@dataclass(frozen=True)
class Band:
    """Side of a cylinder or cone: normals level (cos phi e1 + sin phi e2) + rise axis, all azimuths alike.

    frame (3, 3): rows e1, e2, axis; area () m2 of all the way round; ``facets`` around; ``flared``: rise may differ from
    0. ``arc``: it is there from one azimuth, rad, on for a width of at most pi, with its ``facets``; one that is not flared.
    """

    frame: Tensor
    level: Tensor
    rise: Tensor
    area: Tensor
    facets: int
    flared: bool
    arc: tuple[float, float] | None = None
    axes: ClassVar[int] = 1

    @staticmethod
    def points_of(flared: bool) -> int:
        return 2 * (FLARED if flared else ONCE) + AFTER + BEHIND * flared

    @property
    def bump(self) -> float:
        return BUMP * (2 * math.pi if self.arc is None else self.arc[1]) / self.facets

    def nearest(self, bisector: Tensor) -> Tensor:
        """The normal (..., 3) nearest to a bisector (..., 3)."""
        x, y, _ = _projected(bisector, self.frame)
        x, y, size = _level(x, y)
        level = torch.stack([x / size, y / size], -1) @ self.frame[:2]
        return self.level * level + self.rise * self.frame[2]

    def points(self, to_sun: Tensor, to_observer: Tensor) -> Points:
        """Points for directions (..., 3) that broadcast."""
        to_sun, to_observer = torch.broadcast_tensors(to_sun, to_observer)
        sun, observer = _projected(to_sun, self.frame), _projected(to_observer, self.frame)
        bisector = [part + other for part, other in zip(sun, observer, strict=True)]
        x, y, level = _level(bisector[0], bisector[1])
        ends, sides = [], []
        for direction in (sun, observer):
            across = x * direction[1] - y * direction[0]
            ahead, across, size = _level(x * direction[0] + y * direction[1], across)
            azimuth, size = torch.atan2(across, ahead), size / level
            rise = self.rise * direction[2]
            cosine = -rise / (self.level * size)
            whole = cosine <= -1
            half = torch.acos(cosine.clamp(-1 + TINY, 1 - TINY))
            ends.append((torch.where(whole, 0.0, azimuth), torch.where(whole, math.pi, half)))
            sides.append((azimuth, self.level * size, rise))
        (middle, half), (other, other_half) = ends
        low, high = (
            torch.maximum(middle - half, other - other_half),
            torch.minimum(middle + half, other + other_half),
        )
        if self.arc is not None:  # two arcs of at most half a turn meet in one
            start, width = self.arc
            start = start - torch.atan2(y, x)
            nearest = torch.round((0.5 * (low + high) - start - 0.5 * width).detach() / (2 * math.pi))
            start = start + 2 * math.pi * nearest
            low, high = torch.maximum(low, start), torch.minimum(high, start + width)
        arcs = [
            graded(
                low,
                high,
                FLARED if self.flared else ONCE,
                kink=self._as_bright(x, y, sun, observer, low, high),
            )
        ]
        if self.flared:  # two arcs of more than half a turn overlap at both ends
            other = other + torch.where(other >= middle, -2 * math.pi, 2 * math.pi)
            low, high = (
                torch.maximum(middle - half, other - other_half),
                torch.minimum(middle + half, other + other_half),
            )
            arcs.append(evenly(low, high, BEHIND))
        offset, width = (torch.cat(pieces, -1) for pieces in zip(*arcs, strict=True))
        cos_i, cos_r = (
            size[..., None] * torch.cos(offset - azimuth[..., None]) + rise[..., None]
            for azimuth, size, rise in sides
        )
        azimuth = (torch.atan2(y, x)[..., None] + offset).detach()
        level = level[..., None]
        return Points(
            cos_i,
            cos_r,
            self.level * bisector[2][..., None] - self.rise * level * torch.cos(offset),
            level * torch.sin(offset),
            self.area * width / (2 * math.pi),
            (2 * self.level * torch.sin(0.5 * offset)) ** 2,
            self._facet(azimuth),
        )

    def _facet(self, azimuth: Tensor) -> Tensor:
        """The facet in which azimuths, rad, are."""
        if self.arc is None:
            return (azimuth / (2 * math.pi) * self.facets).floor().long() % self.facets
        start, width = self.arc
        along = torch.remainder(azimuth - start, 2 * math.pi) / width * self.facets
        return along.floor().long().clamp(max=self.facets - 1)

    def _as_bright(
        self, x: Tensor, y: Tensor, sun: list[Tensor], observer: list[Tensor], low: Tensor, high: Tensor
    ) -> Tensor:
        """Azimuth (...) from the direction (x, y) at which n.s = n.o; of two the one between limits, or the nearer."""
        first, second, axial = (part - other for part, other in zip(sun, observer, strict=True))
        ahead, across, size = _level(x * first + y * second, x * second - y * first)
        size = size / torch.sqrt(x * x + y * y)
        half = torch.acos((-self.rise * axial / (self.level * size)).clamp(-1 + TINY, 1 - TINY))
        middle = torch.atan2(across, ahead)
        left, right = (
            torch.remainder(end + math.pi, 2 * math.pi) - math.pi for end in (middle - half, middle + half)
        )
        first_within, second_within = (((end > low) & (end < high)) for end in (left, right))
        nearer = torch.where(first_within == second_within, left.abs() < right.abs(), first_within)
        return torch.where(nearer, left, right)


@dataclass(frozen=True)
class Dome:
    """Surface curved about two axes: one point for each normal within arccos(``rim``) of ``axis``.

    frame (3, 3): rows e1, e2, axis; rim () cosine, None for a whole sphere; an element of solid angle of the
    normals has scale / (n.axis)^power m2; u points along the meridian to the axis. ``around``: facets of a turn;
    ``find`` gives the facet for normals by their components (3 of (..., N)) in the frame.
    """

    frame: Tensor
    rim: Tensor | None
    scale: Tensor
    power: int
    around: int
    find: Callable[[list[Tensor]], Tensor]
    count: ClassVar[int] = 4 * MERIDIANS * PARALLELS
    axes: ClassVar[int] = 2

    @property
    def bump(self) -> float:
        return BUMP * 2 * math.pi / self.around

    def nearest(self, bisector: Tensor) -> Tensor:
        """The normal (..., 3) nearest to a bisector (..., 3), of the sphere that the surface is a part of."""
        return bisector / dot(bisector, bisector).clamp(min=PARALLEL).sqrt()[..., None]

    def points(self, to_sun: Tensor, to_observer: Tensor, *, mirrored: bool = False) -> Points:
        """Points for directions (..., 3) that broadcast; where ``mirrored`` those of one half of a sphere, cut by the plane
        of Sun and observer, stand for both."""
        to_sun, to_observer = torch.broadcast_tensors(to_sun, to_observer)
        both, apart = (
            dot(vector, vector).clamp(min=PARALLEL).sqrt()
            for vector in (to_sun + to_observer, to_observer - to_sun)
        )
        half = (to_sun + to_observer) / both[..., None]
        if self.rim is None:
            arcs = _lune(to_sun, to_observer, half, torch.atan2(both, apart))
        else:
            arcs = self._within(self.rim, to_sun, to_observer, half)
        first, pole, longitude, width, latitude, height = arcs
        if mirrored and self.rim is None:
            latitude, height = latitude[..., PARALLELS:], 2 * height[..., PARALLELS:]
        basis = torch.stack([first, torch.linalg.cross(pole, first), pole], -2)
        longitude = longitude[..., None].expand_as(latitude).flatten(-2)
        width = (width[..., None] * height).flatten(-2)
        latitude = latitude.flatten(-2)
        level = torch.cos(latitude)
        n = level * torch.cos(longitude), level * torch.sin(longitude), torch.sin(latitude)
        a, h = _parts(self.frame[2], basis), _parts(half, basis)
        cos_half = _scalar(n, h)
        tangent = tuple(part - cos_half * other for part, other in zip(h, n, strict=True))
        cross = n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2], n[0] * a[1] - n[1] * a[0]
        per_tilt = both[..., None] / _scalar(cross, cross).clamp(min=PARALLEL).sqrt()
        area = self.scale * width * level
        if self.power:
            area = area / _scalar(n, a).clamp(min=1e-3) ** self.power
        framed = [_scalar(n, _parts(axis, basis)).detach() for axis in self.frame]
        return Points(
            _scalar(n, _parts(to_sun, basis)),
            _scalar(n, _parts(to_observer, basis)),
            per_tilt * _scalar(tangent, a),
            per_tilt * _scalar(cross, h),
            area,
            2 * (1 - cos_half),
            self.find(framed),
        )

    def _within(self, rim: Tensor, to_sun: Tensor, to_observer: Tensor, half: Tensor) -> Arcs:
        """About h, or the place on the rim that is nearest to it. Meridians run towards the axis and so across the rim; on
        each, rim and terminators are two latitudes."""
        axis = self.frame[2].expand_as(half)
        cosine = dot(axis, half)
        outward = _directed(half - cosine[..., None] * axis, axis)
        on_rim = rim * axis + (1 - rim * rim).clamp(min=PARALLEL).sqrt() * outward
        first = torch.where((cosine > rim)[..., None], half, on_rim)
        pole = _directed(axis - dot(axis, first)[..., None] * first, first)
        basis = torch.stack([first, torch.linalg.cross(pole, first), pole], -2)
        ahead, up = dot(axis, first), dot(axis, pole)
        beyond = (rim * rim - up * up).clamp(min=PARALLEL).sqrt() / ahead.clamp(min=TINY)
        reach = torch.where(rim <= up.abs(), math.pi, torch.acos(beyond.clamp(-1 + TINY, 1 - TINY)))
        longitude, width = graded(-reach, reach, MERIDIANS)
        lower = torch.full_like(longitude, -0.5 * math.pi)
        upper = -lower
        for direction, cosine in ((axis, rim), (to_sun, 0.0 * rim), (to_observer, 0.0 * rim)):
            x, y, third = _parts(direction, basis)
            along, third, size = _level(x * torch.cos(longitude) + y * torch.sin(longitude), third)
            reach = torch.acos((cosine / size).clamp(-1 + TINY, 1 - TINY))
            middle = torch.atan2(third, along)
            lower, upper = torch.maximum(lower, middle - reach), torch.minimum(upper, middle + reach)
        return first, pole, longitude, width, *graded(lower, upper, PARALLELS)


Arcs = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]
"""Where longitude and latitude are 0, and the pole, (..., 3); longitudes (..., M) and their weights; latitudes (..., M, M) on
each and their weights."""


def _lune(to_sun: Tensor, to_observer: Tensor, half: Tensor, edge: Tensor) -> Arcs:
    """At longitude l and latitude b about the pole s x o, from h, n.s = cos b cos(l + phase/2) and n.o = cos b cos(l -
    phase/2): all that is lit and seen has |l| < ``edge``, 90 deg - phase/2, and n.s = n.o at 0."""
    pole = _directed(torch.linalg.cross(to_sun, to_observer), half)
    longitude, width = graded(-edge, edge, MERIDIANS)
    quarter = torch.full_like(longitude, 0.5 * math.pi)
    return half, pole, longitude, width, *graded(-quarter, quarter, PARALLELS)


Surface = Plane | Band | Dome


def share_near(apart2: Tensor, bump: float) -> Tensor:
    """What of the light is taken from points about h, 1 - (1 - exp(-apart^2 / 2 bump^2))^3; the rest is from facets, on whose
    scale it is smooth, and there each has its own visible fraction."""
    return 1 - (-torch.expm1(-apart2 / (2 * bump**2))) ** 3


def graded(low: Tensor, high: Tensor, count: int, *, kink: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Places (..., N) between limits (...) and their weights, dense about 0, ``count`` on each side of it; where 0 is
    beyond a limit all are on one side.

    The rule is cut, and has AFTER more places, at a ``kink`` (...) of the light that is further than NEAR_KINK from 0
    (nearer ones lie among dense places).
    """
    high = torch.maximum(low, high)
    turned = torch.ones_like(low)
    if kink is not None:  # on the right
        turned = torch.where(kink < 0, -1.0, 1.0)
        low, high = torch.where(kink < 0, -high, low), torch.where(kink < 0, -low, high)
    middle = torch.minimum(torch.maximum(torch.zeros_like(low), low), high)
    cuts, counts = [low, middle, high], [count, count]
    if kink is not None:
        cuts.insert(2, torch.minimum(torch.maximum(kink.abs().clamp(min=NEAR_KINK), middle), high))
        counts.append(AFTER)
    steps = [torch.asinh(cut / NEAREST)[..., None] for cut in cuts]
    places, weights = [], []
    for number, points in enumerate(counts):
        share, weight = _even_rule(points, low)
        span = steps[number + 1] - steps[number]
        step = steps[number] + span * share
        places.append(NEAREST * torch.sinh(step))
        weights.append(NEAREST * torch.cosh(step) * span * weight)
    return turned[..., None] * torch.cat(places, -1), torch.cat(weights, -1)


def evenly(low: Tensor, high: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Gauss-Legendre places (..., count) between limits (...) and their weights."""
    nodes, weights = _gauss(count)
    share, weight = (torch.as_tensor(values).to(low) for values in (0.5 * (nodes + 1), 0.5 * weights))
    span = (torch.maximum(low, high) - low)[..., None]
    return low[..., None] + span * share, span * weight


@cache
def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre places in -1 to 1 and weights: a matrix' eigenvalues, for which a curve of the light asks thousands of times."""
    return np.polynomial.legendre.leggauss(count)


def _even_rule(count: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Places (count,) in 0 to 1 and weights of the mapped Gauss-Legendre rule."""
    x, w = _gauss(count)
    share = np.arcsin(EVENNESS * x) / math.asin(EVENNESS)
    weight = w * EVENNESS / np.sqrt(1 - (EVENNESS * x) ** 2) / math.asin(EVENNESS)
    return torch.as_tensor(0.5 * (share + 1)).to(like), torch.as_tensor(0.5 * weight).to(like)


def _projected(direction: Tensor, frame: Tensor) -> list[Tensor]:
    return list((direction @ frame.mT).unbind(-1))


def _level(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Two components and their length (...), of a direction that is (1, 0) where it has none."""
    x, y = torch.broadcast_tensors(x, y)
    tiny = x * x + y * y < PARALLEL
    x, y = torch.where(tiny, math.sqrt(PARALLEL), x), torch.where(tiny, 0.0, y)
    return x, y, torch.sqrt(x * x + y * y)


def _directed(direction: Tensor, first: Tensor) -> Tensor:
    """A vector (..., 3) normal to a unit one as a unit vector; any one normal to it where it has no length."""
    other = torch.linalg.cross(first, least_axis(first))
    direction = torch.where((dot(direction, direction) > PARALLEL)[..., None], direction, other)
    return direction / dot(direction, direction).clamp(min=PARALLEL).sqrt()[..., None]


def _parts(direction: Tensor, basis: Tensor) -> tuple[Tensor, ...]:
    """Components (..., 1) of directions (..., 3) along the rows of a basis (..., 3, 3)."""
    return tuple(dot(direction, basis[..., k, :])[..., None] for k in range(3))


def _scalar(one: tuple[Tensor, ...], other: tuple[Tensor, ...]) -> Tensor:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
