"""report.html of a diagnosis: the verdict in words, where it shows, every effect tried, and what it does to
the materials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from torchlc.diagnosis.result import Diagnosis
from torchlc.diagnosis.words import (
    candidate,
    chance,
    changes,
    improvement,
    material_value,
    probability,
    words,
)
from torchlc.figures.viewer import viewer_data
from torchlc.files.writing import DIAGNOSIS_FILES, RESULT_FILES, OutputDirectory
from torchlc.report.figures import Drawn, by_section, draw_all, png
from torchlc.report.page import environment, origin, titled
from torchlc.version import __version__

MOST_CANDIDATES = 15
MOST_INTERVALS = 12
SECTIONS = ("missing", "object")
"""Sections of the page that figures may close; other figures have sections of their own."""


def write_diagnosis(diagnosis: Diagnosis, made: Mapping[str, Any], directory: OutputDirectory) -> None:
    """diagnosis.json, the figures and report.html, in this order, in place of what a run before left."""
    directory.clear(RESULT_FILES - DIAGNOSIS_FILES)
    directory.write_json("diagnosis.json", diagnosis.to_json() | {"provenance": dict(made)})
    drawn = draw_all("diagnosis", diagnosis)
    for figure in drawn:
        directory.write_bytes(f"{figure.kind.name}.png", png(figure))
    directory.write_text("report.html", render_diagnosis(diagnosis, made, drawn))


def render_diagnosis(
    diagnosis: Diagnosis, made: Mapping[str, Any], drawn: Sequence[Drawn] | None = None
) -> str:
    """The page of a diagnosis."""
    model = diagnosis.model
    return (
        environment()
        .get_template("diagnosis.html")
        .render(
            version=__version__,
            title=f"{model.scene.name}: diagnosis",
            name=model.scene.name,
            kicker=origin(model.recording),
            warnings=diagnosis.warnings,
            diagnosis=context(diagnosis, drawn),
            viewer=viewer_data(model, diagnosis.view, diagnosis.prediction),
            made={"inputs": {}, "versions": {}, "command": None, "seed": diagnosis.seed} | dict(made),
        )
    )


def context(diagnosis: Diagnosis, drawn: Sequence[Drawn] | None = None) -> dict[str, Any]:
    """What the template's part for a diagnosis shows."""
    content = diagnosis.content
    kinds = {row["effect"] for row in content["candidates"] if row["score"] is None}
    where = content["where"] or {"intervals": [], "components": [], "coordinate": None}
    tried = [row for row in content["candidates"] if row["delta_log_evidence"] is not None]
    physics = [row for row in tried if row["effect"] not in kinds]
    return {
        "verdict": content["verdict"],
        "words": words(content, diagnosis.added),
        "bad_rows": [
            row | {"probability": probability(row["probability"])}
            for row in content["outliers"][:MOST_INTERVALS]
        ],
        "more_bad_rows": max(len(content["outliers"]) - MOST_INTERVALS, 0),
        "named": content["named"],
        "substances": _substances(content["materials"]["after"], diagnosis),
        "pictures": by_section(
            diagnosis, draw_all("diagnosis", diagnosis) if drawn is None else drawn, SECTIONS
        ),
        "intervals": where["intervals"][:MOST_INTERVALS],
        "more_intervals": max(len(where["intervals"]) - MOST_INTERVALS, 0),
        "components": where["components"],
        "coordinate": where["coordinate"],
        "candidates": [candidate(row) for row in physics[:MOST_CANDIDATES]],
        "noise": [candidate(row) for row in tried if row["effect"] in kinds],
        "sets": [
            {
                **candidate(
                    row | {"parameters": {}, "effect": " + ".join(row["effects"]).replace("@", " of each ")}
                ),
                "why": row["why_not"],
            }
            for row in content["sets"]
        ],
        "screened": len(content["candidates"]) - len(tried) + max(len(physics) - MOST_CANDIDATES, 0),
        "improvement": improvement(content) if content["named"] else [],
        "materials": changes(content["materials"]),
        "global_p": chance(content["global_p"]),
    }


def _substances(after: Mapping[str, Any], diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Each material with its values over all that may be so."""
    titles = {free.name: titled(free) for free in diagnosis.model.parameter_set.free}
    by_owner: dict[str, list[str]] = {}
    for name, row in after.items():
        owner, _, short = name.rpartition(".")
        by_owner.setdefault(owner, []).append(f"{titles.get(name, short)} {material_value(row)}")
    return [(owner, ", ".join(values)) for owner, values in by_owner.items()]
