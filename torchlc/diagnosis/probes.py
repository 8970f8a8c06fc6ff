"""Probes: what an effect would do to a refit, at many values of its parameters, without a refit of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchlc.diagnosis.attitude_search import BODY_AXES, GIVEN_AXIS, Target, jumps, spaced, swings
from torchlc.diagnosis.hypotheses import Workbench, carried, effect_columns, effect_starts
from torchlc.diagnosis.mixtures import LINE_PLACES, PLACES, Mixture, finer, spread_out
from torchlc.effects import effect_class, unlisted
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.stages.entry import Entry

GRID = 24
"""Values that are tried of an effect of one or two parameters, and for each parameter of one that has more."""
MOST_GRID = 120
"""Values of an offset whose parts may lie anywhere within its bounds, where they cost little: 3 deg of a phase, which a glint of a lobe of
exponent 200 is wide."""
MOST_S = 0.5
"""CPU seconds that the values of one effect may take where each is a geometry of its own."""
FEWEST = 4
"""Values that are tried however long each takes: both signs, near and far."""
AGAIN = 8
"""Values that are tried again beside another fit, of those that promise most by their change of the light beside the one before, where each
is a geometry of its own."""
SEEN = 0.3
"""Root sum of squares, in errors of a row: such a change gains 0.05 in log density at most."""
LINEAR_GRID = 2
"""Of an effect whose parameter only scales its light, so that one value looks like another."""
MOST_SCANNED = 400
"""Rows at which an effect is tried that no descent would find the row of."""
PARTS = 24
"""Of the recording's span, that the best of those rows must stand apart."""
TURNS = 12
"""Swings or jumps that are sought in the residuals."""
SWING, SWING_OF_PART, JUMP = 5, 3, 4
"""Parameters of a swing of the body, of a part about an axis of its own, and of a jump, if the scene fixes none."""


@dataclass(frozen=True)
class Probe:
    """Finite-step signatures of one candidate at a refit: values psi (G, k) that were tried, unit signatures
    (G, T) off everything the refit can absorb, and the score (g'r)^2 / g'g of each (G,), 0 where the opposite of an effect that has
    none would be needed; ``aimed`` marks values that were chosen by the residuals themselves, (G,)."""

    entry: str
    psi: Tensor
    signatures: Tensor
    scores: Tensor
    aimed: Tensor
    moved: Tensor
    """Whitened change of the light, (G, T)."""
    visible: bool
    """Whether any of the values changes what the scene's own parameters cannot take up by SEEN errors of a row."""
    together: float = 0.0
    """What the parts of a divided offset score together, less the one that each would in pure noise."""
    begin: Tensor | None = None
    """Values (k,) of a divided offset where each part is best by itself, of those that were tried of all parts alike."""
    part: Tensor | None = None
    """Which part of a divided offset each change of the light is of, (G,)."""

    @property
    def score(self) -> float:
        return float(self.scores.max()) if len(self.scores) else self.together

    @property
    def worth(self) -> float:
        """Twice the log evidence that is promised: the score is one column's, and each number but one is at best known to 1 / sqrt(score) of
        what its prior allows."""
        return self.score - max(self.psi.shape[-1] - 1, 0) * math.log(max(self.score, 1.0))

    def best_change(self, at: Fitted) -> Tensor:
        """Change of the light (T,), in the unit of the rows of a fit, that the best of the values makes."""
        return self.moved[int(self.scores.argmax())] * at.sigma

    def best_size(self, at: Fitted) -> float:
        """How many times that suits the residuals of the fit: scores say nothing of it, for they are those of unit signatures."""
        best = int(self.scores.argmax())
        unit, moved = self.signatures[best], self.moved[best]
        size = torch.sqrt(self.scores[best]) / (unit @ moved)
        return float(torch.copysign(size, unit @ (at.delta / at.sigma)))


