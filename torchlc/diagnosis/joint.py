"""Sets of effects by what their changes of the light promise together: those that no path of one effect after another leads to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from torchlc.diagnosis.probes import Probe, beyond
from torchlc.effects import effect_class
from torchlc.inference.density import Fitted

VALUES = 3
"""Probed values of each effect that are put together: all of three times forty in threes are 280,000 sets."""
ALIKE = 0.05
"""What is added to the squares of unit changes: two that are alike to 1 in 40 promise no more together than one."""


def joint_sets(
    probes: Mapping[str, Probe],
    at: Fitted,
    size: int,
    log_odds: Callable[[Sequence[str]], float],
    most: int,
) -> list[tuple[dict[str, Tensor], float]]:
    """The ``most`` best sets of ``size`` effects by the linear forms of their probes beside a fit, each with the values psi (k,) that
    promise most, and with the log evidence that they promise; ``log_odds`` gives those before the data, minus infinity of what cannot stand
    together. Sets that need the opposite of an effect that has none are left out."""
    entries, places, rows = [], [], []
    for entry, probe in probes.items():
        for place in torch.argsort(probe.scores, descending=True)[:VALUES].tolist():
            entries.append(entry)
            places.append(place)
            rows.append(probe.moved[place])
    if len(set(entries)) < size:
        return []
    off = beyond(torch.stack(rows), at)
    unit = off / torch.linalg.vector_norm(off, dim=1, keepdim=True)
    gram = unit @ unit.T + ALIKE * torch.eye(len(unit), dtype=unit.dtype)
    pull = unit @ at.residual_rows
    names = list(dict.fromkeys(entries))
    member = torch.tensor([names.index(entry) for entry in entries])
    sets = torch.combinations(torch.arange(len(entries)), size)
    sets = sets[(member[sets].diff(dim=1) > 0).all(1)]
    inner = torch.linalg.cholesky(gram[sets[:, :, None], sets[:, None, :]])
    sizes = torch.cholesky_solve(pull[sets][..., None], inner)[..., 0]
    one_sided = torch.tensor([effect_class(entry).one_sided() for entry in entries])
    possible = ((sizes > 0) | ~one_sided[sets]).all(1)
    sets, promised = sets[possible], (sizes * pull[sets]).sum(1)[possible]
    values: dict[frozenset[str], tuple[dict[str, Tensor], float]] = {}
    best: dict[frozenset[str], float] = {}
    # of sets that promise alike the odds decide, which are within some tens of each other
    for number in torch.argsort(promised, descending=True)[: 200 * most].tolist():
        chosen = {entries[k]: probes[entries[k]].psi[places[k]] for k in sets[number].tolist()}
        key = frozenset(chosen)
        if key not in values:
            gain = 0.5 * float(promised[number])
            values[key], best[key] = (chosen, gain), gain + log_odds(sorted(chosen))
    order = sorted(values, key=lambda key: -best[key])
    return [values[key] for key in order if best[key] > float("-inf")][:most]
