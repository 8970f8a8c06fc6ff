"""Sources that are discs: how finely the light of each pair of facet and instant has to be summed over them.

A disc of angular radius r moves the half vector by up to r / (2 cos(phase / 2)). Over it the logarithm of a lobe is close to
z x - q (x^2 + y^2) / 2, with x, y on the unit disc, z its slope and q its curvature across the disc. The error of a rule
for the mean over the disc, over the largest value on it, is then at most A s^p with s^2 = z^2 + 2 q (`RULE_ERRORS`, the
suprema over z to 30 and q to 20). What lobes leave out is held to LEFT_OUT of the light of their row. Away from glints,
and for wide lobes near them, the middle of the disc will do.

Letters: K pairs of a row, B batch, T rows, D points of a disc, M pairs that are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, projected
from torchlc.brdf.base import Brdf
from torchlc.stages.light import Disc, Surface

LEFT_OUT, LEFT_OUT_MAG = 5e-6, 1e-4
"""Share of a row's light that the lobes of its pairs may leave out together, and what is stated, mag: cosines and Fresnel's
factor curve over the disc too, by some times r^2 = 2e-5. A tenth of the share costs a tenth more."""
RULE_ERRORS = ((0.12, 2.0), (0.0026, 4.0))
"""A and p of a rule's error for the middle of the disc and for one ring of 5 points, its first rule. What needs more gets the
finest: pairs that another rule between them would serve are too few to be worth its passes."""
KINK = 0.25
"""Mean of the smaller of 0 and a disc's coordinate, in radii of it: what the middle leaves out at the kink of min(mu0, mu)."""
FADING = 4.0
"""Share of what is allowed, 1 / FADING, from which on a pair goes over to the next rule; all of the way at what is allowed."""
BESIDE = 0.25
"""Radii of the disc beyond a kink of the light within which pairs go over to the finest rule."""
STEEPEST = 60.0
"""Slope beyond which a lobe is always summed finely; its exponential stays finite."""


