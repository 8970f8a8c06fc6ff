"""What a diagnosis found, and its form as diagnosis.json."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from torch import Tensor

from torchlc.diagnosis.evidence import Scorer
from torchlc.diagnosis.gate import Gate
from torchlc.diagnosis.plan import Option
from torchlc.diagnosis.probes import Probe
from torchlc.diagnosis.refit import Refit, effect_columns
from torchlc.diagnosis.rejected_hypotheses import told
from torchlc.diagnosis.search import Found
from torchlc.diagnosis.where import Where, as_json
from torchlc.diagnosis.words import added_values, lines
from torchlc.files.numbers import Free
from torchlc.inference.identifiability import bare_view, limits
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, left_out
from torchlc.scene import Scene
from torchlc.stages.effect import Effect, Entry, View
from torchlc.tensors.moving import on_cpu

if TYPE_CHECKING:
    import pandas
    from astropy.table import Table
    from matplotlib.axes import Axes

    from torchlc.figures.curves import Comparison

SCHEMA = "torchlc-diagnosis/1"
DRAWS = 4000


@dataclass(frozen=True)
class Diagnosis:
    """``verdict`` with what it rests on: ``gate`` of the baseline and ``final_gate`` of the final model,
    every first-round refit in ``first`` (best first), the ``named`` effects with their ``families``, and
    ``where`` they act."""

    verdict: str
    gate: Gate
    final_gate: Gate
    baseline: Found
    final: Found
    named: Sequence[str]
    families: Sequence[Sequence[str]]
    first: Sequence[Found]
    probes: Mapping[str, Probe]
    where: Where | None
    coordinates: Mapping[str, Tensor]
    scorer: Scorer
    quick: bool
    seed: int
    seconds: float
    untried: Mapping[str, str] = field(default_factory=dict)
    """Why, by entry, an effect was no candidate although it was asked for, or could act."""
    others: Sequence[Found] = ()
    """Every refit of more effects than one that was made on the way."""
    doubt: str = ""
    """Why what describes the recording best is not named, where that is so."""
    law: str = ""
    """Another law of reflection under which the recording is described better than under the scene's own."""
    nights: Sequence[Option] = ()
    next_observation: str = ""

    def __repr__(self) -> str:
        return "\n".join(["Diagnosis: " + self.verdict, *self.lines()])

    def lines(self) -> list[str]:
        """The verdict, what was found, the materials before and after, and what to do next, line by line."""
        return lines(self.content, self.added, self.completed.model.effects or ())

    @property
    def warnings(self) -> list[str]:
        """What a reader should know of scene and recording, each once."""
        untried = [f"{entry} is no candidate: {reason}" for entry, reason in self.untried.items()]
        return list(dict.fromkeys([*left_out(self.recording), *self.model.warnings, *untried, *self.limits]))

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"

    def to_table(self) -> Table:
        """One row a candidate, best first: effect, target, score, p, evidence gained, held-out gain, chi2
        after; not-a-number where a candidate was not refitted.
        """
        from astropy.table import Table

        numbers = ("score", "p", "delta_log_evidence", "heldout_delta_log_likelihood", "chi2_after")
        rows = self.candidates()
        text = {key: [row[key] or "" for row in rows] for key in ("effect", "target")}
        return Table(
            text | {key: [math.nan if row[key] is None else row[key] for row in rows] for key in numbers}
        )

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a DataFrame of pandas."""
        return self.to_table().to_pandas()

    def plot_curve(self) -> Sequence[Axes]:
        """Recording, baseline and final model, residuals below: axes in pairs, a night each."""
        import matplotlib.pyplot as plt

        from torchlc.figures.curves import curve_size, draw_curves

        shown = self.comparison
        return draw_curves(shown, plt.figure(figsize=curve_size(shown.recording)))

    @property
    def model(self) -> LightCurve:
        """The final model."""
        return self.final.refit.model

    @cached_property
    def view(self) -> View:
        """Geometry of every row at the final model's best parameters."""
        return bare_view(self.model, self.final.refit.theta)

    @property
    def recording(self) -> Recording:
        return self.model.recording

    @property
    def prediction(self) -> np.ndarray:
        """The final model in the recording's unit, (T,)."""
        return self.final.refit.prediction.numpy()

    @property
    def comparison(self) -> Comparison:
        """Recording, the baseline refitted, and the final model; rows where they differ are marked."""
        from torchlc.figures.curves import Comparison

        before, after = self.baseline.refit, self.final.refit
        return Comparison(
            self.recording,
            self.prediction,
            after.sigma.expand(len(self.recording)).numpy(),
            before=before.prediction.numpy() if after.hypothesis.added else None,
            marked=None if self.where is None else self.where.rows.numpy(),
        )

    @property
    def added(self) -> dict[str, str]:
        """Values of the parameters that the final model adds, by effect and name, ready to print."""
        refit = self.final.refit
        return added_values({entry: effect_parameters(refit, entry) for entry in self.final.hypothesis.added})

    @property
    def completed(self) -> Scene:
        """The scene with the named effects in its list, to be fitted next; the scene itself where nothing is
        named."""
        scene = self.baseline.refit.model.scene
        if self.verdict != "missing_physics":
            return scene
        return completed_scene(scene, self.final.refit.model.effects)

    @cached_property
    def limits(self) -> list[str]:
        """What the approximations of the final model amount to, where that is worth telling."""
        return limits(self.final.refit.model, self.final.refit.theta)

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json, without NaN."""
        return dict(self.content)

    @cached_property
    def content(self) -> dict[str, Any]:
        """What :meth:`to_json` gives, worked out once."""
        recording = self.baseline.refit.model.recording
        time = [str(one) for one in cast(Any, recording.time.isot)]
        stations = (
            [recording.station_ids[i] for i in recording.station]
            if recording.station_ids
            else [""] * len(time)
        )
        return _clean(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "error_source": recording.error_source,
                "dropped": dict(recording.dropped),
                "global_p": self.gate.global_p,
                "named": list(self.named),
                "families": [list(family) for family in self.families],
                "candidates": self.candidates(),
                "where": None if self.where is None else as_json(self.where, time, stations),
                "improvement": self.improvement(),
                "materials": {"before": materials(self.baseline.refit), "after": materials(self.final.refit)},
                "remaining": self.remaining(),
                "doubt": self.doubt,
                "limits": self.limits,
                "next_observation": self.next_observation,
                "sets": told(self.others, self.final, self.baseline),
                "nights": [vars(night) for night in self.nights[:8]],
                "untried": [{"effect": entry, "reason": reason} for entry, reason in self.untried.items()],
                "seconds": self.seconds,
            }
        )

    def candidates(self) -> list[dict[str, Any]]:
        """Every effect tried, best first: refitted ones by evidence, noise models among them, the rest by
        score.

        Gains are over the baseline with white noise: of an effect with white noise too, of noise alone.
        """
        rows = []
        base = self.baseline
        white, heldout_white = base.score.white
        for found in self.first:
            (entry,), (plain,) = found.hypothesis.added, found.hypothesis.plain
            rows.append(
                {
                    **_names(entry),
                    "score": self.probes[plain].score,
                    "p": self.gate.marginal.get(f"signature {plain}"),
                    "delta_log_evidence": found.score.white[0] - white,
                    "heldout_delta_log_likelihood": found.score.white[1] - heldout_white,
                    "parameters": effect_parameters(found.refit, entry),
                    "chi2_after": found.refit.chi2,
                }
            )
        rows += [
            {
                **_names(kind),
                "score": None,
                "p": None,
                "delta_log_evidence": value - white,
                "heldout_delta_log_likelihood": heldout - heldout_white,
                "parameters": {},
                "chi2_after": base.refit.chi2,
            }
            for kind, (value, heldout) in base.score.by_kind.items()
        ]
        rows.sort(key=lambda row: -row["delta_log_evidence"])
        tried = {found.hypothesis.plain[0] for found in self.first}
        untried = [entry for entry in self.probes if entry not in tried]
        rows += [
            {
                **_names(entry),
                "score": self.probes[entry].score,
                "p": self.gate.marginal.get(f"signature {entry}"),
                "delta_log_evidence": None,
                "heldout_delta_log_likelihood": None,
                "parameters": {},
                "chi2_after": None,
            }
            for entry in sorted(untried, key=lambda one: -self.probes[one].score)
        ]
        return rows

    def improvement(self) -> dict[str, Any]:
        before, after = self.baseline.refit, self.final.refit
        return {
            "chi2_before": before.chi2,
            "chi2_after": after.chi2,
            "dof": after.likelihood.degrees_of_freedom,
            "rms_before": _rms(before.off_mag),
            "rms_after": _rms(after.off_mag),
            "heldout_rms_before": self.scorer.heldout_rms(before),
            "heldout_rms_after": self.scorer.heldout_rms(after),
        }

    def remaining(self) -> dict[str, Any]:
        p = self.final_gate.global_p
        refit = self.final.refit
        left = (
            f"rms {_rms(refit.off_mag):.3f} mag"
            if refit.likelihood.fitted_errors
            else f"chi2 {refit.chi2:.0f} for {refit.likelihood.degrees_of_freedom} degrees of freedom"
        )
        if p >= 0.01:
            note = f"nothing that the data show: {left}"
        else:
            worst = min(self.final_gate.marginal, key=lambda name: self.final_gate.marginal[name])
            note = f"structure is left: {left}, strongest in the statistic '{worst}'"
            kind = self.final.score.noise.kind
            if kind is not None:
                note += f"; described by {kind.name} ({kind.title})"
        if self.law:
            note += f"; the surfaces follow the law {self.law} better than that of the scene"
        return {"global_p": p, "note": note}


def completed_scene(scene: Scene, effects: Sequence[Effect]) -> Scene:
    """``scene`` with these effects as its list; an offset that is divided gets its prior in the parameters, one value
    for each curve or night."""
    divided = {
        effect.origin(quantity.name).full_name(): Free(
            value=quantity.off or 0.0,
            sigma=effect.width or quantity.sigma or 1.0,
            prior="normal",
            per=cast(Any, effect.by),
        )
        for effect in effects
        if effect.by is not None
        for quantity in effect.quantities
    }
    update = {
        "effects": [Entry(effect.name, effect.target).plain for effect in effects],
        "parameters": scene.model.parameters | divided,
    }
    return scene.model_copy(update={"model": scene.model.model_copy(update=update)})


def _names(entry: str) -> dict[str, str | None]:
    parsed = Entry.parse(entry)
    return {"effect": parsed.name, "target": parsed.target, "per": parsed.per}


@on_cpu
def materials(refit: Refit) -> dict[str, dict[str, float]]:
    """Median, sd and 90 % interval of every free material parameter, from the posterior's minima, each linear in
    flat coordinates and weighed by its mass."""
    parameters = refit.model.parameter_set
    names = [i for i, free in enumerate(parameters.free) if free.origin.role == "materials"]
    if not names:
        return {}
    generator = torch.Generator().manual_seed(0)
    low, high = parameters.flat_bounds()
    modes = [refit, *refit.others]
    weight = torch.softmax(torch.tensor([mode.log_mass for mode in modes], dtype=refit.y.dtype), 0)
    member = torch.multinomial(weight, DRAWS, replacement=True, generator=generator)
    draws = refit.y.new_empty(DRAWS, len(parameters))
    for number, mode in enumerate(modes):
        values, vectors = torch.linalg.eigh(mode.covariance())
        noise = torch.randn(DRAWS, len(parameters), generator=generator, dtype=refit.y.dtype)
        spread = mode.y + noise @ (vectors * torch.sqrt(values.clamp(min=0))).T
        draws = torch.where((member == number)[:, None], spread, draws)
    draws = torch.minimum(torch.maximum(draws, low), high)
    theta = parameters.from_flat(draws)
    found = {}
    for i in names:
        column = theta[:, i]
        q05, q50, q95 = torch.quantile(column, torch.tensor([0.05, 0.5, 0.95], dtype=column.dtype)).tolist()
        found[parameters.names[i]] = {"median": q50, "sd": float(column.std()), "q05": q05, "q95": q95}
    return found


def effect_parameters(refit: Refit, entry: str) -> dict[str, dict[str, Any]]:
    """Median, sd and unit of the parameters of one effect entry."""
    parameters = refit.model.parameter_set
    columns = effect_columns(parameters, entry)
    covariance = refit.covariance()
    found = {}
    for column in columns:
        free = parameters.free[column]
        sd = float(torch.sqrt(covariance[column, column].clamp(min=0)))
        sd *= math.exp(float(free.prior.log_slope(refit.y[column])))
        found[free.origin.short] = {"median": float(refit.theta[column]), "sd": sd, "unit": free.unit}
    return found


def _rms(value: Tensor) -> float:
    return float(torch.sqrt((value * value).mean()))


def _clean(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _clean(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