def probe(
    bench: Workbench, at: Fitted, posterior: Posterior, entry: str, seed: int, known: Probe | None = None
) -> Probe:
    """Signatures of ``entry`` added to a refit, whose ``posterior`` is that with it, over a ladder or cloud of its
    parameters, or over those that promise most of a probe that is ``known`` from another fit and was held against this one; of a divided
    offset only what its parts score together."""
    likelihood = posterior.likelihood
    parameters = likelihood.model.parameter_set
    columns = effect_columns(parameters, entry)
    per = Entry.parse(entry).per
    theta = carried(parameters, at.theta[None], at.names)

    def change(psi: Tensor) -> Tensor:
        if not len(psi):
            return at.delta.new_zeros(0, len(at.delta))
        many = theta.repeat(len(psi), 1)
        many[:, columns] = psi
        with torch.no_grad():
            moved = (at.delta - likelihood.residuals(many).delta) / at.sigma
        return torch.nan_to_num(moved)

    if per is not None:
        psi = _each_moved(entry, theta[:, columns])
    elif known is not None and turns(posterior, entry) and scanned_column(entry) is None:
        psi = known.psi[torch.argsort(known.scores, descending=True)[:AGAIN]]
    else:
        psi = _tried(bench, posterior, entry, seed)
    sought = (
        psi[:0]
        if per is not None
        else _sought(bench, likelihood, entry, Target(at.residual_rows, at.basis, change))
    )
    column = scanned_column(entry)
    if column is None or per is not None:
        moved = change(psi)
    else:  # what begins at an instant is the same whenever that is
        begun = bench.base.context.seconds / 3600 > psi[:, [column]]
        moved = change(psi[:1]) * begun
    mixture = _mixture(posterior, entry)
    if mixture is not None and per is None and known is None:
        psi, moved = _mixed(mixture, posterior, columns, theta, psi, change, at, seed)
    psi, moved = torch.cat([psi, sought]), torch.cat([moved, change(sought)])
    if per is not None:
        part = bench.base.row_index[per][0]
        moved = torch.where(part == torch.unique(part)[:, None, None], moved, 0.0).flatten(0, 1)
    signatures, scores, usable, visible = _scored(moved, at, effect_class(entry).one_sided())
    if per is not None:
        together = max(float((scores - 1.0).sum()), 0.0)
        members = torch.arange(len(torch.unique(part)))
        of = members.repeat_interleave(len(psi))
        begin, gained, farther = each_best(bench, at, posterior, entry, theta)
        if begin is not None:
            moved, of = torch.cat([moved, farther]), torch.cat([of, members])
        promised = max(together, gained)
        return Probe(
            entry, psi[:0], signatures[:0], scores[:0], usable[:0], moved, visible, promised, begin, of
        )
    aimed = torch.arange(len(psi)) >= len(psi) - len(sought)
    return Probe(entry, psi[usable], signatures, scores, aimed[usable], moved[usable], visible)


