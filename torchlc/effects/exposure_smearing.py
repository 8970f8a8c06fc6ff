"""A datum is the mean over its exposure."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchlc.geometry.rotation.spin import fastest
from torchlc.parameters import Quantity
from torchlc.shapes import tracking_pose
from torchlc.shapes.part import like
from torchlc.stages.effect import Context, Effect
from torchlc.stages.instants import Instants, Nodes
from torchlc.stages.order import GEOMETRY_STAGES
from torchlc.stages.showing import SPIN, Shown

DIFFUSE_RAD = 0.1
"""Path of the Sun or the observer, seen from a part, that counts as one width where facets rise and set."""
RANGE_LN = 0.3
"""Change of ln range that counts as one width: the light goes as its inverse square."""
TAIL_WIDTHS = 4.0
"""A lobe is followed to so many of its widths: exp(-8) of its peak. What is that far from a facet's normal is as smooth as
a lobe of a quarter of the distance."""
EDGE_INSTANTS = 2
"""Further instants of a panel in which sunlight changes by more than EDGE of itself: of what is lit for a moment at one end,
the polynomial through them has to be right there; and through 3 a parabola takes the object along its orbit within
0.02 km in a minute."""
EDGE = 0.03
LEAF_WIDTHS = 6.0
"""Widths of the sharpest lobe up to which a panel is not divided on trial."""
MOST_LEAVES = 256
"""Of an exposure; one that sweeps more than 1,500 lobe widths has longer ones."""
MOST_NODES = 801
"""Of one panel: a rule of more takes longer than 0.05 s to make."""
MOST_PAIRS = 2e7
"""Facets and instants together (160 MB an angle), beyond which fewer instants are taken."""
MOST_AT_ONCE = 2**18
"""Panels, or panels and normals together, that are looked at at once."""


class ExposureSmearing(Effect):
    """Mean light over the exposure, which takes s seconds about the stamp where no exptime is recorded.

    Each row has the Gauss-Legendre instants that it needs, in as many panels as save some: 1 while the half vector
    moves by less than a twentieth of a lobe's width 1/sqrt(n), 2 or 3 up to one width. Beyond that, one for each width and 2 more.
    Where no free number turns the body, a lobe counts only near its glint, up to the largest n that the scene
    allows; else everywhere, up to 1e4. Across the Earth's shadow light is a polynomial through 3 instants or more.
    The share of sunlight is averaged under it at as many times as the shadow's edge needs. Within 0.002 mag; where
    the memory for MOST_PAIRS does not allow it, or a fit ends elsewhere than at the scene's values, a warning says how much
    is left. Where s alone is free, batches interpolate light over it (1e-3 mag at most). Neglects, in the choice of
    instants, turns that only other effects bring (wobble).
    """

    name = "exposure_smearing"
    title = "light averaged over each exposure"
    shown = Shown(SPIN, "spin_phase")
    stage = "clock"
    known = True
    spans_exposure = True
    quantities = (
        Quantity("s", "s", 0.0, 3600.0, "exposure time, at most the cadence", off=0.0, typical=10.0),
    )  # fmt: skip

    def standard(self, context):
        return context.exptime is not None

    def missing(self, context):
        if not context.track.supports("motion"):
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
        self.panels = _panels(context, exposure)
        self.steps = 3 + 2 * int(torch.bincount(self.panels.row, self.panels.count).max())
        self.divided = _divided(self.panels, exposure)
        return self

    def instants(self, context):
        return None if self._whole else self.divided

    @property
    def _whole(self) -> bool:
        """Whether every exposure is as well as its middle."""
        return bool((torch.bincount(self.divided.row, minlength=self.panels.rows) == 1).all())

    @property
    def capped(self) -> tuple[int, int] | None:
        """Instants that there are and that are needed, where memory does not allow all."""
        return (
            (len(self.divided.row), self.panels.wanted)
            if len(self.divided.row) < self.panels.wanted
            else None
        )

    def clock(self, nodes, p, context):
        if self._whole:
            return nodes
        exposure = p["s"] if context.exptime is None else context.exptime.to(nodes.offset)
        place, weight = (column.to(nodes.offset) for column in (self.divided.place, self.divided.weight))
        return Nodes(nodes.offset + place * exposure, nodes.weight * weight)


@dataclass(frozen=True)
class Panels:
    """Parts of exposures, P, those of a row in order: ``row`` (P,), ``start`` and ``length`` (P,) in shares of the
    exposure, ``count`` (P,) of instants in each. ``wanted`` instants in all of ``rows`` rows, before any cap."""

    row: Tensor
    start: Tensor
    length: Tensor
    count: Tensor
    wanted: int
    rows: int


@functools.cache
def _rule(count: int) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * nodes + 0.5, 0.5 * weights


def _divided(panels: Panels, exposure: Tensor) -> Instants:
    """The Gauss-Legendre nodes of every panel, row by row."""
    number = torch.repeat_interleave(torch.arange(len(panels.row)), panels.count)
    place, weight = exposure.new_empty(2, len(number))
    ends = panels.count.cumsum(0)
    for count in torch.unique(panels.count).tolist():
        nodes, weights = (torch.as_tensor(array).to(exposure) for array in _rule(count))
        chosen = torch.nonzero(panels.count == count)[:, 0]
        index = (ends[chosen] - count)[:, None] + torch.arange(count)
        place[index] = panels.start[chosen, None] - 0.5 + panels.length[chosen, None] * nodes
        weight[index] = panels.length[chosen, None] * weights
    return Instants(panels.row[number], place, weight, number, panels.length, panels.rows)


def instants_for(widths: Tensor) -> Tensor:
    """Gauss-Legendre instants (...) while a Gaussian lobe over a floor of 1/1250 moves by so many ``widths`` (...), for
    an error of at most 1e-3 mag wherever it passes."""
    many = widths.clamp(max=MOST_NODES).ceil().long() + 2
    few = torch.where(widths <= 0.05, 1, torch.where(widths <= 0.4, 2, 3))
    return torch.where(widths <= 1.0, few, many).clamp(max=MOST_NODES)


def _panels(context: Context, exposure: Tensor) -> Panels:
    """The panels of every exposure (T,) that need the fewest instants, found by joining leaves of equal length from the
    bottom up. At the shadow's edge each has more."""
    rows = len(exposure)
    whole = torch.arange(rows)
    paths, widths = _paths(context, whole, torch.zeros_like(exposure), exposure)
    leaves = (paths / widths.lobe).amax(0) / LEAF_WIDTHS
    depth = torch.log2(leaves.clamp(1.0, MOST_LEAVES)).ceil().long()
    edge = torch.zeros(rows, dtype=torch.bool)
    for effect in context.effects:
        if effect.stage == "shade":
            edge |= effect.change(context, exposure) > EDGE
    more = torch.where(edge, EDGE_INSTANTS, 0)
    pieces: list[Panels] = []
    for level in torch.unique(depth).tolist():
        chosen = whole[depth == level]
        pieces += [
            _joined(context, some, exposure[some], level, more[some])
            for some in chosen.split(max(1, MOST_AT_ONCE >> level))
        ]
    row, start, length, count = (
        torch.cat([getattr(piece, name) for piece in pieces]) for name in ("row", "start", "length", "count")
    )
    order = torch.as_tensor(np.lexsort((start.numpy(), row.numpy())))
    row, start, length, count = (column[order] for column in (row, start, length, count))
    wanted = int(count.sum())
    panels = Panels(row, start, length, count, wanted, rows)
    return _capped(context, panels) if context.finer is None else _finer(panels, context.finer)


