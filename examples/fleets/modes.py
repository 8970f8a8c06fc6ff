"""Two ways to fly of one class of satellites, changing from pass to pass."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from unseen import FOLDS, fitted, left, robust
from v2mini import ERROR_MAG, LOW_KM, passes, v2mini

import torchlc
from torchlc.readers import Recording

ROUNDS = 4
"""Of expectation and maximisation: passes stop changing their mode."""


def low_modes() -> dict[str, Any]:
    """Two ways to fly of the satellites below LOW_KM."""
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, lit, recorded = v2mini(Path(folder))
    return modes(scene, recording.keep(lit & (recorded["height"] < LOW_KM), "of the other class"))


def log_mixture(delta: np.ndarray, group: np.ndarray, share: float, sigma: tuple[float, float]) -> np.ndarray:
    """ln of the joint density (2, G) of the rows of each group and of either mode: residuals ``delta`` (2, T) of both models, normal
    with a spread each, and the share of groups in the first."""
    scaled = delta / np.array(sigma)[:, None]
    rows = -0.5 * scaled**2 - np.log(np.array(sigma) * np.sqrt(2 * np.pi))[:, None]
    groups = np.stack([np.bincount(group, weights=one) for one in rows])
    return groups + np.log([[share], [1 - share]])


def two_modes(
    scene: torchlc.Scene, recording: Recording, group: np.ndarray, rounds: int = ROUNDS
) -> dict[str, Any]:
    """Two models of which each pass, ``group`` (T,), follows one: materials of their own, by expectation and maximisation with whole
    passes; begun from passes that are brighter and fainter than one model of all."""
    model, theta = fitted(scene, recording)
    delta = left(scene, recording, model.names, theta)
    many = group.max() + 1
    middle = np.array([np.median(delta[group == k]) for k in range(many)])
    first = middle < np.median(middle)
    thetas: list[torch.Tensor] = []
    share, sigma = 0.5, (1.0, 1.0)
    for _ in range(rounds):
        thetas = [
            fitted(scene, recording.keep(some[group], "of the other mode"))[1] for some in (first, ~first)
        ]
        both = np.stack([left(scene, recording, model.names, one) for one in thetas])
        share = float(np.clip(first.mean(), 0.02, 0.98))
        sigma = tuple(
            max(robust(one[some[group]]), ERROR_MAG) for one, some in zip(both, (first, ~first), strict=True)
        )
        joint = log_mixture(both, group, share, sigma)  # pyright: ignore[reportArgumentType]
        first = joint[0] > joint[1]
    return {
        "names": model.names,
        "thetas": thetas,
        "share": share,
        "sigma": sigma,
        "first": first,
        "delta": delta,
    }


def modes(scene: torchlc.Scene, recording: Recording, folds: int = FOLDS) -> dict[str, Any]:
    """Whether satellites of one class fly in two ways, changing from pass to pass: what two models predict of unseen satellites, against
    one model with a population of offsets."""
    assert recording.object is not None
    group = passes(recording)
    seen = two_modes(scene, recording, group)
    owner = np.array([recording.object[group == k][0] for k in range(group.max() + 1)])
    turned = [one for one in np.unique(owner) if len(set(seen["first"][owner == one])) == 2]
    order = np.random.default_rng(0).permutation(len(recording.object_ids))
    gain, nearer, single = [], [], []
    for fold in range(folds):
        unseen = np.isin(recording.object, order[fold::folds])
        part = np.unique(group[~unseen], return_inverse=True)[1].ravel()
        made = two_modes(scene, recording.keep(~unseen, "held out"), part, ROUNDS - 1)
        rest = recording.keep(unseen, "fitted to")
        both = np.stack([left(scene, rest, made["names"], one) for one in made["thetas"]])
        own = np.unique(group[unseen], return_inverse=True)[1].ravel()
        joint = log_mixture(both, own, made["share"], made["sigma"])
        mixed = np.logaddexp(joint[0], joint[1])
        one_model = fitted(scene, recording.keep(~unseen, "held out"))
        alone = left(scene, rest, one_model[0].names, one_model[1])
        spread = robust(made["delta"])
        plain = log_mixture(np.stack([alone, alone]), own, 0.5, (spread, spread))
        gain += [mixed - np.logaddexp(plain[0], plain[1])]
        chosen = np.where(joint[0] > joint[1], 0, 1)[own]
        nearer += [both[chosen, np.arange(len(own))]]
        single += [alone]
    total = np.concatenate(gain)
    return {
        "passes": int(group.max() + 1),
        "first_passes": int(seen["first"].sum()),
        "sigma": list(seen["sigma"]),
        "satellites_of_several_passes": int(sum((owner == one).sum() > 1 for one in np.unique(owner))),
        "satellites_in_both": len(turned),
        "unseen_in_its_mode": robust(np.concatenate(nearer)),
        "unseen_one_model": robust(np.concatenate(single)),
        "log_density_gained": float(total.sum()),
        "standard_error": float(total.std(ddof=1) * np.sqrt(len(total))),
        "parameters": [dict(zip(seen["names"], one.tolist(), strict=True)) for one in seen["thetas"]],
    }