def _mixed(
    mixture: Mixture,
    posterior: Posterior,
    columns: Sequence[int],
    theta: Tensor,
    psi: Tensor,
    change: Callable[[Tensor], Tensor],
    at: Fitted,
    seed: int,
) -> tuple[Tensor, Tensor]:
    """Values (G, k) and changes of the light (G, T) of a mixture, its sizes solved for, and more of them around the best places."""
    where = mixture.where(len(columns))

    def solved(values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        values, moved = mixture.solved(values, change, lambda light: beyond(light, at), at.residual_rows)
        _, usable_scores, usable, _ = _scored(moved, at, one_sided=True)
        scores = moved.new_zeros(len(moved)).index_copy(0, torch.nonzero(usable)[:, 0], usable_scores)
        return values, moved, scores

    def coordinates(values: Tensor) -> Tensor:
        many = theta.repeat(len(values), 1)
        many[:, columns] = values
        return posterior.coordinates(many)[:, columns]

    def natural(g: Tensor) -> Tensor:
        many = posterior.coordinates(theta).repeat(len(g), 1)
        many[:, columns] = g
        return posterior.theta(many)[:, columns]

    psi, moved, scores = solved(psi)
    if len(where) == 1 or not len(psi):
        return psi, moved
    more, light = finer(where, psi, scores, coordinates, natural, solved, seed)
    return torch.cat([psi, more]), torch.cat([moved, light])


def beyond(moved: Tensor, at: Fitted) -> Tensor:
    """What of whitened changes of the light (G, T) a fit's own numbers cannot take up, (G, T + P)."""
    padded = torch.cat([moved, moved.new_zeros(len(moved), len(at.residual_rows) - moved.shape[1])], 1)
    return padded - (padded @ at.basis) @ at.basis.T


def _scored(moved: Tensor, at: Fitted, one_sided: bool) -> tuple[Tensor, Tensor, Tensor, bool]:
    """Of changes (G, T) in errors of a row, beside a fit: unit signatures and scores of those that are usable, which are, (G,), and
    whether any may be seen. Of an effect that is ``one_sided`` no change can be made the other way."""
    projected = beyond(moved, at)
    norm = torch.linalg.vector_norm(projected, dim=1)
    raw = torch.linalg.vector_norm(moved, dim=1)
    usable = (norm > 1e-3) & (norm > 1e-7 * raw)
    unit = projected[usable] / norm[usable, None]
    pull = unit @ at.residual_rows
    score = (pull.clamp(min=0.0) if one_sided else pull) ** 2
    return unit[:, : moved.shape[1]], score, usable, bool((norm > SEEN).any())


def rescored(known: Probe, before: Fitted, at: Fitted) -> Probe:
    """A probe that was made beside another fit, held against the residuals of this one: the same changes of the light, where new ones
    would take long."""
    if not len(known.moved):
        return known
    moved = known.moved * before.sigma / at.sigma
    signatures, scores, usable, visible = _scored(moved, at, effect_class(known.entry).one_sided())
    if known.part is not None:
        best = scores.new_ones(int(known.part.max()) + 1)
        best.scatter_reduce_(0, known.part[usable], scores, "amax")
        return replace(known, moved=moved, visible=visible, together=float((best - 1.0).sum()))
    return Probe(
        known.entry, known.psi[usable], signatures, scores, known.aimed[usable], moved[usable], visible
    )


def _sought(bench: Workbench, likelihood: Likelihood, entry: str, target: Target) -> Tensor:
    """Values psi (G, k) of an effect that turns the body in the course of the recording, as its residuals ask for."""
    columns, kind = effect_columns(likelihood.model.parameter_set, entry), effect_class(entry).turning
    context = bench.base.context
    if kind == "swing" and len(columns) in (SWING, SWING_OF_PART):
        limits = likelihood.model.parameter_set.free[columns[1]].prior
        minutes, cadence = context.seconds / 60, context.cadence / 60
        axes = BODY_AXES if len(columns) == SWING else GIVEN_AXIS
        return swings(target, minutes, cadence, (limits.low, limits.high), TURNS, axes)
    if kind == "jump" and len(columns) == JUMP:
        return jumps(target, context.seconds / 3600, scanned_hours(bench), least_apart(bench), TURNS)
    return target.residual.new_zeros(0, len(columns))


def _tried(bench: Workbench, posterior: Posterior, entry: str, seed: int) -> Tensor:
    """Values psi (G, k) to probe: of an effect that begins at some row all rows, at its typical size; fewer where each is a
    geometry that takes long; none of what is only sought in the residuals."""
    column = scanned_column(entry)
    if Entry.parse(entry).name in unlisted():
        return torch.zeros(0, SWING_OF_PART, dtype=torch.float64)
    most = max(int(MOST_S / max(seconds_a_geometry(posterior, entry), 1e-9)), FEWEST)
    if column is not None:
        hours = scanned_hours(bench)
        hours = hours[torch.linspace(0, len(hours) - 1, min(len(hours), most)).long()]
        quantities = effect_class(entry).quantities
        sizes = [torch.full_like(hours, quantity.typical or 0.0) for quantity in quantities]
        return torch.stack([*sizes[:column], hours, *sizes[column + 1 :]], -1)
    dimensions = len(effect_columns(posterior.model.parameter_set, entry))
    count = GRID * (dimensions if dimensions > 2 else 1) if dimensions else 1
    mixture = _mixture(posterior, entry)
    if mixture is not None:
        count = LINE_PLACES if len(mixture.where(dimensions)) < 2 else PLACES
    if effect_class(entry).linear:
        count = min(count, LINEAR_GRID)
    return effect_starts(
        posterior.model.parameter_set, entry, min(count, most), torch.Generator().manual_seed(seed)
    )


def seconds_a_geometry(posterior: Posterior, entry: str) -> float:
    """CPU seconds that each value of an effect's own parameters takes, 0 where they leave the geometry as it is."""
    return posterior.seconds_each if turns(posterior, entry) else 0.0


def least_seconds(posterior: Posterior, entry: str) -> float:
    """CPU seconds that an effect's probe takes at least."""
    return (GRID + 1 if _anywhere(entry) else FEWEST) * seconds_a_geometry(posterior, entry)


def _anywhere(entry: str) -> bool:
    """Whether the parts of a divided offset may lie anywhere within its bounds."""
    quantities = effect_class(entry).quantities
    return Entry.parse(entry).per is not None and len(quantities) == 1 and quantities[0].apart is not None


def turns(posterior: Posterior, entry: str) -> bool:
    """Whether an effect's own parameters move the geometry."""
    return bool(posterior.turning(effect_columns(posterior.model.parameter_set, entry)))


def each_best(
    bench: Workbench, at: Fitted, posterior: Posterior, entry: str, theta: Tensor
) -> tuple[Tensor | None, float, Tensor]:
    """Of a divided offset whose parts may lie anywhere within its bounds: the values (k,) at which each part has the least sum of
    squares, of GRID to MOST_GRID that all parts are given alike, what these take off the sum less what they cost in the prior, and the
    whitened change of the light (k, T) by each. No descent finds an offset that is farther than the light follows in proportion."""
    if not _anywhere(entry):
        return None, 0.0, at.delta.new_zeros(0, len(at.delta))
    parameters, (quantity,) = posterior.likelihood.model.parameter_set, effect_class(entry).quantities
    columns = effect_columns(parameters, entry)
    affordable = int(MOST_S / max(seconds_a_geometry(posterior, entry), 1e-9))
    count = max(GRID, min(MOST_GRID, affordable))
    edges = torch.linspace(quantity.low, quantity.high, count + 1, dtype=theta.dtype)
    tried = torch.cat([theta.new_tensor([quantity.off or 0.0]), 0.5 * (edges[1:] + edges[:-1])])
    many = theta.repeat(len(tried), 1)
    many[:, columns] = tried[:, None]
    with torch.no_grad():
        left = posterior.likelihood.residuals(many).delta / at.sigma
        prior = posterior.scores.scores(many)[:, columns].square()
    part = bench.base.row_index[str(Entry.parse(entry).per)][0]
    cost = torch.stack([left[:, part == k].square().sum(1) for k in range(len(columns))], 1) + prior
    cost = torch.nan_to_num(cost, nan=torch.inf)
    least, chosen = cost.min(0)
    moved = torch.nan_to_num(at.delta / at.sigma - left[chosen])
    farther = torch.where(part == torch.arange(len(columns))[:, None], moved, 0.0)
    return tried[chosen], float((cost[0] - least).sum()), farther


def _each_moved(entry: str, offsets: Tensor) -> Tensor:
    """Offsets (Q, k) of the parts of a divided effect, each part's Q quantities in the order of theta, moved from where
    they are (1, k): every part alike, one quantity at a time, by what is typical of it."""
    quantities = effect_class(entry).quantities
    many = offsets.shape[1] // len(quantities)
    steps = [(quantity.typical or 0.0) - (quantity.off or 0.0) for quantity in quantities]
    return offsets + torch.diag(offsets.new_tensor(steps)).repeat_interleave(many, 1)


def many_lights(entry: str) -> bool:
    """Whether an effect brings light from many directions, or between facets: its tables take as long as the probes of twenty others."""
    return effect_class(entry).stage in ("light", "scatter")


def scanned_column(entry: str) -> int | None:
    """Which of an effect's own parameters has to be tried at every row, if one has."""
    cls = effect_class(entry)
    names = [quantity.name for quantity in cls.quantities]
    return names.index(cls.scanned) if cls.scanned else None


def scanned_hours(bench: Workbench) -> Tensor:
    """The middles between rows, or between MOST_SCANNED of them, h after the first."""
    stamps = torch.unique(bench.base.context.seconds).to(torch.float64) / 3600
    middle = 0.5 * (stamps[1:] + stamps[:-1])
    if len(middle) > MOST_SCANNED:
        middle = middle[torch.linspace(0, len(middle) - 1, MOST_SCANNED, dtype=torch.float32).long()]
    return middle


def apart(bench: Workbench, posterior: Posterior, entry: str, ranked: Tensor) -> list[int]:
    """Which of probed values (G, k), best first, to begin from: of an effect that was tried at every row, or whose light goes to one place
    each, those that stand apart."""
    column, mixture = scanned_column(entry), _mixture(posterior, entry)
    if column is not None and len(ranked):
        return spaced(ranked[:, column], least_apart(bench), len(ranked))
    if mixture is not None and len(ranked):
        parameters = posterior.model.parameter_set
        columns = effect_columns(parameters, entry)
        theta = parameters.start().repeat(len(ranked), 1)
        theta[:, columns] = ranked
        g = posterior.coordinates(theta)[:, columns]
        return spread_out(g[:, mixture.where(len(columns))], len(ranked))
    return list(range(len(ranked)))


def _mixture(posterior: Posterior, entry: str) -> Mixture | None:
    parameters = posterior.model.parameter_set
    columns = effect_columns(parameters, entry)
    return Mixture.of(entry, [parameters.free[column].origin.quantity for column in columns])


def least_apart(bench: Workbench) -> float:
    """Hours that instants must be apart to count as different."""
    seconds = bench.base.context.seconds
    return float(seconds.max() - seconds.min()) / 3600 / PARTS
