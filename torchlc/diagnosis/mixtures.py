"""Probed values of effects that add light in proportion to several reflectances: how much of each is solved for, and only where the
light goes is tried."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.effects import effect_class
from torchlc.parameters import Quantity
from torchlc.tensors.non_negative import non_negative

HALF = 0.5
"""Reflectance at which the light of each is worked out."""
BRIGHT = 0.6
"""Sum of the reflectances that are begun with, where the size of what shines allows it: size and reflectances are one number nearly."""
APART_SD = 0.7
"""Standard deviations of the priors, over all but size and reflectances, that two places must be apart to count as different."""
PLACES = 600
"""Places that are tried where more than one number says where the light goes: of direction and exponent one in 20 by 20 deg and a factor of 10."""
LINE_PLACES = 96
"""Places where an exponent alone says it: one in 15 %."""
FINER_PLACES, FINER, FINER_SD = 6, 12, (0.3, 0.12)
"""Of these the best, around each of which so many more are tried, in rounds of so many standard deviations of the prior."""


@dataclass(frozen=True)
class Mixture:
    """Columns of an effect's values psi (G, k): the ``size`` of what shines, with its quantity, and its ``parts``, reflectances in
    proportion to which it shines."""

    size: int
    quantity: Quantity
    parts: tuple[int, ...]

    @classmethod
    def of(cls, entry: str, names: Sequence[str]) -> Mixture | None:
        """That of an effect some of whose numbers, ``names``, are free; None where it has none, or not all of it is free."""
        kind = effect_class(entry)
        sizes = [quantity for quantity in kind.quantities if quantity.off == 0.0 and quantity.typical]
        if not kind.simplex or len(sizes) != 1 or not {sizes[0].name, *kind.simplex} <= set(names):
            return None
        return cls(names.index(sizes[0].name), sizes[0], tuple(names.index(name) for name in kind.simplex))

    def where(self, columns: int) -> list[int]:
        """The columns that say where the light goes."""
        return [column for column in range(columns) if column != self.size and column not in self.parts]

    def solved(
        self,
        psi: Tensor,
        change: Callable[[Tensor], Tensor],
        beyond: Callable[[Tensor], Tensor],
        residual: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Values (G, k) with the size and the reflectances that take most off a ``residual``, and their changes of the light (G, T);
        those that no light helps stay as they are. ``change`` gives the change of the light by values, ``beyond`` what of it a fit's own numbers
        cannot take up."""
        size, parts = self.quantity.typical or 0.0, list(self.parts)

        def of_one(part: int) -> Tensor:
            pure = psi.clone()
            pure[:, self.size], pure[:, parts] = size, 0.0
            pure[:, part] = HALF
            return beyond(change(pure))

        columns = torch.stack([of_one(part) for part in parts], -1)  # (G, R, parts)
        weights = non_negative(columns.mT @ columns, torch.einsum("grk,r->gk", columns, residual))
        bright = size * HALF * weights  # size times each reflectance
        enough = torch.clamp(bright.sum(1) / BRIGHT, self.quantity.low, self.quantity.high)
        used = bright.sum(1) > 0
        reflectance = bright / torch.where(used, enough, 1.0)[:, None]
        values = psi.clone()
        values[:, self.size] = enough
        values[:, parts] = reflectance / reflectance.sum(1, keepdim=True).clamp(min=1.0)
        values = torch.where(used[:, None], values, psi)
        return values, change(values)


def finer(
    where: Sequence[int],
    psi: Tensor,
    scores: Tensor,
    coordinates: Callable[[Tensor], Tensor],
    natural: Callable[[Tensor], Tensor],
    solved: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]],
    seed: int,
) -> tuple[Tensor, Tensor]:
    """The best values (N, k) around some of psi (G, k), and their changes of the light (N, T). ``coordinates`` and ``natural`` lead to those of
    the priors and back; ``solved`` gives values with their sizes, changes of the light, and scores."""
    generator = torch.Generator().manual_seed(seed)
    order = torch.argsort(scores, descending=True)
    centre = coordinates(psi[order])
    kept = spread_out(centre[:, where], FINER_PLACES)
    centre, best = centre[kept], scores[order][kept]
    improved: list[tuple[Tensor, Tensor]] = []
    for sd in FINER_SD:
        around = centre.repeat_interleave(FINER, 0)
        off = sd * torch.randn(len(around), len(where), generator=generator, dtype=around.dtype)
        around[:, where] += off
        values, moved, reached = solved(natural(around))
        which = reached.reshape(len(centre), FINER).argmax(1) + FINER * torch.arange(len(centre))
        better = reached[which] > best
        improved.append((values[which][better], moved[which][better]))
        centre = torch.where(better[:, None], around[which], centre)
        best = torch.maximum(best, reached[which])
    return torch.cat([values for values, _ in improved]), torch.cat([moved for _, moved in improved])


def spread_out(g: Tensor, most: int) -> list[int]:
    """Which ``most`` of places (G, k), standard deviations of their priors, best first, are apart from all before them."""
    kept: list[int] = []
    for index in range(len(g)):
        if len(kept) < most and bool(((g[kept] - g[index]).square().sum(-1) >= APART_SD**2).all()):
            kept.append(index)
    return kept
