"""sbi's check by maximum mean discrepancy (Schmitt et al. 2023, arXiv 2112.08866): the recording's whitened residuals against
those of refits to simulated recordings. It cannot name or predict."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import torch

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Case

TITLE = "sbi, MMD"
NEEDS: Sequence[str] = ("sbi",)
NAMES = False
SHARES: Sequence[str] = ("nominal",)
SIMULATIONS, SHUFFLES = 1000, 400


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    from sbi.diagnostics.misspecification import calc_misspecification_mmd

    torch.manual_seed(seed)
    simulated = torch.tensor(case.null_residuals(SIMULATIONS, seed))
    observed = torch.tensor(case.residual[None, : case.rows])
    p = calc_misspecification_mmd(observed, simulated, n_shuffle=SHUFFLES, max_samples=SIMULATIONS // 2)[0]
    p = max(float(p), 1 / (SHUFFLES + 1))
    return Answer(p, "missing" if p < SURE else "none")
