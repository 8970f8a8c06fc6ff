"""What a fit leaves in its directory, and report.html: one file with its figures, its words and its numbers
inside.
"""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from torchlc.figures import posterior as figures
from torchlc.figures import style
from torchlc.figures.curves import MOST_PANELS, curve_size, draw_curves, stretches
from torchlc.figures.viewer import viewer_data
from torchlc.files.writing import DIAGNOSIS_FILES, FIT_FILES, RESULT_FILES, SAMPLED_FILES, OutputDirectory
from torchlc.inference.sampler import GOOD_RHAT
from torchlc.materials.known import OTHER
from torchlc.parameters import Free
from torchlc.readers import Recording, counted
from torchlc.report.listing import first_sentence
from torchlc.results.fit_result import FitResult, decimals, rounded, stated
from torchlc.results.simulated_curve import iso_times
from torchlc.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"
INKS = {
    style.INK: "--ink",
    style.GRID: "--grid",
    style.DATA: "--data",
    style.MODEL: "--model",
    style.BEFORE: "--before",
    style.SUN: "--sun",
    style.OBSERVER: "--observer",
}
"""Colours of the figures that follow the page's light or dark dress."""
PNG_DPI = 130
MANY_ROWS = 30
"""Rows of a table beyond which it is folded."""
GOOD_MATCH = 0.05
"""Known materials less probable than this are not named in words."""


def write_fit(
    result: FitResult,
    directory: OutputDirectory,
    progress: Callable[[str, float], None] | None = None,
    diagnosis: dict[str, Any] | None = None,
) -> None:
    """fit.json, posterior.nc, the figures and report.html, in this order; what a run before left and this one does
    not write goes first: a file that is missing is noticed, one of another run is not.
    """
    written = FIT_FILES - (SAMPLED_FILES if result.posterior is None else frozenset())
    directory.clear(RESULT_FILES - written - (frozenset() if diagnosis is None else DIAGNOSIS_FILES))
    directory.write_json("fit.json", result.to_json())
    if result.posterior is not None:
        data = result.to_arviz()
        directory.write("posterior.nc", lambda path: data.to_netcdf(str(path), engine="h5netcdf"))
    drawn = fit_figures(result)
    for number, (name, figure) in enumerate(drawn.items()):
        directory.write_bytes(f"{name}.png", png(figure))
        if progress is not None:
            progress("report", (number + 1) / (len(drawn) + 1))
    directory.write_text("report.html", render_fit(result, drawn, diagnosis))
    if progress is not None:
        progress("report", 1.0)


def fit_figures(result: FitResult) -> dict[str, Figure]:
    """The figures of a fit by the name of their file."""
    drawn = {
        "curve": Figure(figsize=curve_size(result.recording)),
        "shares": Figure(figsize=(8.2, 2.8)),
        "object": Figure(figsize=(5.6, 5.0)),
    }
    draw_curves(result.comparison, drawn["curve"])
    figures.shares(result, figure=drawn["shares"])
    result.plot_object(axes=drawn["object"].subplots())
    if result.posterior is not None:
        side = 1.2 + 1.35 * len(figures.corner_names(result))
        drawn["corner"] = figures.corner_plot(result, Figure(figsize=(side, side)))
        bands = -(-min(len(result.names), figures.MOST_TRACES) // 2)
        drawn["traces"] = figures.traces(result, Figure(figsize=(8.2, 0.6 + 1.2 * bands)))
    return drawn


def png(figure: Figure) -> bytes:
    """A figure on white ground."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=PNG_DPI, bbox_inches="tight", facecolor="white")
    return stream.getvalue()


def svg(figure: Figure, alt: str, name: str = "") -> str:
    """A figure as an SVG element in the page's colours, for a reader and for a screen reader."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", bbox_inches="tight", transparent=True, dpi=PNG_DPI)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*_\d+">', "<g>", text)
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    for colour, ink in INKS.items():
        text = text.replace(colour, f"var({ink})")
    label = f'<svg role="img" aria-label="{html.escape(alt, quote=True)}"' + (
        f' class="{name}"' if name else ""
    )
    return text.replace("<svg", label, 1)


