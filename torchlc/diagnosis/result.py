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

from torchlc.diagnosis.alternatives import NOMINAL
from torchlc.diagnosis.counts import Counted
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.gate import Gate
from torchlc.diagnosis.hypotheses import SCALE, Hypothesis
from torchlc.diagnosis.plan import Option
from torchlc.diagnosis.probabilities import TOLD, Probabilities
from torchlc.diagnosis.proof import Unseen, difference
from torchlc.diagnosis.tried import candidates, sets
from torchlc.diagnosis.values import effect_parameters, materials
from torchlc.diagnosis.where import Where, as_json
from torchlc.diagnosis.words import added_values, lines, probability, statistic, unexamined
from torchlc.digits import against_freedom
from torchlc.effects import with_title
from torchlc.errors import option
from torchlc.files.writing import without_nan
from torchlc.inference.density import BAD_ROW, Fitted
from torchlc.inference.identifiability import bare_view, limits
from torchlc.lightcurve.model import LightCurve
from torchlc.lightcurve.numbers import divided_offset
from torchlc.readers import Recording, left_out, place_of_row
from torchlc.scene import Scene
from torchlc.stages.effect import Effect
from torchlc.stages.entry import Entry
from torchlc.stages.light import View

if TYPE_CHECKING:
    import pandas
    from astropy.table import Table
    from matplotlib.axes import Axes

    from torchlc.figures.curves import Comparison

SCHEMA = "torchlc-diagnosis/2"
CURVE_POINTS = 64


