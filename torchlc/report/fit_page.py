"""What a fit leaves in its directory, and report.html: one file with its figures, its words and its numbers
inside.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from torchlc.digits import against_freedom, decimals, number_of, rounded, stated
from torchlc.figures.viewer import viewer_data
from torchlc.files.writing import DIAGNOSIS_FILES, FIT_FILES, RESULT_FILES, SAMPLED_FILES, OutputDirectory
from torchlc.inference.posterior_draws import GOOD_RHAT
from torchlc.materials.known import OTHER
from torchlc.noise.kind import NoiseKind
from torchlc.parameters import Free
from torchlc.readers import counted
from torchlc.report.figures import Drawn, by_section, draw_all, png
from torchlc.report.page import environment, meaning, origin, titled, titled_with_owner
from torchlc.results.fit_result import FitResult
from torchlc.stages.effect import first_sentence
from torchlc.stages.entry import Entry
from torchlc.version import __version__

MANY_ROWS = 30
"""Rows of a table beyond which it is folded."""
SECTIONS = ("curve", "object", "posterior", "chain")
"""Sections of the page that figures may close; other figures have sections of their own."""
GOOD_MATCH = 0.05
"""Known materials less probable than this are not named in words."""


def write_fit(
    result: FitResult,
    directory: OutputDirectory,
    progress: Callable[[str, float], None] | None = None,
    diagnosis: dict[str, Any] | None = None,
) -> None:
    """The numbers, the figures and report.html, in this order; what a run before left and this one does
    not write goes first: a file that is missing is noticed, one of another run is not.
    """
    written = FIT_FILES - (SAMPLED_FILES if result.posterior is None else frozenset())
    directory.clear(RESULT_FILES - written - (frozenset() if diagnosis is None else DIAGNOSIS_FILES))
    result.write_into(directory)
    drawn = draw_all("fit", result)
    for number, figure in enumerate(drawn):
        directory.write_bytes(f"{figure.kind.name}.png", png(figure))
        if progress is not None:
            progress("report", (number + 1) / (len(drawn) + 1))
    directory.write_text("report.html", render_fit(result, drawn, diagnosis))
    if progress is not None:
        progress("report", 1.0)


def render_fit(
    result: FitResult, drawn: Sequence[Drawn] | None = None, diagnosis: dict[str, Any] | None = None
) -> str:
    """The page of a fit; with ``diagnosis``, from :func:`~torchlc.report.diagnosis_page.context`, what it lacks as
    well.
    """
    drawn = draw_all("fit", result) if drawn is None else drawn
    return (
        environment()
        .get_template("fit.html")
        .render(
            version=__version__,
            title=f"{result.model.scene.name}: fit",
            name=result.model.scene.name,
            kicker=origin(result.recording),
            words=words(result),
            substances=substances(result),
            diagnosis=diagnosis,
            warnings=with_titles(result),
            rows=[_row(result, name, row) for name, row in result.parameters().items()],
            many=MANY_ROWS,
            matches=[(material, _match_words(matches)) for material, matches in result.materials().items()],
            viewer=viewer_data(result.model, result.view, result.prediction),
            chain_words=_chain_words(result),
            sampled=result.posterior is not None,
            pictures=by_section(result, drawn, SECTIONS),
            effects=[
                (f"{effect.name}: {effect.title}", first_sentence(type(effect)))
                for effect in _distinct_effects(result)
            ],
            facts=_facts(result),
            made={"inputs": {}, "versions": {}, "command": None, "seed": result.seed}
            | dict(result.provenance),
        )
    )


# ---------------------------------------------------------------------- words


def words(result: FitResult) -> list[str]:
    """What a reader should take home: how well it fits, and what is not determined."""
    silent = [
        titled_with_owner(free)
        for free in result.model.parameter_set.free
        if not result.insight.informed[free.name]
    ]
    if not silent:
        return [_quality(result)]
    return [
        _quality(result),
        f"Not determined by these data: {'; '.join(silent)}. What is quoted for "
        f"{'it' if len(silent) == 1 else 'them'} is what was assumed beforehand; the reasons are below.",
    ]


def with_titles(result: FitResult) -> list[str]:
    """The warnings, each parameter with what it is beside its name."""
    titles = {free.name: titled_with_owner(free) for free in result.model.parameter_set.free}
    if not titles:
        return result.all_warnings
    longest_first = "|".join(re.escape(name) for name in sorted(titles, key=len, reverse=True))
    named = re.compile(rf"(?<![\w.\[(])({longest_first})(?![\w\[])")
    return [named.sub(lambda match: titles[match[1]], text) for text in result.all_warnings]


def substances(result: FitResult) -> list[tuple[str, str]]:
    """Each material, with what the data say of it and what it is most like; then the other informed numbers."""
    informed, parameters = result.insight.informed, result.parameters()
    by_owner: dict[str, list[str]] = {}
    others: list[tuple[str, str]] = []
    for free in result.model.parameter_set.free:
        if not informed[free.name]:
            continue
        value = stated(parameters[free.name])
        if free.origin.role == "materials":
            by_owner.setdefault(free.origin.owner, []).append(f"{titled(free)} {value}")
        else:
            others.append((titled_with_owner(free), value))
    described = []
    matches = result.materials()
    for owner, values in by_owner.items():
        likely = [match for match in matches.get(owner, []) if match["probability"] >= GOOD_MATCH]
        like = f"; most like {_match_words(likely)}" if likely and likely[0]["name"] != OTHER else ""
        described.append((owner, ", ".join(values) + like))
    return [*described, *others]


def _quality(result: FitResult) -> str:
    recording, trust = result.recording, _trust(result)
    magnitudes = recording.kind == "mag"
    size = f"{result.rms_mag:.3f} mag" if magnitudes else f"{100 * result.rms_relative:.2g} % of the flux"
    if recording.error is None:
        judged = "the recording quotes no errors, so its noise was fitted and chi-square judges nothing"
    elif not (
        widening := [
            effect for effect in result.model.effects if isinstance(effect, NoiseKind) and effect.widens
        ]
    ):
        judged = f"chi-square is {against_freedom(result.fit.chi2, result.fit.dof, 0)}"
        verdict = "as the errors allow" if result.fit.p_value > 0.01 else "more than the errors allow"
        judged += f", {verdict}" if result.fit.dof > 0 else ": it judges nothing"
    elif {effect.name for effect in widening} <= {
        Entry.parse(entry).name for entry in result.model.scene.model.effects or ()
    }:
        judged = f"the scene's {' and '.join(effect.name for effect in widening)} is part of the errors"
    else:
        quoted = recording.error if magnitudes else 100 * recording.error / np.abs(recording.observed)
        return (
            f"The model does not fit: it is off by {size} (root mean square of {number_of(len(recording), 'row')}), where the "
            f"recording quotes errors of {np.median(quoted):.2g} {'mag' if magnitudes else '%'}. To go on, they were "
            f"widened by a {widening[-1].name}; torchlc diagnose looks for what the model lacks. {trust}"
        )
    return f"The model follows {number_of(len(recording), 'row')} to {size} (root mean square); {judged}. {trust}"


def _trust(result: FitResult) -> str:
    """Whether search and chain may be believed."""
    if result.posterior is None:
        return "Nothing was free, so nothing was sampled."
    if result.converged:
        return "Search and chain converged."
    worst = float(np.max(result.posterior.rhat))
    if result.fit.converged and worst <= GOOD_RHAT:  # unknown, and then not, of the shortest chains
        return f"The search converged; the chain is shorter than it should be, but its parts agree (R-hat up to {worst:.2f})."
    return f"The result is not final: {result.reason}."


def _match_words(matches: list[dict[str, Any]]) -> str:
    named = [match for match in matches if match["probability"] >= GOOD_MATCH][:4]
    return ", ".join(
        f"{'none of the library' if match['name'] == OTHER else match['name']} ({100 * match['probability']:.0f} %)"
        for match in named
    )


def _chain_words(result: FitResult) -> str:
    posterior = result.posterior
    if posterior is None:
        return ""
    return (
        f"{posterior.theta.shape[0]} walkers; {posterior.reason}. Acceptance {posterior.acceptance:.2f}; "
        f"{len(posterior.flat)} draws kept, one of {number_of(posterior.thin, 'step')} after {posterior.burn}."
    )


def _facts(result: FitResult) -> list[tuple[str, str]]:
    scene, recording = result.model.scene, result.recording
    orbit = (
        "TLE (SGP4)"
        if scene.orbit.tle or scene.orbit.tle_file
        else "ephemeris (OEM)"
        if scene.orbit.oem_file
        else "altitude, azimuth, height"
        if scene.orbit.altaz
        else "vectors of the recording"
    )
    return [
        ("orbit", orbit),
        ("attitude", scene.attitude.mode),
        ("facets", str(sum(len(part.faces) for part in result.model.assembly.shape.parts))),
        *([("rows dropped", counted(recording.dropped))] if recording.dropped else []),
        ("time taken", ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in result.seconds.items())),
    ]


def _distinct_effects(result: FitResult) -> list[Any]:
    return list({effect.name: effect for effect in result.model.effects}.values())


def _row(result: FitResult, name: str, row: dict[str, Any]) -> dict[str, Any]:
    """A parameter as the table shows it."""
    entry = next((free for free in result.model.parameter_set.free if free.name == name), None)
    return {
        "name": name,
        "title": None if entry is None else meaning(entry),
        "stated": stated(row),
        "interval": f"{plain_number(row['q05'], row['sd'])} to {plain_number(row['q95'], row['sd'])}",
        "best": plain_number(row["map"], row["sd"]),
        "informed": row["informed"],
        "bar": None if entry is None else prior_bar(entry, row["q05"], row["q95"]),
        "rhat": None if row["rhat"] is None else known(row["rhat"], 3),
        "ess": None if row["ess"] is None else known(row["ess"], 0),
    }


def known(value: float, places: int) -> str:
    """A number with so many decimal places; in words where a chain is too short to tell it."""
    return f"{value:.{places}f}" if math.isfinite(value) else "not known"


def plain_number(value: float, sd: float) -> str:
    """``value`` with the digits its uncertainty bears."""
    return rounded(value, 3) if abs(value) >= 1e5 or decimals(sd) > 8 else f"{value:.{decimals(sd)}f}"


def prior_bar(entry: Free, low: float, high: float) -> tuple[float, float] | None:
    """Start and length of [low, high] in % of the prior's range (of three sigma about its centre where it
    is peaked).
    """
    prior = entry.prior
    start, end = prior.low, prior.high
    if prior.kind in ("normal", "halfnormal"):
        start, end = max(start, prior.centre - 3 * prior.sigma), min(end, prior.centre + 3 * prior.sigma)
    elif prior.kind == "lognormal":
        start, end = (
            max(start, prior.centre * math.exp(-3 * prior.sigma)),
            min(end, prior.centre * math.exp(3 * prior.sigma)),
        )
    points = [start, end, low, high]
    if prior.logarithmic:
        if min(points) <= 0:
            return None
        points = [math.log(point) for point in points]
    start, end, low, high = points
    if not all(map(math.isfinite, points)) or end <= start:
        return None
    left, right = (min(max(100 * (x - start) / (end - start), 0.0), 100.0) for x in (low, high))
    return round(left, 1), round(right - left, 1)