def markup(figure: Figure, alt: str, *, square: bool = False) -> Any:
    """A figure as SVG that the template does not escape: ours, with names escaped by matplotlib."""
    from markupsafe import Markup

    return Markup(svg(figure, alt, "square" if square else ""))


def render_fit(
    result: FitResult, drawn: dict[str, Figure] | None = None, diagnosis: dict[str, Any] | None = None
) -> str:
    """The page of a fit; with ``diagnosis``, from :func:`~torchlc.report.diagnosis_page.context`, what it lacks as
    well.
    """
    drawn = fit_figures(result) if drawn is None else drawn
    alts = _alts(result)
    pictures = {
        key: markup(figure, alts[key], square=key == "corner")
        for key, figure in drawn.items()
        if key != "object"
    }
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
            warnings=result.all_warnings,
            rows=[_row(result, name, row) for name, row in result.parameters().items()],
            many=MANY_ROWS,
            matches=[(material, _match_words(found)) for material, found in result.materials().items()],
            viewer=viewer_data(result.model, result.view, result.prediction),
            chain_words=_chain_words(result),
            curve_alt=alts["curve"],
            curve_caption=_curve_caption(result),
            several=len(result.model.assembly.components) > 1,
            shares_alt=alts["shares"],
            corner_alt=alts.get("corner"),
            corner_caption=_corner_caption(result),
            effects=[(one.name, first_sentence(type(one))) for one in _distinct_effects(result)],
            facts=_facts(result),
            made={"inputs": {}, "versions": {}, "command": None, "seed": result.seed}
            | dict(result.provenance),
            **{"corner": None, "traces": None} | pictures,
        )
    )