def _finer(panels: Panels, rows: Tensor) -> Panels:
    """Each panel of the rows that are marked (T,) in two, with an instant more in each; none for the others."""
    kept = rows[panels.row]
    row, start, length, count = (
        column[kept].repeat_interleave(2)
        for column in (panels.row, panels.start, 0.5 * panels.length, panels.count + 1)
    )
    start[1::2] += length[1::2]
    return Panels(row, start, length, count, panels.wanted, panels.rows)


def _capped(context: Context, panels: Panels) -> Panels:
    """No more instants than memory allows, taken from the rows that have most."""
    facets = sum(len(part.faces) for part in context.parts)
    most = MOST_PAIRS / facets
    if panels.wanted <= most:
        return panels
    row_count = torch.zeros(panels.rows, dtype=torch.long).index_add(0, panels.row, panels.count)
    low, high = 1, int(row_count.max())
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if int(row_count.clamp(max=middle).sum()) <= most else (low, middle - 1)
    cut = row_count > low
    kept = ~cut[panels.row]
    rows = torch.nonzero(cut)[:, 0]
    row = torch.cat([panels.row[kept], rows])
    start = torch.cat([panels.start[kept], panels.start.new_zeros(len(rows))])
    order = torch.as_tensor(np.lexsort((start.numpy(), row.numpy())))
    length = torch.cat([panels.length[kept], panels.length.new_ones(len(rows))])
    count = torch.cat([panels.count[kept], torch.full_like(rows, low)])
    return Panels(row[order], start[order], length[order], count[order], panels.wanted, panels.rows)


