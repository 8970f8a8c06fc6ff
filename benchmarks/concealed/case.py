"""One case as every method gets it: simulator, recording, null draws, menu of causes.

Letters: T rows, P coordinates of the nominal model, N draws, G values of a cause's own parameters. "Whitened" is divided
by the quoted errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from astropy.time import Time

from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.diagnosis.probes import probe
from torchlc.inference.density import Fitted, Posterior
from torchlc.inference.posterior import fit, material_starts
from torchlc.readers import Recording, load_recording
from torchlc.scene import Scene, load_scene
from torchlc.stages.entry import Entry

Array = np.ndarray
STARTS = 12
"""Draws of the materials from which the nominal model is fitted."""
HALF_SECOND_D = 5e-6


@dataclass(frozen=True)
class Cause:
    """A cause of the menu: its ``name``, the part or material that it is applied to, and what it changes, whitened (G, T)."""

    name: str
    entry: str
    changes: Array


class Case:
    """A folder with ``scene.toml``, ``recording.ecsv`` and ``answer.json``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.answer: dict[str, Any] = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        self.scene: Scene = load_scene(folder / "scene.toml")
        self.recording: Recording = load_recording(folder / "recording.ecsv", self.scene)
        self._menus: dict[frozenset[str], list[Cause]] = {}

    # ------------------------------------------------------------------ the answer

    @property
    def kind(self) -> str:
        """Class of the case: "none", "one", "two", "three", "unlisted", "other law" or "nominal scene"."""
        return self.answer["class"]

    @property
    def accepted(self) -> list[frozenset[str]]:
        """Sets of names that are right answers; empty where nothing in the menu is."""
        if self.kind in ("none", "unlisted", "nominal scene"):
            return []
        return [frozenset(one) for one in self.answer["family"]] or [frozenset(self.answer["effects"])]

    @property
    def too_weak(self) -> bool:
        """Whether what is concealed leaves less than 25 of chi-square, so that "nothing" is a right answer too."""
        return "adequate" in self.answer.get("verdicts_accepted", ())

    @property
    def true_rows(self) -> Array | None:
        """Rows (T,) where what is concealed shows at 2 sigma; None where it shows nowhere."""
        where = self.answer.get("where")
        if not where or not where["intervals"]:
            return None
        days = np.asarray(self.recording.time.utc.jd)
        rows = np.zeros(len(days), dtype=bool)
        for start, end in where["intervals"]:
            rows |= (days >= Time(start).jd - HALF_SECOND_D) & (days <= Time(end).jd + HALF_SECOND_D)
        return rows

    # ------------------------------------------------------------------ simulator and recording

    @cached_property
    def bench(self) -> Workbench:
        bench = Workbench(self.scene, self.recording)
        possible = [one for one in bench.candidates(None) if Entry.parse(one).per is None]
        bench.entries = [
            one for one in possible if not bench.likelihood(Hypothesis((one,))).model.unaffordable
        ]
        return bench

    @cached_property
    def nominal(self) -> Fitted:
        """The nominal model at its best, errors as quoted."""
        return self.fitted(())

    def fitted(self, added: tuple[str, ...]) -> Fitted:
        """The nominal model with these effects at its best, errors as quoted."""
        hypothesis = Hypothesis(added)
        posterior = Posterior(self.bench.likelihood(hypothesis), False)
        middle = posterior.theta(torch.zeros(posterior.size, dtype=torch.float64))
        generator = torch.Generator().manual_seed(0)
        starts = [posterior.model.parameter_set.start()[None], middle[None]]
        starts.append(material_starts(posterior, middle, STARTS, generator))
        return fit(hypothesis, posterior, posterior.coordinates(torch.cat(starts)))

    @property
    def simulator(self) -> Callable[[torch.Tensor], torch.Tensor]:
        """Magnitudes (..., T) of the nominal model at natural values theta (..., P)."""
        return self.nominal.model

    @property
    def seconds(self) -> Array:
        """Time of each row, s."""
        return np.asarray(self.recording.seconds)

    @cached_property
    def residual(self) -> Array:
        """Whitened recording minus nominal model at its best, (T,), above the prior's rows, (T + P,)."""
        return left_by(self.nominal)

    @property
    def rows(self) -> int:
        return len(self.recording)

    @cached_property
    def slopes(self) -> Array:
        """Whitened slopes of the nominal model, (T, P), in coordinates whose prior is standard normal."""
        return -self.nominal.tangent[: self.rows].numpy()

    @cached_property
    def _absorbing(self) -> Array:
        return np.linalg.qr(self.nominal.tangent.numpy())[0]

    def left(self, changes: Array) -> Array:
        """What the nominal model cannot absorb of whitened changes (..., T), rows only, to first order."""
        padded = np.concatenate([changes, np.zeros((*changes.shape[:-1], self.nominal.posterior.size))], -1)
        return (padded - (padded @ self._absorbing) @ self._absorbing.T)[..., : self.rows]

    def null_residuals(self, count: int, seed: int) -> Array:
        """Whitened residuals (N, T) of refits to recordings in which nothing is missing, to first order."""
        z = np.random.default_rng(seed).standard_normal((count, len(self._absorbing)))
        return (z - (z @ self._absorbing) @ self._absorbing.T)[:, : self.rows]

    def null_recordings(self, count: int, seed: int) -> Array:
        """Recordings (N, T), mag, of the nominal model with the quoted errors, theta from its posterior."""
        theta = self.nominal.draws(count, seed)
        with torch.no_grad():
            curves = self.simulator(theta).numpy()
        noise = np.random.default_rng(seed).standard_normal(curves.shape)
        return curves + noise * self.nominal.quoted.numpy()

    def marginal(self) -> tuple[Array, Array]:
        """Mean (T,) and covariance (T, T) of the whitened recording minus the best model, if nothing is missing, before
        the recording is seen; to first order."""
        g = self.residual[self.rows :]
        return -self.slopes @ g, np.eye(self.rows) + self.slopes @ self.slopes.T

    # ------------------------------------------------------------------ menu

    def menu(self, without: Collection[str] = ()) -> list[Cause]:
        """Causes that these data could carry, but those named, at some values of their own parameters, none of which
        looks at the recording."""
        key = frozenset(without)
        if frozenset() not in self._menus:
            self._menus[frozenset()] = [
                one for one in (self._cause(entry) for entry in self.bench.entries) if one is not None
            ]
        if key not in self._menus:
            self._menus[key] = [one for one in self._menus[frozenset()] if one.name not in key]
        return self._menus[key]

    def _cause(self, entry: str) -> Cause | None:
        posterior = Posterior(self.bench.likelihood(Hypothesis((entry,))), False)
        found = probe(self.bench, self.nominal, posterior, entry, 0)
        changes = found.moved[~found.aimed].numpy()
        if not found.visible or not len(changes):
            return None
        return Cause(Entry.parse(entry).name, entry, changes)


def left_by(fitted: Fitted) -> Array:
    """Whitened recording minus model, (T,), above the prior's rows, (T + P,)."""
    return torch.cat([fitted.delta / fitted.sigma, fitted.g]).numpy()


def blocks(case: Case) -> Sequence[tuple[Array, Array]]:
    """Rows of each block that is held out, and the rows that are left out with it."""
    from torchlc.diagnosis.proof import make_blocks

    context = case.bench.base.context
    group = context.curve if len(case.recording.curve_ids) >= 4 else context.night
    return [(rows.numpy(), gone.numpy()) for rows, gone in make_blocks(context.seconds, group)]