@cache
def environment() -> Environment:
    """Every value that reaches a page is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )


# ---------------------------------------------------------------------- words


def words(result: FitResult) -> list[str]:
    """What a reader should take home: how well it fits, and what is not determined."""
    silent = [name for name in result.names if not result.insight.informed[name]]
    if not silent:
        return [_quality(result)]
    return [
        _quality(result),
        f"Not determined by these data: {', '.join(silent)}. What is quoted for "
        f"{'it' if len(silent) == 1 else 'them'} is what was assumed beforehand; the reasons are below.",
    ]


def substances(result: FitResult) -> list[tuple[str, str]]:
    """Each material, with what the data say of it and what it is most like; then the other informed numbers."""
    informed, parameters = result.insight.informed, result.parameters()
    by_owner: dict[str, list[str]] = {}
    by_name: dict[str, str] = {}
    for free in result.model.parameter_set.free:
        if not informed[free.name]:
            continue
        value = stated(parameters[free.name])
        if free.origin.role == "materials":
            by_owner.setdefault(free.origin.owner, []).append(f"{free.origin.quantity} = {value}")
        else:
            by_name[free.name] = value
    found = []
    matches = result.materials()
    for owner, values in by_owner.items():
        likely = [one for one in matches.get(owner, []) if one["probability"] >= GOOD_MATCH]
        like = f"; most like {_match_words(likely)}" if likely and likely[0]["name"] != OTHER else ""
        found.append((owner, ", ".join(values) + like))
    return [*found, *by_name.items()]


def _quality(result: FitResult) -> str:
    recording, trust = result.recording, _trust(result)
    magnitudes = recording.kind == "mag"
    size = f"{result.rms_mag:.3f} mag" if magnitudes else f"{100 * result.rms_relative:.2g} % of the flux"
    if recording.error is None:
        judged = "the recording quotes no errors, so its noise was fitted and chi-square judges nothing"
    elif "jitter" not in {effect.name for effect in result.model.effects}:
        judged = f"chi-square is {result.fit.chi2:.0f} for {result.fit.dof} degrees of freedom"
        judged += ", as the errors allow" if result.fit.p_value > 0.01 else ", more than the errors allow"
    elif "jitter" in (result.model.scene.model.effects or ()):
        judged = "the scene's jitter is part of the errors"
    else:
        quoted = recording.error if magnitudes else 100 * recording.error / np.abs(recording.observed)
        return (
            f"The model does not fit: it is off by {size} (root mean square of {len(recording)} rows), where the "
            f"recording quotes errors of {np.median(quoted):.2g} {'mag' if magnitudes else '%'}. To go on, they were "
            f"widened by a jitter; torchlc diagnose looks for what the model lacks. {trust}"
        )
    return f"The model follows {len(recording)} rows to {size} (root mean square); {judged}. {trust}"


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


def _match_words(found: list[dict[str, Any]]) -> str:
    named = [one for one in found if one["probability"] >= GOOD_MATCH][:4]
    return ", ".join(
        f"{'none of the library' if one['name'] == OTHER else one['name']} ({100 * one['probability']:.0f} %)"
        for one in named
    )


def origin(recording: Recording) -> str:
    """File, rows, times and stations of a recording in one line."""
    times = iso_times(recording)
    first, last = (text[:16].replace("T", " ") for text in (times[0], times[-1]))
    places = ", ".join(recording.station_ids[i] for i in np.unique(recording.station))
    nights = len(recording.night_ids)
    source = recording.source.name if recording.source is not None else "a recording"
    return (
        f"{source}: {len(recording)} rows, {first} to {last} {recording.time.scale.upper()}"
        + (f", {nights} nights" if nights > 1 else "")
        + (f", from {places}" if places != "unknown" else "")
    )


def _chain_words(result: FitResult) -> str:
    posterior = result.posterior
    if posterior is None:
        return ""
    return (
        f"{posterior.theta.shape[0]} walkers; {posterior.reason}. Acceptance {posterior.acceptance:.2f}; "
        f"{len(posterior.flat)} draws kept, one of {posterior.thin} steps after {posterior.burn}."
    )


def _curve_caption(result: FitResult) -> str:
    total = len(stretches(result.recording))
    more = f" The first {MOST_PANELS} of {total} are drawn." if total > MOST_PANELS else ""
    band = " with the 90 % band of the posterior" if result.posterior is not None else ""
    return f"Recording (dots) and model (line){band}; below, what is left.{more}"


def _corner_caption(result: FitResult) -> str:
    drawn = len(figures.corner_names(result)) if result.posterior is not None else 0
    more = (
        f" {drawn} of {len(result.names)} parameters, those that the data inform first."
        if drawn < len(result.names)
        else ""
    )
    return f"Contours hold 39 and 86 % of the posterior: 1 and 2 sigma in two dimensions.{more}"


def _alts(result: FitResult) -> dict[str, str]:
    recording = result.recording
    low, high = np.nanmin(recording.observed), np.nanmax(recording.observed)
    unit = "magnitudes" if recording.kind == "mag" else "relative fluxes"
    means = ", ".join(f"{name} {100 * one['mean_share']:.0f} %" for name, one in result.mean_shares().items())
    return {
        "curve": f"Light curve: {len(recording)} rows, {unit} from {low:.4g} to {high:.4g}, the model "
        "over them, residuals below.",
        "shares": f"Shares of the light along the recording; on average {means}.",
        "corner": f"Corner plot of the posterior of {', '.join(figures.corner_names(result))}.",
        "traces": "Traces of all walkers after burn-in, one panel a parameter.",
        "object": "The object at its brightest.",
    }


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
    entry = next((one for one in result.model.parameter_set.free if one.name == name), None)
    return {
        "name": name,
        "stated": stated(row),
        "interval": f"{plain_number(row['q05'], row['sd'])} to {plain_number(row['q95'], row['sd'])}",
        "best": plain_number(row["map"], row["sd"]),
        "informed": row["informed"],
        "bar": None if entry is None else prior_bar(entry, row["q05"], row["q95"]),
        "rhat": None if row["rhat"] is None else f"{row['rhat']:.3f}",
        "ess": None if row["ess"] is None else f"{row['ess']:.0f}",
    }


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
