"""What a model of satellites of one design predicts of nights or satellites that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

import torchlc
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.lightcurve.assembly import assemble
from torchlc.readers import Recording

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
FOLDS = 5
STARTS, ADAM_STEPS = 8, 100


def robust(values: np.ndarray) -> float:
    """1.4826 median |deviation from the median|."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def fitted(
    scene: torchlc.Scene, recording: Recording, seed: int = 0
) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording and its most probable theta."""
    model = torchlc.LightCurve(scene, recording)
    return model, fit_map(Likelihood(model), starts=STARTS, adam_steps=ADAM_STEPS, seed=seed).theta


def left(scene: torchlc.Scene, recording: Recording, names: Sequence[str], theta: torch.Tensor) -> np.ndarray:
    """Recorded minus model, mag, (T,), of a recording at another's theta: every object, night and station at the mean of its
    population."""
    model = torchlc.LightCurve(scene, recording, assembly=assemble(scene, recording))
    assert model.names == list(names)
    with torch.no_grad():
        return recording.observed - model(theta).numpy()


def held_out(scene: torchlc.Scene, recording: Recording, member: np.ndarray) -> np.ndarray:
    """Recorded minus model, mag, (T,), each row by a fit that has seen nothing of its member (T,): night or object."""
    ids = np.unique(member)
    order = np.random.default_rng(0).permutation(len(ids))
    delta = np.full(len(recording), np.nan)
    for fold in range(FOLDS):
        unseen = np.isin(member, ids[order[fold::FOLDS]])
        model, theta = fitted(scene, recording.keep(~unseen, "held out"))
        delta[unseen] = left(scene, recording.keep(unseen, "fitted to"), model.names, theta)
    return delta


def area_under_curve(score: np.ndarray, positive: np.ndarray) -> float:
    """Share of pairs of a positive and a negative in which the positive scores more, ties half."""
    difference = score[positive][:, None] - score[~positive]
    return float(np.mean((difference > 0) + 0.5 * (difference == 0)))