@dataclass(frozen=True)
class DiscPairs:
    """Pairs of facet and instant in the light of a disc, each field (B or 1, K, T).

    su, sv, ci: the direction to the middle of the disc along the facet's u, its v and its normal, turned to the
    observer's side; ou, ov, cr: the observer's. ``radius``: of the disc, rad. ``share``: what of ``area`` (B or 1, 1, T) is
    turned to the observer and not hidden from either. Tables are made as if all of ``area`` were turned the way of each pair:
    what a pair asks for then does not depend on which facets share it.
    """

    disc: Disc
    model: type[Brdf]
    su: Tensor
    sv: Tensor
    ci: Tensor
    ou: Tensor
    ov: Tensor
    cr: Tensor
    radius: Tensor
    share: Tensor
    area: Tensor

    @property
    def shape(self) -> torch.Size:
        """(K, T)."""
        return self.ci.shape[-2:]

    def picked(self, member: Tensor) -> DiscPairs:
        """Those of the geometries that ``member`` (B,) names."""

        def of_members(tensor: Tensor) -> Tensor:
            return tensor[member] if len(tensor) > 1 else tensor

        values = {each.name: getattr(self, each.name) for each in fields(self)}
        tensors = {name: of_members(value) for name, value in values.items() if isinstance(value, Tensor)}
        return replace(self, **tensors)

    def middle(self) -> Mapping[str, Tensor]:
        """Table of the middle of the disc, every pair a column (B or 1, 1, K T)."""
        angles = _angles(self.su, self.sv, self.ci, self.ou, self.ov, self.cr)
        weight = self.area * (torch.minimum(self.ci, self.cr) > 0)
        columns = (angle.flatten(-2)[..., None, :] for angle in vars(angles).values())
        return self.model.tabulate(Incidence(*columns), weight.flatten(-2)[..., None, :])

    def weights(
        self, specular: Tensor, brightest: Tensor, variance: Tensor | None
    ) -> list[tuple[int, Tensor]]:
        """The disc's first and finest rule, and how far a pair goes over to it from the one before, which for the first is the
        middle: (B or 1, K, T) each, 0 to 1. They are continuous, so that light is, and a difference finds its slope.

        specular (B or 1, K, T): lobe light of the middle as of :meth:`middle`; brightest (B or 1, T): light of the row;
        variance (B or 1, 1, 1): of the narrowest lobe that the material has, rad^2, None if it is not known.
        """
        ci, cr, radius = self.ci, self.cr, self.radius
        rules = dict.fromkeys((0, len(self.disc.rules) - 1))
        there = (ci > -radius) & (cr > 0) & (self.share.detach() > 0)
        if variance is None:
            return [(rule, there.to(ci)) for rule in rules]
        across_u, across_v = self.su + self.ou, self.sv + self.ov
        across, ahead = across_u.square() + across_v.square(), (ci + cr).clamp(min=1e-15)
        tan2 = across / ahead.square()
        reach2 = radius.square() / (across + ahead.square()).clamp(min=1e-6)
        # the slope of lobes that are Gaussians of the tangent, which are steeper than cosine powers
        slope2 = (tan2 * (1 + tan2).square() * reach2 / variance.square()).clamp(1e-30, STEEPEST**2)
        square = slope2 + 2 * reach2 / variance
        light = specular * (ci > 0) * torch.exp(torch.sqrt(slope2))
        allowed = (LEFT_OUT * brightest[..., None, :]).clamp(min=1e-300)
        horizon = _risen((1 + BESIDE - ci.abs() / radius) / BESIDE)
        kink = _risen((1 + BESIDE - (ci - cr).abs() / radius) / BESIDE)
        kink = kink * _faded(KINK * specular * radius / torch.maximum(ci, radius) / allowed)
        finest = torch.maximum(horizon, kink)
        shares = []
        for rule, (factor, power) in zip(rules, RULE_ERRORS, strict=False):
            error = light * (factor * square ** (power / 2)).clamp(max=1.0)
            shares.append((rule, torch.where(there, torch.maximum(finest, _faded(error / allowed)), 0.0)))
        return shares

    def of_columns(self, columns: Tensor, which: tuple[Tensor, ...] | None) -> Tensor:
        """What the columns of :meth:`middle` have, (K T,) or (B, K T), for the pairs of :meth:`over`, (M, 1)."""
        if which is None:
            return columns.reshape(-1, 1)
        batch, pair, row = which
        column = pair * self.shape[1] + row
        return (columns[column] if columns.ndim == 1 else columns[batch, column])[:, None]

    def over(self, rule: int, which: tuple[Tensor, ...] | None) -> Mapping[str, Tensor]:
        """Table (M, D, 1) of the pairs ``which`` (indices into (B, K, T)) over the disc by one of its rules, or of all of a
        single geometry, (K T, D, 1)."""

        places: dict[tuple[bool, bool], Tensor] = {}

        def chosen(tensor: Tensor) -> Tensor:
            whole = tensor.expand(*tensor.shape[:-1], self.shape[1])
            if which is None:
                return whole.expand(*whole.shape[:-2], *self.shape).reshape(-1)
            batch, pair, row = which
            apart = len(whole) > 1, whole.shape[-2] > 1
            if apart not in places:
                index = (
                    batch * whole.shape[-2] + (pair if apart[1] else 0) if apart[0] else pair * int(apart[1])
                )
                places[apart] = index * self.shape[1] + row
            return whole.reshape(-1).index_select(0, places[apart])

        middle, observer = (
            tuple(chosen(tensor) for tensor in local)
            for local in ((self.su, self.sv, self.ci), (self.ou, self.ov, self.cr))
        )
        su, sv, ci = self.disc.beside(middle, chosen(self.radius), rule, observer)
        ou, ov, cr = (tensor[:, None] for tensor in observer)
        angles = _angles(su, sv, ci, ou, ov, cr)
        weight = chosen(self.area)[:, None] * self.disc.rules[rule][1] * (torch.minimum(ci, cr) > 0)
        return self.model.tabulate(
            Incidence(*(angle[..., None] for angle in vars(angles).values())), weight[..., None]
        )


@dataclass(frozen=True)
class DiscSurface(Surface):
    """Patches in the light of a disc: the table and the phase angle are of its pairs one by one (:meth:`DiscPairs.middle`),
    whose light is yet to be spread over the disc and summed."""

    discs: DiscPairs = field(kw_only=True)

    @classmethod
    def of(cls, pairs: DiscPairs, phase_angle: Tensor, key: tuple[str, str, bool, str | None]) -> DiscSurface:
        """``phase_angle`` is of the rows, (T,) or (B, T)."""
        component, material, sunlit, scale = key
        each = phase_angle.repeat(*(1,) * (phase_angle.ndim - 1), pairs.shape[0])
        return cls(component, material, pairs.model, pairs.middle(), each, sunlit, scale, discs=pairs)

    def over(self, rule: int, which: tuple[Tensor, ...] | None) -> Surface:
        """Pairs as of :meth:`DiscPairs.over`, each a batch of one column."""
        phase_angle = self.discs.of_columns(self.phase_angle, which)
        table = self.discs.over(rule, which)
        return Surface(self.component, self.material, self.model, table, phase_angle, self.sunlit, self.scale)


def _risen(x: Tensor) -> Tensor:
    """0 below 0, 1 above 1, and smooth between."""
    x = x.clamp(0.0, 1.0)
    return x * x * (3 - 2 * x)


def _faded(error: Tensor) -> Tensor:
    """How much of a finer rule is taken where a coarser one has this error, over what is allowed: all of it from there on."""
    return _risen((FADING * error.clamp(max=1.0) - 1) / (FADING - 1))


def _angles(su: Tensor, sv: Tensor, ci: Tensor, ou: Tensor, ov: Tensor, cr: Tensor) -> Incidence:
    along_u, along_v = su + ou, sv + ov
    square = along_u.square() + along_v.square() + (ci + cr).square()
    return projected(ci, cr, along_u, along_v, square)
