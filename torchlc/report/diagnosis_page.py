"""report.html of a diagnosis: the verdict in words, where it shows, every effect tried, and what it does to
the materials.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from torchlc.diagnosis.result import Diagnosis, effect_parameters
from torchlc.effects import registry
from torchlc.figures.curves import Comparison, curve_size, draw_curves
from torchlc.figures.object_drawing import brightest, draw_object
from torchlc.figures.viewer import viewer_data
from torchlc.files.writing import DIAGNOSIS_FILES, RESULT_FILES, OutputDirectory
from torchlc.inference.identifiability import bare_view
from torchlc.readers import left_out
from torchlc.report.fit_page import environment, markup, origin, png
from torchlc.report.listing import first_sentence
from torchlc.results.fit_result import stated
from torchlc.stages.effect import Entry
from torchlc.version import __version__

MOST_PARTS = 4
MOST_CANDIDATES = 15
MOST_INTERVALS = 12
NOISE = {
    "jitter": "errors larger than quoted",
    "red_noise": "noise that is correlated in time",
    "outliers": "outliers",
}
VERDICTS = {
    "adequate": "Nothing is missing that these data could show.",
    "missing_physics": "The model lacks {named}.",
    "noise_model": "The misfit is noise, not physics: {named}.",
    "unexplained": "Something is missing, and no effect of the library explains it.",
}


def write_diagnosis(diagnosis: Diagnosis, made: Mapping[str, Any], directory: OutputDirectory) -> None:
    """diagnosis.json, the figures and report.html, in this order, in place of what a run before left."""
    directory.clear(RESULT_FILES - DIAGNOSIS_FILES)
    directory.write_json("diagnosis.json", diagnosis.to_json() | {"provenance": dict(made)})
    figure = comparison_figure(diagnosis)
    directory.write_bytes("curve.png", png(figure))
    model, prediction = _final(diagnosis)
    drawn = Figure(figsize=(5.6, 5.0))
    row = brightest(model.recording, prediction)
    draw_object(model, bare_view(model, diagnosis.final.refit.theta), row, drawn.subplots())
    directory.write_bytes("object.png", png(drawn))
    directory.write_text("report.html", render_diagnosis(diagnosis, made))


def render_diagnosis(diagnosis: Diagnosis, made: Mapping[str, Any]) -> str:
    """The page of a diagnosis."""
    model, prediction = _final(diagnosis)
    view = bare_view(model, diagnosis.final.refit.theta)
    return (
        environment()
        .get_template("diagnosis.html")
        .render(
            version=__version__,
            title=f"{model.scene.name}: diagnosis",
            name=model.scene.name,
            kicker=origin(model.recording),
            warnings=warnings(diagnosis),
            diagnosis=context(diagnosis),
            viewer=viewer_data(model, view, prediction),
            made={"inputs": {}, "versions": {}, "command": None, "seed": diagnosis.seed} | dict(made),
        )
    )


def warnings(diagnosis: Diagnosis) -> list[str]:
    """What a reader should know of scene and recording, each once."""
    model, _ = _final(diagnosis)
    return list(dict.fromkeys([*left_out(model.recording), *model.warnings, *diagnosis.limits]))


def context(diagnosis: Diagnosis) -> dict[str, Any]:
    """What the template's part for a diagnosis shows."""
    content = diagnosis.to_json()
    where = content["where"] or {"intervals": [], "components": [], "coordinate": None}
    alt = f"Light curve with the model before and after; {len(where['intervals'])} stretches where they differ are marked."
    tried = [row for row in content["candidates"] if row["delta_log_evidence"] is not None]
    physics = [row for row in tried if row["effect"] not in NOISE]
    return {
        "verdict": content["verdict"],
        "words": words(content, added_parameters(diagnosis)),
        "substances": _substances(content["materials"]["after"]),
        "curve": markup(comparison_figure(diagnosis), alt),
        "intervals": where["intervals"][:MOST_INTERVALS],
        "more_intervals": max(len(where["intervals"]) - MOST_INTERVALS, 0),
        "components": where["components"],
        "coordinate": where["coordinate"],
        "candidates": [_candidate(row) for row in physics[:MOST_CANDIDATES]],
        "noise": [_candidate(row) for row in tried if row["effect"] in NOISE],
        "sets": [
            {
                **_candidate(
                    row | {"parameters": {}, "effect": " + ".join(row["effects"]).replace("@", " of each ")}
                ),
                "why": row["why_not"],
            }
            for row in content["sets"]
        ],
        "screened": len(content["candidates"]) - len(tried) + max(len(physics) - MOST_CANDIDATES, 0),
        "improvement": _improvement(content) if content["named"] else [],
        "materials": _changes(content["materials"]),
        "global_p": _chance(content["global_p"]),
    }


