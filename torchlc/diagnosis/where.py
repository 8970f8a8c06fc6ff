"""Where the named effects act: intervals in time, components, and the coordinate along which their trace
collapses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchlc.diagnosis.discrepancy import Discrepancy
from torchlc.diagnosis.gate import runs
from torchlc.diagnosis.hypotheses import carried
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.posterior import STEPS, descend
from torchlc.noise import Noise, Residuals
from torchlc.noise.error_law import MAG_PER_LN

BINS = 12
"""Straight pieces of a curve along a coordinate: a glint that takes a tenth of its range has a knot within; each has 15 rows at least."""
FOLDS = 4
"""Parts of the rows that are foreseen from the others, each in five runs of rows: single rows would be told by their neighbours."""
SEEN_SIGMA = 2.0
"""Errors of a row from which on a difference is located: what moves a row by less is hardly told from its noise, and one in twenty by chance."""
SHORT_GAP = 2
"""Rows within an interval that may be less: a difference that changes its sign passes through zero in one or two."""


@dataclass(frozen=True)
class Where:
    """``rows`` (T,) marked; intervals as (first row, last row, significance in sigma); shares by component;
    the best coordinate with its range, and the share of variance that each coordinate explains in held-out
    rows."""

    rows: Tensor
    intervals: Sequence[tuple[int, int, float]]
    components: Sequence[tuple[str, float]]
    coordinate: tuple[str, float, float] | None
    ranking: Mapping[str, float]


class Weighed(Posterior):
    """A posterior whose rows have given standard deviations (T,)."""

    def __init__(self, likelihood: Likelihood, sigma: Tensor) -> None:
        super().__init__(likelihood, scaled=False)
        self.sigma = sigma

    def residuals(self, g: Tensor) -> Residuals:
        residuals = super().residuals(g)
        return replace(residuals, sigma=self.sigma.expand(residuals.delta.shape))


@torch.no_grad()
def refitted(before: Fitted, after: Fitted, others: Sequence[Fitted] = ()) -> Tensor:
    """Residuals (T,) of the model of ``before``, fitted by least squares to the rows as they err in ``after``: a law with bad rows of
    its own would call bad, and what rows share would take up, what ``after`` explains. From the minima that the same model has under any law of the rows, ``others``, where that
    is not dear."""
    posterior = Weighed(before.likelihood, after.sigma)
    starts = [minimum.g[: posterior.own] for minimum in before.minima]
    known = (
        [after]
        if before.posterior.dear
        else [after, *(minimum for other in others for minimum in other.minima)]
    )
    parameters = before.model.parameter_set
    starts += [
        posterior.coordinates(carried(parameters, fitted.theta[None], fitted.names)[0]) for fitted in known
    ]
    for start in starts:
        start[posterior.noise_columns] = starts[0][posterior.noise_columns]
    g = descend(posterior, torch.stack(starts), STEPS, Noise())[0][0]
    return posterior.residuals(g).delta


def locate(
    before: Fitted,
    after: Fitted,
    bare: Fitted,
    coordinates: Mapping[str, Tensor],
    others: Sequence[Fitted] = (),
) -> Where:
    """Where ``after`` and the model of ``before``, each fitted, differ by more than SEEN_SIGMA of a row, or where none does, by half of the
    largest difference; ``bare`` is the first without its effects, ``others`` the model of ``before`` under other laws of the rows."""
    difference = (refitted(before, after, others) - after.delta) / after.wide
    size = difference.abs()
    rows = size > SEEN_SIGMA
    if not bool(rows.any()):
        rows = size > size.max() / 2
    return Where(
        rows,
        intervals(rows, difference, after),
        component_shares(bare, after, rows),
        *best_coordinate(difference, coordinates, rows),
    )


def rows_of_unknown(odd: Discrepancy, beside: Fitted, alike: Fitted, quoted: Fitted) -> Tensor:
    """Rows (T,) where something unknown and the effects that it is beside, which stand in for a part of it, together change the light by more
    than SEEN_SIGMA errors of the scene's own model, fitted ``alike`` under the same noise and as ``quoted``."""
    shown = odd.curve + (alike.delta - beside.delta) / quoted.scale
    return shown.abs() > SEEN_SIGMA * torch.maximum(odd.band, quoted.wide / quoted.scale)


