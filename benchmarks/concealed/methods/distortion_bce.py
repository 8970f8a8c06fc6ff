"""Distortion-driven tests in the mode that learns by binary cross entropy: a network with one output for each cause of the
menu, trained on simulations of the nominal model against simulations distorted by a random value of that cause at a random
size. Its output is ln p(x|H_i) / p(x|H0), half of t_i; detection by the smaller of the global p-values of the largest and of
the sum, twice that. Sizes are log-uniform in signal to noise over the range in which a distortion is neither sure to be seen
nor sure to be missed, and beyond, in place of the paper's adaptive scheme. Probabilities are those of the outputs, causes and
nothing alike before the data."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Case
from benchmarks.concealed.distortions import basis
from benchmarks.concealed.linear import p_of_draws

TITLE = "distortions, BCE"
NEEDS: Sequence[str] = ()
NAMES = True
SHARES: Sequence[str] = ("nominal", "menu")
STEPS, BATCH, WIDTH = 1000, 256, 96
LEARNING_RATE = 2e-3
SIZES = (1.0, 40.0)
"""Signal to noise of the distortions in training."""
DRAWS = 2000


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    found = basis(case, without)
    patterns = torch.tensor(found.patterns[found.menu]).float()
    owner = torch.tensor(found.owner[found.menu])
    if not len(patterns):
        return Answer(1.0, "none")
    present = torch.unique(owner)
    names = [found.names[int(i)] for i in present]
    place = torch.searchsorted(present, owner)
    network = _trained(case, patterns, place, len(names), seed)
    with torch.no_grad():
        null = network(torch.tensor(case.null_residuals(DRAWS, seed + 1)).float()).double().numpy()
        logits = network(torch.tensor(case.residual[None, : case.rows]).float())[0].double()
    values = logits.numpy()
    p = min(1.0, 2 * min(p_of_draws(values.max(), null.max(1)), p_of_draws(values.sum(), null.sum(1))))
    share = torch.softmax(torch.cat([logits.new_tensor([np.log(len(names))]), logits]), 0).numpy()
    order = np.argsort(-values)
    family = tuple(names[i] for i in order if share[1 + i] >= 0.1 * share[1 + order[0]])
    verdict = "none" if p >= SURE else "named"
    confidence = share[0] if verdict == "none" else sum(share[1 + names.index(one)] for one in family)
    return Answer(p, verdict, [(names[i],) for i in order], [family], float(confidence))


def _trained(case: Case, patterns: Tensor, owner: Tensor, causes: int, seed: int) -> nn.Module:
    """The network from residuals (N, T) to log ratios (N, causes)."""
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = nn.Sequential(nn.Linear(case.rows, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(),
                                nn.Linear(WIDTH, causes))  # fmt: skip
    count = torch.bincount(owner, minlength=causes)
    first, order = torch.cumsum(count, 0) - count, torch.argsort(owner)
    null = torch.tensor(case.null_residuals(20 * BATCH, seed)).float()
    optimiser = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, LEARNING_RATE, total_steps=STEPS)
    for _ in range(STEPS):
        which = torch.randint(causes, (BATCH,), generator=generator)
        place = (torch.rand(BATCH, generator=generator, dtype=torch.float64) * count[which]).long()
        one = order[first[which] + place]
        size = torch.exp(torch.rand(BATCH, generator=generator) * np.log(SIZES[1] / SIZES[0])) * SIZES[0]
        noise = null[torch.randint(len(null), (2 * BATCH,), generator=generator)]
        distorted = network(noise[:BATCH] + size[:, None] * patterns[one])
        plain = network(noise[BATCH:])
        loss = nn.functional.softplus(-distorted[torch.arange(BATCH), which]).mean() * causes
        loss = loss + nn.functional.softplus(plain).sum(1).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return network