def comparison(diagnosis: Diagnosis) -> Comparison:
    """Recording, the baseline refitted, and the final model; rows where they differ are marked."""
    before, after = diagnosis.baseline.refit, diagnosis.final.refit
    recording = after.model.recording
    changed = bool(after.hypothesis.added)
    return Comparison(
        recording,
        after.prediction.numpy(),
        after.sigma.expand(len(recording)).numpy(),
        before=before.prediction.numpy() if changed else None,
        marked=None if diagnosis.where is None else diagnosis.where.rows.numpy(),
    )


def comparison_figure(diagnosis: Diagnosis) -> Figure:
    """What :func:`comparison` says, drawn."""
    shown = comparison(diagnosis)
    figure = Figure(figsize=curve_size(shown.recording))
    draw_curves(shown, figure)
    return figure


def added_parameters(diagnosis: Diagnosis) -> dict[str, str]:
    """Values of the parameters that the final model adds, by effect and name, ready to print."""
    return {
        f"{Entry.parse(entry).name}.{short}": value
        for entry in diagnosis.final.hypothesis.added
        for short, value in _values(effect_parameters(diagnosis.final.refit, entry)).items()
    }


def headline(content: Mapping[str, Any]) -> str:
    """The verdict in one line, from the content of diagnosis.json."""
    told = [_or(family) for family in content["families"]]
    noise = [NOISE.get(str(name), str(name)) for name in content["named"]]
    verdict = VERDICTS[content["verdict"]].format(
        named=_and(noise if content["verdict"] == "noise_model" else told)
    )
    if content["doubt"]:
        verdict = f"{verdict} {_first_upper(content['doubt'])}."
    chance = _chance(content["global_p"])
    return f"{verdict} The chance of structure like this where nothing is missing: {chance}."


def lines(diagnosis: Diagnosis) -> list[str]:
    """What a terminal shows: the verdict, what was found, the materials before and after, what to do next."""
    content = diagnosis.to_json()
    told = [headline(content)]
    told += [f"  {name} = {value}" for name, value in added_parameters(diagnosis).items()]
    if content["named"]:
        rows = [(f"  {name}", before, f"→ {after}") for name, before, after in _changes(content["materials"])]
        rows += [(f"  {name}", before, f"→ {after}") for name, before, after in _improvement(content)]
        widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
        told += [f"{name:{widths[0]}}  {before:>{widths[1]}} {after}" for name, before, after in rows]
    told.append(f"left: {content['remaining']['note']}")
    if content["next_observation"]:
        told.append(f"next: {content['next_observation']}")
    if content["verdict"] == "missing_physics":
        effects = json.dumps(diagnosis.completed.model.effects)
        told.append(f"to fit with it, put into [model] of the scene: effects = {effects}")
    return told


def words(content: Mapping[str, Any], added: Mapping[str, str]) -> list[str]:
    """Verdict, proof, place, materials and what cannot be told, in sentences, from the content of
    diagnosis.json.
    """
    named, improvement = content["named"], content["improvement"]
    paragraphs = [headline(content)]
    if content["verdict"] == "missing_physics":
        proof = (
            f"With it in the model the residuals fall from {improvement['rms_before']:.3f} to "
            f"{improvement['rms_after']:.3f} mag (root mean square)"
            if content["error_source"] == "fitted"
            else f"With it in the model chi-square falls from {improvement['chi2_before']:.0f} to "
            f"{improvement['chi2_after']:.0f} for {improvement['dof']} degrees of freedom"
        )
        if improvement["heldout_rms_after"] is not None and improvement["heldout_rms_before"] is not None:
            proof += (
                f", and rows that the fit had not seen are predicted to {improvement['heldout_rms_after']:.3g} mag "
                f"instead of {improvement['heldout_rms_before']:.3g}"
            )
        meant = [
            f"{name}: {_lowered(first_sentence(registry()[name]))}" for name in named if name in registry()
        ]
        values = (
            f" Found: {', '.join(f'{name} = {value}' for name, value in added.items())}." if added else ""
        )
        paragraphs.append(f"{proof}.{values} {' '.join(meant)}")
    if content["where"] is not None:
        paragraphs.append(_place(content["where"]))
    paragraphs.append(f"What is left: {content['remaining']['note']}.")
    if content["next_observation"]:
        paragraphs.append(_first_upper(content["next_observation"]).rstrip(".") + ".")
    return paragraphs