def intervals(rows: Tensor, strength: Tensor, refit: Fitted) -> list[tuple[int, int, float]]:
    """Runs of marked rows in time order within each station, with the root sum of squares of their
    strength."""
    context = refit.model.assembly.context
    stretches = []
    for station in torch.unique(context.station).tolist():
        index = torch.nonzero(context.station == station)[:, 0]
        index = index[torch.argsort(context.seconds[index])]
        for first, last in joined(runs(rows[index])):
            inside = index[first : last + 1]
            stretches.append(
                (int(inside[0]), int(inside[-1]), float(torch.linalg.vector_norm(strength[inside])))
            )
    return stretches


def joined(pieces: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Runs of rows with those that at most SHORT_GAP rows part made one: a crossing of zero ends no
    interval."""
    merged: list[tuple[int, int]] = []
    for first, last in pieces:
        if merged and first - merged[-1][1] - 1 <= SHORT_GAP:
            merged[-1] = (merged[-1][0], last)
        else:
            merged.append((first, last))
    return merged


def component_shares(bare: Fitted, after: Fitted, rows: Tensor) -> list[tuple[str, float]]:
    """Share of each component in the sum of |change of flux| / sigma over the marked rows, largest first, as effects change
    it while every material stays: a refit without them would blame those whose materials take up the slack."""
    light = []
    for fitted in (bare, after):
        with torch.no_grad():
            brightness = fitted.model.brightness(fitted.theta, shares=True)
        assert brightness.shares is not None  # asked for
        light.append(dict(zip(brightness.components, brightness.shares * brightness.flux, strict=True)))
    with torch.no_grad():
        total = after.model.brightness(after.theta).flux
    sigma = total * after.wide / after.scale / MAG_PER_LN
    names = list(dict.fromkeys([*light[0], *light[1]]))
    pick = rows if bool(rows.any()) else torch.ones_like(rows)
    zero = torch.zeros_like(total)
    change = {
        name: float(((light[1].get(name, zero) - light[0].get(name, zero)).abs() / sigma)[pick].sum())
        for name in names
    }
    whole = sum(change.values())
    if not whole:
        return []
    return sorted(((name, value / whole) for name, value in change.items()), key=lambda item: -item[1])


def best_coordinate(
    strength: Tensor, coordinates: Mapping[str, Tensor], rows: Tensor
) -> tuple[tuple[str, float, float] | None, dict[str, float]]:
    """The coordinate whose piecewise-linear curve explains most of the variance in rows it has not seen, with
    the range in which the marked rows lie."""
    ranking = {name: held_out_r2(strength, value) for name, value in coordinates.items()}
    if not ranking:
        return None, {}
    best = max(ranking, key=lambda name: ranking[name])
    inside = coordinates[best][rows] if bool(rows.any()) else coordinates[best]
    low, high = torch.quantile(inside, torch.tensor([0.05, 0.95], dtype=inside.dtype)).tolist()
    return (best, low, high), dict(sorted(ranking.items(), key=lambda item: -item[1]))


def held_out_r2(value: Tensor, coordinate: Tensor) -> float:
    """Share of variance explained in held-out runs of rows by a piecewise-linear curve of the coordinate, at
    most 1."""
    total = len(value)
    order = torch.argsort(coordinate)
    x = torch.empty(total, dtype=value.dtype)
    x[order] = torch.linspace(0, 1, total, dtype=value.dtype)
    bins = min(BINS, max(2, total // 15))
    knots = x[:, None] * bins - torch.arange(bins + 1, dtype=value.dtype)
    basis = (1 - knots.abs()).clamp(min=0)
    fold = (torch.arange(total) * 5 * FOLDS // total) % FOLDS
    missed = 0.0
    for number in range(FOLDS):
        train, test = fold != number, fold == number
        a = basis[train]
        system = a.T @ a + 1e-3 * max(len(a), 1) / bins * torch.eye(bins + 1, dtype=value.dtype)
        weight = torch.linalg.solve(system, a.T @ value[train])
        missed += float(((value[test] - basis[test] @ weight) ** 2).sum())
    return 1 - missed / float((value**2).sum().clamp(min=1e-300))


def as_json(where: Where, times: Sequence[str], stations: Sequence[str]) -> dict[str, Any]:
    """The ``where`` of diagnosis.json from row times (T,) and each row's station id."""
    name, low, high = where.coordinate if where.coordinate is not None else (None, None, None)
    return {
        "intervals": [
            {"start": times[a], "end": times[b], "station": stations[a], "significance": s}
            for a, b, s in where.intervals
        ],
        "components": [{"name": component, "share": share} for component, share in where.components],
        "coordinate": None if name is None else {"name": name, "from": low, "to": high},
    }
