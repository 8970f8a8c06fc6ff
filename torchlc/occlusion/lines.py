"""Whether straight lines between points and to the Sun and the observer are free of the convex parts of an
object."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchlc.shapes import Part

TOUCHING = 1e-9  # of a line's length: what it meets nearer than this to an end is touched, not met


def planes(part: Part, corners: Tensor) -> tuple[Tensor, Tensor]:
    """The half-spaces normal . x <= offset, (R, L, 3) and (R, L), that a convex part with hull corners (R, H,
    3) fills.

    A thin one is the space between its two sides, bounded by the planes through its edges.
    """
    assert part.hull is not None
    loops = torch.as_tensor(part.hull.loops, device=corners.device)
    around = corners[:, loops]
    spokes = around - around[:, :, :1]
    normal = torch.linalg.cross(spokes, spokes.roll(-1, dims=2)).sum(dim=2)
    start = around[:, :, 0]
    if part.thin:
        edges = around[:, 0].roll(-1, dims=1) - around[:, 0]
        normal = torch.cat([normal, torch.linalg.cross(edges, normal[:, :1].expand_as(edges))], dim=1)
        start = torch.cat([start, around[:, 0]], dim=1)
    normal = torch.nn.functional.normalize(normal, dim=-1)
    return normal, (normal * start).sum(-1)


def blocked(start: Tensor, ahead: Tensor, normal: Tensor, offset: Tensor) -> Tensor:
    """Which lines (R, P) from ``start`` (R, P, 3) over ``ahead`` (R, P, 3), to its end, meet a convex body
    (`planes`)."""
    shape = np.broadcast_shapes(start.shape, ahead.shape, (len(normal), 1, 3))[:-1]
    enter = start.new_full(shape, TOUCHING)
    leave = start.new_full(shape, 1 - TOUCHING)
    for k in range(normal.shape[1]):
        room = offset[:, k, None] - (start @ normal[:, k, :, None])[..., 0]
        speed = (ahead @ normal[:, k, :, None])[..., 0]
        still = speed.abs() < TOUCHING * 1e-3
        reach = room / torch.where(still, 1.0, speed)
        enter = torch.where(
            still,
            torch.where(room < -TOUCHING, torch.inf, enter),
            torch.where(speed < 0, torch.maximum(enter, reach), enter),
        )
        leave = torch.where(~still & (speed > 0), torch.minimum(leave, reach), leave)
    return enter <= leave + TOUCHING