def _substances(after: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Each material with its values in the final model."""
    by_owner: dict[str, list[str]] = {}
    for name, row in after.items():
        owner, _, short = name.rpartition(".")
        by_owner.setdefault(owner, []).append(f"{short} = {_row(row)}")
    return [(owner, ", ".join(values)) for owner, values in by_owner.items()]


def _place(where: Mapping[str, Any]) -> str:
    intervals = where["intervals"]
    text = "It is too faint to show in any one stretch of the recording"
    if intervals:
        text = f"It shows in {len(intervals)} stretch{'es' if len(intervals) != 1 else ''} of the recording"
        strongest = max(intervals, key=lambda one: one["significance"])
        text += f", most between {_clock(strongest['start'])} and {_clock(strongest['end'])}"
    if where["components"]:
        first = where["components"][0]
        text += f"; {100 * first['share']:.0f} % of it comes from {first['name']}"
    one = where["coordinate"]
    if one and one["name"] != "time":  # the stretches are of time
        text += f"; it follows {one['name']} between {one['from']:.4g} and {one['to']:.4g}"
    return text + "."


def _candidate(row: Mapping[str, Any]) -> dict[str, str]:
    values = ", ".join(f"{name} {value}" for name, value in _values(row["parameters"]).items())
    return {
        "effect": row["effect"]
        + (f" [{row['target']}]" if row.get("target") else "")
        + (f" of each {row['per']}" if row.get("per") else ""),
        "evidence": _signed(row["delta_log_evidence"]),
        "heldout": _signed(row["heldout_delta_log_likelihood"]),
        "chi2": "" if row["chi2_after"] is None else f"{row['chi2_after']:.0f}",
        "values": values,
    }


def _values(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Each parameter's value with its uncertainty; those that every curve or night has for itself in one, by their
    root mean square and range."""
    found = {}
    for name, row in parameters.items():
        short, bracket, _ = name.partition("[")
        parts = [one["median"] for other, one in parameters.items() if other.startswith(f"{short}[")]
        if not bracket or len(parts) <= MOST_PARTS:
            found[name] = _pair(row["median"], row["sd"], row["unit"])
        elif f"{short} of {len(parts)}" not in found:
            spread = math.sqrt(sum(one**2 for one in parts) / len(parts))
            unit = f" {row['unit']}" if row["unit"] else ""
            low, high = min(parts), max(parts)
            found[f"{short} of {len(parts)}"] = (
                f"root mean square {spread:.3g}{unit}, from {low:.3g} to {high:.3g}{unit}"
            )
    return found


def _improvement(content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(measure, before, after); chi-square only where errors are quoted, for fitted ones make it what it is."""
    rows = [("chi-square", "chi2", 0), ("rms, mag", "rms", 4), ("rms of unseen rows, mag", "heldout_rms", 4)]
    found = []
    for name, key, digits in rows[content["error_source"] == "fitted" :]:
        before, after = (content["improvement"][f"{key}_{when}"] for when in ("before", "after"))
        if before is not None and after is not None:
            found.append((name, f"{before:.{digits}f}", f"{after:.{digits}f}"))
    return found


def _changes(content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(parameter, before, after) of every material's parameter."""
    before, after = content["before"], content["after"]
    return [(name, _row(before[name]), _row(after[name])) for name in before if name in after]


def _row(row: Mapping[str, Any]) -> str:
    return stated({**row, "unit": ""})


def _pair(median: float, sd: float | None, unit: str) -> str:
    spread = sd or 0.0
    return stated(
        {
            "median": median,
            "sd": spread,
            "q05": median - 1.64 * spread,
            "q95": median + 1.64 * spread,
            "unit": unit,
        }
    )


def _signed(value: float | None) -> str:
    return "" if value is None else f"{value:+.1f}" if abs(value) < 1000 else f"{value:+.0f}"


def _chance(p: float | None) -> str:
    if p is None:
        return "unknown"
    return "below 1e-12" if p < 1e-12 else f"{p:.2g}"


def _or(family: Sequence[str]) -> str:
    return (
        family[0]
        if len(family) == 1
        else f"{family[0]} (or {' or '.join(family[1:])}: these data cannot tell)"
    )


def _and(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else "nothing"


def _clock(iso: str) -> str:
    return iso[:16].replace("T", " ")


def _first_upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _lowered(text: str) -> str:
    return text[:1].lower() + text[1:]


def _final(diagnosis: Diagnosis) -> tuple[Any, Any]:
    """The final model and its prediction (T,)."""
    refit = diagnosis.final.refit
    return refit.model, refit.prediction.numpy()