def _joined(context: Context, rows: Tensor, exposure: Tensor, level: int, more: Tensor) -> Panels:
    """Panels of rows (R,) whose exposures (R,) are cut into 2^level leaves, which are joined where that saves instants."""
    leaves = 2**level
    start = torch.arange(leaves, dtype=exposure.dtype) / leaves
    middle = (start + 0.5 / leaves - 0.5).expand(len(rows), leaves)
    paths, widths = _paths(
        context,
        rows.repeat_interleave(leaves),
        (middle * exposure[:, None]).flatten(),
        (exposure / leaves).repeat_interleave(leaves),
    )
    path, width = (tensor.unflatten(-1, (-1, leaves)) for tensor in (paths, widths.here(paths)))
    cost = instants_for((path / width).amax(0)) + more[:, None]
    levels = [cost]
    whole: list[Tensor] = []
    best = cost
    for _ in range(level):
        path, width = path.unflatten(-1, (-1, 2)).sum(-1), width.unflatten(-1, (-1, 2)).amin(-1)
        alone = instants_for((path / width).amax(0)) + more[:, None]
        apart = best.unflatten(-1, (-1, 2)).sum(-1)
        whole.append(alone <= apart)
        levels.append(alone)
        best = torch.minimum(alone, apart)
    joined: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    open_ = torch.ones(len(rows), 1, dtype=torch.bool)
    for height in range(level, -1, -1):
        taken = open_ & whole[height - 1] if height else open_
        number, which = torch.nonzero(taken, as_tuple=True)
        length = 2.0 ** (height - level)
        joined.append(
            (
                rows[number],
                which * length,
                torch.full_like(exposure[number], length),
                levels[height][number, which],
            )
        )
        open_ = (open_ & ~taken).repeat_interleave(2, -1)
    row, begin, length, count = (torch.cat(column) for column in zip(*joined, strict=True))
    return Panels(row, begin.to(exposure), length, count, int(count.sum()), len(rows))


@dataclass(frozen=True)
class Widths:
    """Of each path C that directions take: ``lobe`` (C, 1), the least that counts as one width; ``away`` (C, P), how far
    from the nearest glint the path's middle is, 0 where that is not known; ``smooth`` (C, 1), the most that counts as
    one."""

    lobe: Tensor
    away: Tensor
    smooth: Tensor

    def here(self, paths: Tensor) -> Tensor:
        """The width that counts on each path (C, P), by its nearest approach to a glint."""
        near = (self.away - 0.5 * paths).clamp(min=0.0) / TAIL_WIDTHS
        return torch.minimum(torch.maximum(near, self.lobe), self.smooth)


