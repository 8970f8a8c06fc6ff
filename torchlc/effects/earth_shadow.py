"""The Earth's limb covers the Sun."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.geometry.orbit.shadow import EARTH_RADIUS_KM, SUN_RADIUS_KM
from torchlc.geometry.orbit.sunlight import (
    LEAST_STRIPS,
    MOST_STRIPS,
    REFRACTIVITY,
    Limb,
    softened_fraction,
    sunlit_fraction,
)
from torchlc.parameters import Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.instants import Instants
from torchlc.stages.showing import ECLIPSE, Shown
from torchlc.tensors.autodiff_state import readable, traced

GREEN_NM = 550.0
"""To which the height of the edge belongs: the middle of the visible."""
RAYLEIGH_POWER = 4.0
"""Of the wavelength: scattering by molecules goes as its inverse."""
SOFTEST_HARD_KM = 1.0
"""Scale height below which the edge is taken as hard: in a low orbit its mean lies 0.6 km higher, 0.1 s of an entry."""
STRIP_HEIGHTS = 1.5
"""Scale heights from strip to strip of the Sun's disc: a sum of a smooth function of that step is within 1e-5 of its
integral (the transform of a Gumbel density falls as exp(-pi^2 / step))."""
ABOVE_HEIGHTS = 12.0
"""Scale heights above h0 at which 6e-6 of the light is lost."""
AIR_KM = 8.0
"""Scale height of the air near the ground; 6 to 7 km in the stratosphere."""
LEAST_LEFT, TOLD_MAG = 0.05, 0.05
"""Share of sunlight above which a hard edge is compared with a soft one, and the difference that is told."""
CELLS = 4
"""Cells for averaging over an exposure while the limb crosses the Sun's disc, with CELL_NODES Gauss-Legendre times each."""
CELL_NODES = 4
MOST_CELLS = 200
"""Of one exposure: it then crosses 50 discs of the Sun."""
SHIFT_STEP_S, SHIFT_BEND_KM = 60.0, 5.0
"""Steps by which a clock is moved to see where it may bring an object into the shadow; and what the height of a ray bends by
within one: in the lowest orbit, of 1.2e-3 rad/s and 6,500 km, by 9e-3 km/s^2 x 60^2 / 8 = 4.2 km."""


