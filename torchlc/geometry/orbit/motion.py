"""How observer, object and Sun move near each row's time stamp: pure torch, offsets in, places out.

A motion is called with ``offset`` (..., T), seconds after the stamps of its T rows, and gives position and
velocity (..., T, 3) in km and km/s. Buffers follow ``Module.to`` and stay out of ``state_dict``: they are
data, not parameters.
"""

from __future__ import annotations

import copy
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

GM_EARTH = 398600.4418
"""km^3 / s^2"""
KEPLER_ITERATIONS = 12
"""Newton's, of Kepler's equation: 5 leave rounding up to an eccentricity of 0.7, and 12 up to 0.99, anywhere within a revolution."""


class Motion(nn.Module):
    """Base: ``forward(offset (..., T)) -> position, velocity (..., T, 3)``. ``shared`` names the buffers that are not
    one entry a row."""

    shared: ClassVar[tuple[str, ...]] = ()

    def at_rows(self, rows: Tensor) -> Self:
        """The motion about the stamps of some rows (N,), which may repeat."""
        taken = copy.copy(self)
        taken._buffers = {
            name: buffer if name in self.shared or buffer is None else buffer[rows]
            for name, buffer in self._buffers.items()
        }
        return taken

    def _keep(self, **tensors: Tensor) -> None:
        for name, tensor in tensors.items():
            self.register_buffer(name, tensor, persistent=False)


class Straight(Motion):
    """Constant velocity. For the Sun an hour away from a stamp this neglects 0.05"."""

    position: Tensor
    velocity: Tensor

    def __init__(self, position: Tensor, velocity: Tensor) -> None:
        super().__init__()
        self._keep(position=position, velocity=velocity)

    def forward(self, offset: Tensor) -> tuple[Tensor, Tensor]:
        position = self.position + self.velocity * offset[..., None]
        return position, self.velocity.expand_as(position)


class EarthFixed(Motion):
    """A point that turns with the Earth about ``axis`` (T, 3) at ``rate`` rad/s; the axis stays put."""

    along: Tensor
    across: Tensor
    east: Tensor

    def __init__(self, position: Tensor, axis: Tensor, rate: float) -> None:
        super().__init__()
        along = axis * (position * axis).sum(-1, keepdim=True)
        self._keep(along=along, across=position - along, east=torch.linalg.cross(axis, position))
        self.rate = rate

    def forward(self, offset: Tensor) -> tuple[Tensor, Tensor]:
        angle = (self.rate * offset)[..., None]
        cos, sin = torch.cos(angle), torch.sin(angle)
        position = self.along + self.across * cos + self.east * sin
        return position, self.rate * (self.east * cos - self.across * sin)


class TwoBody(Motion):
    """Kepler's motion from each row's ``position`` and ``velocity``, by the change of eccentric anomaly.

    Bound orbits only (Battin 1999, section 4.3). Neglects the Earth's flattening: 20 m after a minute,
    tens of km after an hour in a low orbit.
    """

    position: Tensor
    velocity: Tensor
    axis_km: Tensor
    mean_motion: Tensor

    def __init__(self, position: Tensor, velocity: Tensor) -> None:
        super().__init__()
        axis_km = 1.0 / inverse_semi_major_axis(position, velocity)
        self._keep(
            position=position,
            velocity=velocity,
            axis_km=axis_km,
            mean_motion=torch.sqrt(GM_EARTH / axis_km**3),
        )

    def forward(self, offset: Tensor) -> tuple[Tensor, Tensor]:
        a, n = self.axis_km, self.mean_motion
        radius = torch.linalg.norm(self.position, dim=-1)
        e_cos = 1 - radius / a
        e_sin = (self.position * self.velocity).sum(-1) / torch.sqrt(GM_EARTH * a)
        mean = n * offset
        turn = mean - e_sin * (1 - torch.cos(mean)) + e_cos * torch.sin(mean)
        # no farther from the mean anomaly than twice the eccentricity: beside a perigee a step may go far beyond
        reach = 2 * (e_cos.abs() + e_sin.abs())
        for _ in range(KEPLER_ITERATIONS):
            cos, sin = torch.cos(turn), torch.sin(turn)
            excess = turn + e_sin * (1 - cos) - e_cos * sin - mean
            turn = turn - excess / (1 + e_sin * sin - e_cos * cos)
            turn = torch.minimum(torch.maximum(turn, mean - reach), mean + reach)
        cos, sin = torch.cos(turn), torch.sin(turn)
        radius_after = a * (1 + e_sin * sin - e_cos * cos)
        f, g = 1 - a / radius * (1 - cos), offset - (turn - sin) / n
        f_rate, g_rate = -n * a**2 / (radius * radius_after) * sin, 1 - a / radius_after * (1 - cos)
        position = f[..., None] * self.position + g[..., None] * self.velocity
        return position, f_rate[..., None] * self.position + g_rate[..., None] * self.velocity


def inverse_semi_major_axis(position: Tensor, velocity: Tensor) -> Tensor:
    """1/a, 1/km, (...,), about the Earth; positive for bound orbits (vis-viva)."""
    return 2 / torch.linalg.norm(position, dim=-1) - (velocity**2).sum(-1) / GM_EARTH


class Piecewise(Motion):
    """Polynomials on cells of equal length, turned by each row's ``rotation`` (T, 3, 3).

    ``coefficients`` (C, 3, K), lowest power first, of the fraction of a cell in [0, 1). Row t stands
    ``start[t]`` of a cell after the beginning of cell ``cell[t]``; its offsets lead no further than to the
    cells ``cell[t] + first`` and ``cell[t] + last``.
    """

    shared = ("coefficients",)
    coefficients: Tensor
    cell: Tensor
    start: Tensor
    rotation: Tensor

    def __init__(
        self,
        coefficients: Tensor,
        cell: Tensor,
        start: Tensor,
        rotation: Tensor,
        *,
        step_s: float,
        first: int,
        last: int,
    ) -> None:
        super().__init__()
        self._keep(coefficients=coefficients, cell=cell, start=start, rotation=rotation)
        self.step_s, self.first, self.last = step_s, first, last

    def forward(self, offset: Tensor) -> tuple[Tensor, Tensor]:
        steps = self.start + offset / self.step_s
        whole = torch.floor(steps.detach()).clamp(self.first, self.last)
        fraction = steps - whole
        index = self.cell + whole.long()
        position = self.coefficients[..., -1].mT[:, index]
        velocity = torch.zeros_like(position)
        for k in range(self.coefficients.shape[-1] - 2, -1, -1):  # components first: long stretches of memory
            velocity = torch.addcmul(position, velocity, fraction)
            position = torch.addcmul(self.coefficients[..., k].mT[:, index], position, fraction)
        turn = self.rotation.movedim((-2, -1), (0, 1)).unflatten(-1, (*(1,) * (index.ndim - 1), -1))
        position, velocity = (
            (turn * vector).sum(1).movedim(0, -1).contiguous()
            for vector in (position, velocity / self.step_s)
        )
        return position, velocity