def _paths(context: Context, rows: Tensor, offset: Tensor, length: Tensor) -> tuple[Tensor, Widths]:
    """Paths (C, P), rad or ln range, within P times of ``length`` (P,) s, ``offset`` (P,) s after the stamps of ``rows`` (P,);
    and their widths."""
    pieces = [
        _some_paths(context, *some)
        for some in zip(*(column.split(MOST_AT_ONCE) for column in (rows, offset, length)), strict=True)
    ]
    paths = torch.cat([path for path, _ in pieces], -1)
    return paths, replace(pieces[0][1], away=torch.cat([widths.away for _, widths in pieces], -1))


def _some_paths(context: Context, rows: Tensor, offset: Tensor, length: Tensor) -> tuple[Tensor, Widths]:
    track = context.track.at_rows(rows)
    step = 1e-3 * length.clamp(min=1e-3)
    # rates at the middle and at both ends, from short differences
    middles = torch.tensor([-0.5, 0.0, 0.5], dtype=offset.dtype)[:, None] * length + offset
    times = torch.cat([middles - step / 2, middles + step / 2])
    state = track.at(times, times, 0.0)
    bounds = {name: context.bounds[name] for name in context.attitude.numbers}
    steady = all(low == high for low, high in bounds.values()) and not context.turned(*GEOMETRY_STAGES)
    rotations = [context.attitude.rotation(state, values) for values in fastest(bounds)]
    sun, observer = normalize(state.sun, dim=-1), normalize(state.observer, dim=-1)
    paths: list[Tensor] = []
    lobes: list[float] = []
    smooth: list[float] = []
    away: list[Tensor] = []

    def add(direction: Tensor, lobe: float, most: float, distance: Tensor | None = None) -> None:
        moved = torch.linalg.vector_norm(direction[3:] - direction[:3], dim=-1).amax(0) / step * length
        paths.append(moved)
        lobes.append(lobe)
        smooth.append(most)
        away.append(torch.zeros_like(moved) if distance is None else distance)

    add(torch.linalg.vector_norm(state.observer, dim=-1, keepdim=True).log(), RANGE_LN, RANGE_LN)
    for rotation in rotations:
        to_sun, to_observer = (
            torch.einsum("...ij,...i->...j", rotation, direction) for direction in (sun, observer)
        )
        for part, facets in zip(context.parts, context.rest, strict=True):
            source, target = to_sun, to_observer
            if part.tracks_axis is not None:
                pose = tracking_pose(like(part.tracks_axis, to_sun), like(part.front, to_sun), to_sun)
                source, target = (
                    torch.einsum("...ij,...i->...j", pose, direction) for direction in (source, target)
                )
            bound = context.lobe_bounds if steady else context.lobes
            width = min(DIFFUSE_RAD, max(bound.get(name, 1.0) for name in part.materials) ** -0.5)
            half = normalize(source + target, dim=-1)
            distance = None
            if steady and width < DIFFUSE_RAD / TAIL_WIDTHS:
                distance = _from_glint(half[1], facets.normal)
            add(half, width, DIFFUSE_RAD, distance)
            add(source, DIFFUSE_RAD, DIFFUSE_RAD)
            add(target, DIFFUSE_RAD, DIFFUSE_RAD)
    column = torch.tensor([lobes, smooth], dtype=offset.dtype)[..., None]
    return torch.stack(paths), Widths(column[0], torch.stack(away), column[1])


def _from_glint(half: Tensor, normal: Tensor) -> Tensor:
    """Angle (P,), rad, between half vectors (P, 3) and the nearest of the normals (F, 3), less half the distance between two
    of them where they stand for a curved surface."""
    normal = torch.unique(normal.detach().round(decimals=9), dim=0)
    nearest = torch.full_like(half[:, 0], -1.0)
    for some in normal.split(max(1, 16 * MOST_AT_ONCE // len(half))):
        nearest = torch.maximum(nearest, (half @ some.T).amax(-1))
    between = 0.0
    if 16 < len(normal) <= 4000:
        apart = normal @ normal.T - 3 * torch.eye(len(normal), dtype=normal.dtype)
        between = float(torch.acos(apart.amax(-1).clamp(-1, 1)).median())
    elif len(normal) > 4000:
        between = math.pi
    return (torch.acos(nearest.clamp(-1, 1)) - between).clamp(min=0.0)
