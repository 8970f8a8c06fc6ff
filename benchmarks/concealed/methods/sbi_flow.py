"""sbi's check by the log density of a flow: one is trained on simulated recordings, and the recording's log density compared
with theirs. A flow of hundreds of dimensions cannot be trained in a minute, so rows are summed in runs, each sum of unit
variance. It cannot name or predict."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks.concealed.answer import SURE, Answer
from benchmarks.concealed.case import Array, Case

TITLE = "sbi, log density of a flow"
NEEDS: Sequence[str] = ("sbi",)
NAMES = False
SHARES: Sequence[str] = ("nominal",)
SIMULATIONS, HELD = 2000, 1000
RUNS = 16
EPOCHS = 30


def examine(case: Case, without: Collection[str], seed: int) -> Answer:
    from sbi.diagnostics.misspecification import calc_misspecification_logprob
    from sbi.inference.trainers.marginal.marginal_base import MarginalTrainer
    from sbi.utils.tracking import TensorBoardTracker
    from torch.utils.tensorboard.writer import SummaryWriter

    torch.manual_seed(seed)
    simulated = _summed(case, case.null_residuals(SIMULATIONS + HELD, seed))
    observed = _summed(case, case.residual[None, : case.rows])
    with TemporaryDirectory() as logs, warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # on the flow's own two-sample test, which the p-value does not rest on
        tracker = TensorBoardTracker(SummaryWriter(logs))
        trainer = MarginalTrainer("maf", tracker=tracker, show_progress_bars=False)
        flow = trainer.append_samples(simulated[:SIMULATIONS]).train(max_num_epochs=EPOCHS)
        p = float(calc_misspecification_logprob(simulated[SIMULATIONS:], observed, flow)[0])
    p = max(p, 1 / (HELD + 1))
    return Answer(p, "missing" if p < SURE else "none")


def _summed(case: Case, residuals: Array) -> torch.Tensor:
    """Sums (N, RUNS) over runs of rows, as many as there are rows at most, in order of time, over the root of their number."""
    order = np.argsort(case.seconds)
    runs = np.array_split(order, min(RUNS, len(order)))
    return torch.tensor(
        np.stack([residuals[:, rows].sum(1) / np.sqrt(len(rows)) for rows in runs], 1)
    ).float()