class EarthShadow(Effect):
    """Umbra and penumbra of the oblate Earth raised by h0 of opaque air: total, for up to 72 min at GEO near
    the equinoxes.

    The edge of the air is hard unless the scene sets scale_height, in low orbits about 8 km: optical depth then falls as
    exp(-(z - h0) / scale_height) with the height z at which a ray passes, h0 being where it is 1. A hard edge is within
    0.007 mag of that at GEO where a twentieth of the light is left, and up to 0.7 mag off in low orbits. Setting refraction = 1
    adds the bending and spreading of light, up to 1.1 deg into the umbra. In light of another wavelength h0 lies higher or
    lower by 4 scale heights times ln(550 nm / wavelength), as Rayleigh's law has it. Within an exposure the share of sunlight
    is averaged under a polynomial of the rest of the light. Neglects the change of scale_height with
    height, clouds and ozone, and twilight.
    """

    name = "earth_shadow"
    title = "the shadow of the Earth"
    shown = Shown(ECLIPSE, "shadow_coordinate")
    stage = "shade"
    opaque_air = "h0"
    known = True
    quantities = (
        Quantity(
            "h0", "km", 0.0, 60.0, "height of the opaque air over the Earth", typical=20.0,
            prior="normal", mean=20.0, sigma=15.0,
        ),
        Quantity(
            "scale_height", "km", 0.0, 20.0, "scale height of the air at its edge; below 1 a hard edge",
            typical=8.0, prior="normal", mean=8.0, sigma=1.0, unless_set=0.0,
        ),
        Quantity(
            "refraction", "", 0.0, 1.5, "bending by the air over that of the Earth's; needs scale_height", typical=1.0,
            prior="normal", mean=1.0, sigma=0.1, unless_set=0.0,
        ),
        Quantity(
            "wavelength", "nm", 300.0, 1100.0, "of the light, for h0 is that at 550 nm; needs scale_height", typical=550.0,
            unless_set=550.0,
        ),
    )  # fmt: skip

    def missing(self, context):
        return None if context.track.supports("position") else "the recording gives no geocentric position"

    def prepared(self, context):
        low, high = (
            [context.bounds[self.full_name(name)][side] for name in ("h0", "scale_height", "refraction")]
            for side in (0, 1)
        )
        reddest, bluest = (
            RAYLEIGH_POWER * high[1] * math.log(GREEN_NM / nm)
            for nm in reversed(context.bounds[self.full_name("wavelength")])
        )
        self.soft, self.always_soft = high[1] >= SOFTEST_HARD_KM, low[1] >= SOFTEST_HARD_KM
        self.bends = self.soft and high[2] > 0
        softest = high[1] if self.soft else 0.0
        self.lowest, self.highest = low[0], high[0]
        if self.soft:
            self.lowest = low[0] + min(reddest, 0.0) - 4 * softest
            self.highest = high[0] + max(bluest, 0.0) + ABOVE_HEIGHTS * softest
        state = context.track.at(0.0, 0.0, 0.0)
        assert state.position is not None
        farthest = float(torch.linalg.vector_norm(state.position, dim=-1).max())
        if self.bends:
            scale = max(low[1], SOFTEST_HARD_KM)
            bent = high[2] * REFRACTIVITY * math.sqrt(2 * math.pi * EARTH_RADIUS_KM / scale)
            below = max(self.lowest, -scale)
            self.lowest = below - farthest * bent * math.exp(-below / scale)
            self.highest = max(self.highest, softest * math.log(1e5 * max(farthest * bent / scale, 1.0)))
        sun_km = farthest * SUN_RADIUS_KM / float(torch.linalg.vector_norm(state.sun, dim=-1).min())
        step = STRIP_HEIGHTS * max(low[1], SOFTEST_HARD_KM)
        self.strips = min(max(LEAST_STRIPS, math.ceil(math.pi * sun_km / step)), MOST_STRIPS)
        self.moved = context.turned("clock", "orbit")
        exposure = torch.zeros_like(context.seconds)
        if any(effect.spans_exposure for effect in context.effects):
            exposure = (
                torch.full_like(exposure, context.cadence) if context.exptime is None else context.exptime
            )
        self.lit, self.dark, self.crossed = self._stands(context, exposure)
        if self.moved:
            self.lit = self._lit_whenever(context, exposure)
        self.always_lit = bool(self.lit.all())
        return self

    def _lit_whenever(self, context, exposure: Tensor) -> Tensor:
        """Rows (T,) that are in full sunlight throughout exposures (T,) s wherever within its bounds a clock's offset puts them;
        none if anything but clocks moves the object. Between two steps the height is allowed to fall as far below the lower end
        as the other stands above it, and SHIFT_BEND_KM."""
        movers = [
            effect
            for effect in context.effects
            if replace(context, effects=[effect]).turned("clock", "orbit")
        ]
        lit = torch.ones_like(exposure, dtype=torch.bool)
        if not all(effect.shifts_clock for effect in movers):
            return ~lit
        ends = [context.bounds[effect.full_name(effect.quantities[0].name)] for effect in movers]
        low, high = (sum(end[side] for end in ends) for side in (0, 1))
        reach = 0.5 * float(exposure.max())
        steps = max(1, math.ceil((high - low + 2 * reach) / SHIFT_STEP_S))
        last = None
        for shift in np.linspace(low - reach, high + reach, steps + 1).tolist():
            state = context.track.at(shift, shift, 0.0)
            assert state.position is not None
            height = Limb.seen(state.position, state.sun).altitude()
            if last is not None:
                lit = lit & (
                    torch.minimum(last, height) - (height - last).abs() > self.highest + SHIFT_BEND_KM
                )
            last = height
        return lit

    def _stands(self, context, reach: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows (T,) that are in full sunlight and in the umbra throughout ``reach`` (T,) s, whatever the parameters are; and
        how much of the Sun's disc (T,) the limb crosses meanwhile."""
        offset = torch.tensor([-0.5, 0.0, 0.5], dtype=reach.dtype)[:, None] * reach
        state = context.track.at(offset, offset, 0.0)
        assert state.position is not None
        low, high = Limb.seen(state.position, state.sun).heights()
        disc = torch.where(torch.isfinite(low), high - low, 1.0)
        moved = torch.where(torch.isfinite(low), low, high.clamp(max=1e6))
        crossed = ((moved.amax(0) - moved.amin(0)) / disc.amin(0)).clamp(max=1e3)
        # a straight line between three times, hence the margin
        margin = 1.0 + 0.2 * crossed * disc.amax(0)
        if self.moved:
            nothing = torch.zeros_like(reach, dtype=torch.bool)
            return nothing, nothing, crossed
        lit = low.amin(0) > self.highest + margin
        dark = ~lit & (high.amax(0) < self.lowest - margin)
        return lit, dark, crossed

    def _standing(self, position: Tensor, sun: Tensor, instants: Instants | None) -> tuple[Tensor, Tensor]:
        """Columns (..., C) whose rows are in full sunlight and in the umbra, whatever the air is, at places (..., Q, C, 3) that
        free numbers move."""
        low, high = Limb.seen(position.detach(), sun.detach()).heights()
        low, high = low.amin(-2), high.amax(-2)
        crossed = self.crossed
        if instants is not None:
            row = instants.row.expand(low.shape)
            blank = low.new_zeros(*low.shape[:-1], len(crossed))
            low = blank.scatter_reduce(-1, row, low, "amin", include_self=False).gather(-1, row)
            high = blank.scatter_reduce(-1, row, high, "amax", include_self=False).gather(-1, row)
            crossed = crossed[instants.row]
        disc = torch.where(torch.isfinite(low), high.clamp(max=1e6) - low.clamp(max=1e6), 0.0)
        margin = 1.0 + 0.2 * crossed * disc
        lit = low > self.highest + margin
        return lit, ~lit & (high < self.lowest - margin)

    def limits(self, p, context):
        if self.soft:
            return ()
        state = context.track.at(0.0, 0.0, 0.0)
        assert state.position is not None
        hard = sunlit_fraction(state.position, state.sun, p["h0"])
        scale = torch.full_like(p["h0"], AIR_KM)
        # where half of the light is left, both edges are at one height
        soft = softened_fraction(state.position, state.sun, p["h0"] + AIR_KM * math.log(math.log(2)), scale)
        partly = (hard > LEAST_LEFT) & (soft > LEAST_LEFT)
        change = torch.where(partly, 2.5 * torch.log10(torch.where(partly, soft / hard, 1.0)).abs(), 0.0)
        wrong = change > TOLD_MAG
        if not bool(wrong.any()):
            return ()
        return (
            f"earth_shadow: the air's edge is taken as hard; one that is {AIR_KM:g} km soft changes {number_of(int(wrong.sum()), 'row')} in the "
            f"penumbra by up to {float(change.max()):.2g} mag. Set earth_shadow.scale_height = {AIR_KM:g} for it",
        )

    def change(self, context, reach):
        lit, dark, crossed = self._stands(context, reach)
        if self.moved:
            lit = self.lit
        return torch.where(lit | dark, 0.0, crossed)

    def shade(self, sky, p, context):
        instants = sky.instants
        position, sun, weight = sky.state.position, sky.state.sun, sky.nodes.weight
        assert position is not None  # see `missing`
        if self.always_lit:
            return torch.ones_like(p["h0"]) if traced() else p["h0"].new_ones(())
        row = torch.arange(len(self.lit), device=self.lit.device) if instants is None else instants.row
        lit, dark = self._standing(position, sun, instants) if self.moved else (self.lit[row], self.dark[row])
        columns = len(row)
        # where a transform hides who is at the edge, all are taken as if they were
        edge = ~(lit | dark)
        everywhere = torch.ones(columns, dtype=torch.bool, device=edge.device)
        edge = edge.reshape(-1, columns).any(0) if readable(edge) else everywhere
        weight = weight.expand(*weight.shape[:-1], columns)
        seen = partial(self._seen, p)
        pieces: list[tuple[Tensor, Tensor]] = []
        for index, rule in _groups(instants, edge, self.crossed):
            if rule is None:
                light = seen(position[..., index, :], sun[..., index, :], index)
                share = weight[..., index] / weight[..., index].sum(-2, keepdim=True)
                pieces.append((index, (share * light).sum(-2)))
                continue
            # a row's panel at a time: from its q instants to M finer ones and back
            to_fine, back = (matrix.to(position) for matrix in rule)
            positions, towards = (
                torch.einsum("mq,...nqc->...nmc", to_fine, vectors[..., index, :])
                for vectors in (position, sun)
            )
            light = seen(positions, towards, index[:, :1].expand(-1, len(to_fine)))
            mean = torch.einsum("qm,...nm->...nq", back, light).flatten(-2)
            pieces.append((index.flatten(), mean.mean(-2)))
        shape = np.broadcast_shapes(*(lights.shape[:-1] for _, lights in pieces), p["h0"].shape[:-1])
        shape = np.broadcast_shapes(shape, lit.shape[:-1])
        factor = torch.where(dark, 0.0, p["h0"].new_ones(columns)).expand(*shape, columns)
        if not pieces:
            return factor
        index = torch.cat([rows for rows, _ in pieces])
        light = torch.cat([lights.expand(*shape, -1) for _, lights in pieces], -1)
        factor = factor.index_copy(-1, index, light)
        return torch.where(lit, 1.0, torch.where(dark, 0.0, factor)) if self.moved else factor

    def _seen(self, p, position: Tensor, sun: Tensor, column: Tensor) -> Tensor:
        """Share of sunlight (..., Q, n) at places (Q, n, 3) of ``column`` (n,)."""

        def number(name: str) -> Tensor:
            value = p[name]
            value = (
                value[..., column]
                if value.shape[-1] > 1
                else value.reshape(*value.shape[:-1], *(1,) * column.ndim)
            )
            return value.unsqueeze(-1 - column.ndim)

        h0 = number("h0")
        if not self.soft:
            return sunlit_fraction(position, sun, h0)
        scale = number("scale_height")
        safe = scale.clamp(min=SOFTEST_HARD_KM)
        level = h0 + RAYLEIGH_POWER * safe * torch.log(GREEN_NM / number("wavelength"))
        soft = softened_fraction(
            position, sun, level, safe, number("refraction") if self.bends else None, self.strips
        )
        return (
            soft
            if self.always_soft
            else torch.where(scale >= SOFTEST_HARD_KM, soft, sunlit_fraction(position, sun, h0))
        )


def _groups(
    instants: Instants | None, edge: Tensor, crossed: Tensor
) -> Sequence[tuple[Tensor, tuple[Tensor, Tensor] | None]]:
    """Columns at the shadow's edge: those (n,) that stand for themselves, without a rule, and panels (n, q) of as many
    instants, with the matrices of :func:`_averaging`."""
    if not readable(edge):  # shapes alone are asked for
        return [(torch.arange(len(edge), device=edge.device), None)]
    index = torch.nonzero(edge)[:, 0]
    if instants is None:
        return [(index, None)] if len(index) else []
    panel, _, count = torch.unique_consecutive(instants.panel[index], return_inverse=True, return_counts=True)
    ends = count.cumsum(0)
    groups: list[tuple[Tensor, tuple[Tensor, Tensor] | None]] = []
    discs = crossed[instants.row[index[ends - 1]]] * instants.span[panel]
    cells = (CELLS * discs).ceil().long().clamp(1, MOST_CELLS)
    # powers of two, so that few groups are needed
    cells = 2 ** torch.log2(cells.double()).ceil().long()
    for q in torch.unique(count).tolist():
        for number in torch.unique(cells[count == q]).tolist() if q > 1 else [1]:
            chosen = torch.nonzero((count == q) & ((cells == number) | (q == 1)))[:, 0]
            members = index[(ends[chosen] - q)[:, None] + torch.arange(q, device=index.device)]
            groups.append((members[:, 0], None) if q == 1 else (members, _averaging(q, number)))
    return groups


@cache
def _averaging(count: int, cells: int) -> tuple[Tensor, Tensor]:
    """(M, count), which takes values at Gauss-Legendre nodes of a panel to M finer times by the polynomial through them; and
    (count, M), which takes a share of light at these times to one at each node: the node's polynomial averaged under it.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    x, w = np.polynomial.legendre.leggauss(CELL_NODES)
    start = np.linspace(-1, 1, cells + 1)[:-1]
    fine = (start[:, None] + (1 + x) / cells).ravel()
    share = np.tile(0.5 * w / cells, cells)
    powers = np.arange(count)
    # Legendre polynomials are orthogonal on these nodes, so that no system has to be solved
    at_nodes = np.polynomial.legendre.legvander(nodes, count - 1)
    at_fine = np.polynomial.legendre.legvander(fine, count - 1)
    to_fine = (at_fine * (powers + 0.5)) @ (at_nodes.T * weights)
    back = (to_fine * share[:, None]).T / (0.5 * weights[:, None])
    return torch.as_tensor(to_fine), torch.as_tensor(back)