@dataclass(frozen=True)
class Diagnosis:
    """What a ``search`` found and how probable it is (``odds``), from which ``verdict``, ``named`` and ``families`` are read
    off; ``gate`` of the scene's own model, ``baseline``, and ``final_gate`` of the ``final`` one, ``where`` they differ, and
    the ``proof``: how models predict rows that they have not seen, by name."""

    search: Search
    odds: Probabilities
    gate: Gate
    final_gate: Gate
    baseline: Fitted
    final: Fitted
    where: Where | None
    coordinates: Mapping[str, Tensor]
    proof: Mapping[str, Unseen]
    quick: bool
    seconds: float
    untried: Mapping[str, str] = field(default_factory=dict)
    """Why, by entry, an effect was no candidate although it was asked for, or could act."""
    nights: Sequence[Option] = ()
    next_observation: str = ""

    @property
    def verdict(self) -> str:
        return self.odds.verdict

    @property
    def named(self) -> tuple[str, ...]:
        return self.odds.named

    @property
    def families(self) -> tuple[tuple[str, ...], ...]:
        return self.odds.families

    @property
    def seed(self) -> int:
        return self.search.seed

    @property
    def law(self) -> str:
        """Another law of reflection under which the recording is described better than under the scene's own."""
        return self.final.hypothesis.law

    def __repr__(self) -> str:
        return "\n".join(["Diagnosis: " + self.verdict, *self.lines()])

    def lines(self) -> list[str]:
        """The verdict, what was found, the materials before and after, and what to do next, line by line."""
        return lines(self.content, self.added, self.completed.model.effects or ())

    @property
    def warnings(self) -> list[str]:
        """What a reader should know of scene and recording, each once."""
        untried = [f"{with_title(entry)} is no candidate: {reason}" for entry, reason in self.untried.items()]
        late = unexamined(self.search.unexamined)
        warned = [*left_out(self.recording), *self.model.warnings, *untried, *late, *self.limits]
        open_counts = self.turns(self.final).fit
        if open_counts > 1:
            warned.append(
                f"{open_counts} counts of turns between the nights fit about as well: the errors of what turns are those of all of them, "
                "the value is that of one; torchlc rotation lists them"
            )
        clock = self.search.clock
        if clock.stopped:
            warned.append("interrupted: the verdict is that of what had been examined")
        elif clock.cut and clock.seconds is not None:
            warned.append(
                f"the search was ended after {clock.seconds:.0f} s of CPU time: some sets of effects or ways to err were not tried; "
                f"{option('budget', round(2 * clock.seconds))} has more of them tried"
            )
        return list(dict.fromkeys(warned))

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
        return self.final.model

    @cached_property
    def view(self) -> View:
        """Geometry of every row at the final model's best parameters."""
        return bare_view(self.model, self.final.theta)

    @property
    def recording(self) -> Recording:
        return self.model.recording

    @property
    def prediction(self) -> np.ndarray:
        """The final model in the recording's unit, (T,)."""
        return self.final.prediction.numpy()

    @property
    def comparison(self) -> Comparison:
        """Recording, the baseline refitted, and the final model; rows where they differ are marked."""
        from torchlc.figures.curves import Comparison

        before, after = self.baseline, self.final
        return Comparison(
            self.recording,
            self.prediction,
            after.wide.numpy(),
            before=before.prediction.numpy() if after.hypothesis.added else None,
            marked=None if self.where is None else self.where.rows.numpy(),
            outlying=(self.final.outlying() > BAD_ROW).numpy(),
        )

    @property
    def added(self) -> dict[str, str]:
        """Values of the parameters that the final model adds, by effect and name, ready to print."""
        at = self.final
        turns = self.turns(at)
        return added_values({entry: effect_parameters(at, entry, turns) for entry in at.hypothesis.added})

    def turns(self, at: Fitted) -> Counted:
        """What counts of turns between nights or curves leave open beside a fit: as asked for the most of its effects."""
        added = set(at.hypothesis.plain)
        asked = [entries for entries in self.search.turns if set(entries) <= added]
        return self.search.turns[max(asked, key=len)] if asked else Counted(at.theta[None, :0])

    @property
    def completed(self) -> Scene:
        """The scene with the named effects in its list, to be fitted next; the scene itself where nothing is
        named."""
        if self.verdict != "missing_physics":
            return self.search.bench.scene
        # the scene's own model may be better under another law of reflection, under which not every effect can act
        return completed_scene(self.final.model.scene, self.final.model.effects)

    @cached_property
    def limits(self) -> list[str]:
        """What the approximations of the final model amount to, where that is worth telling."""
        return limits(self.final.model, self.final.theta)

    def _possible(self) -> list[tuple[Fitted, float]]:
        """The answer, and all else that may be so under its law of reflection, with their probabilities: an effect in the place of the named one
        has other materials."""
        odds, final = self.odds, self.final
        every = [((), odds.nothing + odds.noise + odds.unexplained), *odds.sets]
        alike = [(at, p) for at, p in self.search.likely(every) if at.hypothesis.law == final.hypothesis.law]
        # the answer's own fit may have been weighed once more
        return [(final, 0.0), *((final if at.hypothesis == final.hypothesis else at, p) for at, p in alike)]

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json, without NaN."""
        return dict(self.content)

    @cached_property
    def content(self) -> dict[str, Any]:
        """What :meth:`to_json` gives, worked out once."""
        recording = self.baseline.model.recording
        time = [str(instant) for instant in cast(Any, recording.time.isot)]
        stations = (
            [recording.station_ids[i] for i in recording.station]
            if recording.station_ids
            else [""] * len(time)
        )
        return without_nan(
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
                "materials": {
                    "before": materials([(self.baseline, 1.0)]),
                    "after": materials(self._possible()),
                },
                "remaining": self.remaining(),
                "doubt": self.doubt,
                "limits": self.limits,
                "probabilities": self.probabilities(),
                "outliers": self.outliers(time, stations),
                "discrepancy": self.discrepancy(),
                "proof": self.proven(),
                "next_observation": self.next_observation,
                "sets": self.sets(),
                "nights": [vars(night) for night in self.nights[:8]],
                "untried": [{"effect": entry, "reason": reason} for entry, reason in self.untried.items()],
                "unexamined": [
                    {"effect": entry, "reason": reason} for entry, reason in self.search.unexamined.items()
                ],
                "seconds": self.seconds,
            }
        )

    @property
    def doubt(self) -> str:
        """Why nothing is named although something is or may be missing: too few rows; or what comes nearest, and how near."""
        if self.odds.spare <= 0:
            likelihood = self.search.visited[Hypothesis()].likelihood
            rows, free = int(likelihood.measured.sum()), len(likelihood.model.names) + likelihood.gains
            return f"{free} free numbers leave none of the {rows} measured row{'s' * (rows != 1)} to spare"
        if self.verdict != "unexplained":
            return ""
        near = [
            f"{with_title(name)} {probability(p)}"
            for name, p in list(self.odds.effects.items())[:3]
            if p >= 0.005
        ]
        if self.law == NOMINAL:
            return "sizes of the components some per cent from the scene's explain it as well as anything"
        if self.odds.shapeless < 1 - TOLD:
            return f"surfaces that follow another law of reflection do: {self.law}"
        return f"nearest in the library: {', '.join(near)}" if near else ""

    def probabilities(self) -> dict[str, Any]:
        """The probabilities that the verdict is read off."""
        odds = self.odds
        return {
            "told": odds.told,
            "nothing_missing": odds.nothing,
            "too_weak": sum(odds.too_weak),
            "noise": odds.noise,
            "noise_kinds": dict(odds.kinds),
            "effects": dict(odds.effects),
            "not_in_library": odds.unknown,
            "other_laws": {law: p for law, p in odds.laws.items() if law != NOMINAL},
            "not_examined": odds.unexamined,
            "something_beside": odds.leftover,
        }

    def candidates(self) -> list[dict[str, Any]]:
        """Every effect tried, best first: refitted ones by evidence, kinds of noise among them, the rest by score."""
        return candidates(self.search, self.odds, self.gate, self._foreseen, self.turns)

    def _foreseen(self, at: Fitted | None) -> float | None:
        """What a model gains over the scene's own, errors as quoted, in log density of unseen rows, where it was asked."""
        shown = {"final": self.final, "null": self.baseline}
        alike = [
            key for key, fitted in shown.items() if at is not None and fitted.hypothesis == at.hypothesis
        ]
        name = next((key for key in alike if key in self.proof), None)
        if name is None or "as quoted" not in self.proof:
            return None
        return self.proof[name].total - self.proof["as quoted"].total

    def sets(self) -> list[dict[str, Any]]:
        """The sets beside the final one, best first, with the odds against each."""
        return sets(self.search, self.final)

    def improvement(self) -> dict[str, Any]:
        before, after = self.baseline, self.final
        unseen = {key: self.proof[key].rms if key in self.proof else None for key in ("null", "final")}
        return {
            "chi2_before": before.chi2,
            "chi2_after": after.chi2,
            "dof": after.likelihood.degrees_of_freedom,
            "rms_before": _rms(before.off_mag),
            "rms_after": _rms(after.off_mag),
            "heldout_rms_before": unseen["null"],
            "heldout_rms_after": unseen["final"],
        }

    def proven(self) -> dict[str, Any]:
        """Log density and root mean square of rows that the fits had not seen, and what the answer gains over the others."""
        models = {"null": self.baseline, "final": self.final}
        rows = {
            name: {
                "effects": list(models[name].hypothesis.plain) if name in models else None,
                "log_density": score.total,
                "rms_mag": score.rms,
                "blocks": len(score.log_density),
            }
            for name, score in self.proof.items()
        }
        gains = {
            name: dict(zip(("difference", "error"), difference(self.proof["final"], score), strict=True))
            for name, score in self.proof.items()
            if name != "final" and "final" in self.proof
        }
        return {"models": rows, "gain_of_final_over": gains}

    def outliers(self, time: Sequence[str], stations: Sequence[str]) -> list[dict[str, Any]]:
        """Rows that are probably bad, in order of time."""
        bad = self.final.outlying()
        order = np.argsort(self.recording.seconds)
        return [
            {
                "time": time[row],
                "station": stations[row],
                "place": place_of_row(self.recording, row),
                "probability": float(bad[row]),
            }
            for row in order.tolist()
            if float(bad[row]) > BAD_ROW
        ]

    def discrepancy(self) -> dict[str, Any] | None:
        """The shape of what no effect describes, in its best coordinate, with its probability; null where none is likely."""
        odd = self.search.strongest()
        if odd is None or self.odds.shapeless + self.odds.leftover < TOLD:
            return None
        name = "time" if odd.coordinate not in self.coordinates else odd.coordinate
        value = self.coordinates[name]
        order = torch.argsort(value)
        some = order[torch.linspace(0, len(order) - 1, min(CURVE_POINTS, len(order))).long()]
        rows = self.coordinates["time"][odd.rows]
        return {
            "coordinate": odd.coordinate,
            "like": None if odd.like is None else list(odd.like.hypothesis.unlisted),
            "beside": list(odd.beside.plain),
            "log_evidence_gained": odd.log_gain,
            "values": value[some].tolist(),
            "mag": odd.curve[some].tolist(),
            "band_mag": odd.band[some].tolist(),
            "rows": int(odd.rows.sum()),
            "seconds": [float(rows.min()), float(rows.max())],
            "period_s": odd.period or None,
            "course": odd.course(self.coordinates["time"]),
        }

    def remaining(self) -> dict[str, Any]:
        p, at = self.final_gate.global_p, self.final
        left = f"rms {_rms(at.off_mag):.3f} mag"
        if not at.likelihood.fitted_errors and at.noise.normal and not at.noise.processes:
            left = f"chi-square {against_freedom(at.chi2, at.likelihood.degrees_of_freedom, 0)}"
        beside = self.odds.leftover if self.verdict == "missing_physics" else self.odds.shapeless
        if beside < TOLD:
            note = f"nothing that the data show: {left}"
        else:
            worst = min(self.final_gate.marginal, key=lambda name: self.final_gate.marginal[name])
            note = f"structure is left: {left}, most of all {statistic(worst)}"
            odd = self.search.strongest()
            if odd is not None and odd.log_gain > 0:
                note += f"; it {odd.course(self.coordinates['time'])}"
        if at.hypothesis.noise:
            kinds = ["a free scale" if kind == SCALE else with_title(kind) for kind in at.hypothesis.noise]
            note += f"; errors of rows are taken with {' and '.join(kinds)}"
        if SCALE in at.hypothesis.noise:
            note += f" ({float(at.posterior.factor(at.g)):.2f} times the quoted errors)"  # pyright: ignore[reportArgumentType]
        if self.law and self.law != NOMINAL:
            note += f"; the surfaces follow the law {self.law} better than that of the scene"
        return {"global_p": p, "note": note}


def completed_scene(scene: Scene, effects: Sequence[Effect]) -> Scene:
    """``scene`` with these effects as its list; an offset that is divided gets its prior in the parameters, one value
    for each curve or night."""
    divided = {
        effect.origin(quantity.name).full_name(): divided_offset(effect, quantity)
        for effect in effects
        if effect.by is not None
        for quantity in effect.quantities
    }
    update = {
        "effects": [Entry(effect.name, effect.target).plain for effect in effects],
        "parameters": scene.model.parameters | divided,
    }
    return scene.model_copy(update={"model": scene.model.model_copy(update=update)})


def _rms(value: Tensor) -> float:
    return float(torch.sqrt((value * value).mean()))
