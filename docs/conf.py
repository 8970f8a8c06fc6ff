"""Sphinx: pages in MyST Markdown, the public names from their docstrings, the effects from their registry."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

import torchlc
from torchlc.diagnosis import (
    clock,
    counts,
    discrepancy,
    engine,
    fits,
    gate,
    growth,
    hypotheses,
    probes,
    promises,
    proof,
    run,
    standing,
    where,
)
from torchlc.diagnosis import probabilities as odds
from torchlc.diagnosis.unseen import SURE, UNSEEN
from torchlc.inference import density, posterior
from torchlc.noise.red_noise import RedNoise

HERE = Path(__file__).parent
sys.path += [str(HERE / folder) for folder in ("", "calibration", "evidence", "how_to")]

from addition_tables import addition_tables  # noqa: E402
from benchmark_tables import evidence_of_the_benchmark  # noqa: E402
from calibration_tables import calibration_of_the_posterior, calibration_of_the_verdict  # noqa: E402
from hostile_file_tables import hostile_files  # noqa: E402
from overview import tables  # noqa: E402
from page_lists import page_lists  # noqa: E402
from peak_tables import evidence_of_the_peak  # noqa: E402
from tumbling_tables import tumbling_tables  # noqa: E402

project = "torchlc"
author = "the torchlc authors"
project_copyright = "2026, the torchlc authors"
version = release = torchlc.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "deflist"]
myst_substitutions = {
    "blocks": proof.BLOCKS,
    "runs": proof.RUNS,
    "longest": posterior.LONGEST,
    "clean_p": f"{standing.CLEAN_P:g}",
    "dear": f"{promises.DEAR_FIT_S:g}",
    "slow_fit": f"{promises.SLOW_FIT_S:g}",
    "again": str(probes.AGAIN),
    "grown": str(growth.GROWN),
    "material_starts": str(fits.STARTS),
    "as_likely": f"{100 * counts.AS_LIKELY:g}",
    "linear_near": f"{promises.LINEAR_NEAR:g}",
    "slow_ms": f"{1000 * density.DEAR_S:g}",
    "draws": gate.DRAWS,
    "draws_z": engine.DRAWS,
    "family": f"{100 * odds.FAMILY_SHARE:g} %",
    "law_odds": f"{hypotheses.LAW_ODDS:g}",
    "sizes_odds": f"{hypotheses.SIZES_ODDS:g}",
    "together_odds": f"{hypotheses.NOISE_ODDS * RedNoise.prior_odds:g}",
    "least_taken": f"{100 * odds.LEAST_TAKEN:g} %",
    "unseen": f"{UNSEEN:g}",
    "sure": f"{SURE:g}",
    "told": f"{odds.TOLD:g}",
    "near": f"{promises.NEAR:g}",
    "noise_odds": f"{hypotheses.NOISE_ODDS:g}",
    "odd_odds": f"{discrepancy.ODDS:g}",
    "far": f"{discrepancy.FAR:g}",
    "refitted": str(discrepancy.REFITTED),
    "quick_s": f"{run.QUICK_S:g}",
    "most_s": f"{clock.MOST_S:g}",
    "reach": f"{fits.REACH:g}",
    "few_effects": hypotheses.FEW_EFFECTS,
    "alone_s": f"{run.MOST_ALONE_S:g}",
    "scale_sigma": f"{density.SCALE_SIGMA:g}",
    "seen_sigma": f"{where.SEEN_SIGMA:g}",
    "unknown_odds": f"{odds.UNKNOWN_ODDS:g}",
    "wide_mag": f"{posterior.WIDE_MAG:g}",
}
"""The numbers of the verdict, as the code has them; fill_numbers.py writes them into the pages."""


myst_substitutions |= hostile_files() | page_lists() | addition_tables()
myst_substitutions |= calibration_of_the_posterior() | calibration_of_the_verdict()
myst_substitutions |= evidence_of_the_benchmark() | evidence_of_the_peak() | tables() | tumbling_tables()
myst_heading_anchors = 3
exclude_patterns = ["_build"]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_typehints_description_target = "documented_params"
html_theme = "furo"
html_title = f"torchlc {version}"

HIDDEN = re.compile(r"<!--(toctree|eval-rst)\n(.*?)-->", re.DOTALL)
BOLD = re.compile(r'<mi mathvariant="bold">([a-z])</mi>')


def write_formula(page: Any, node: nodes.math | nodes.math_block) -> None:
    """As MathML, which a browser shows by itself, offline; bold letters as characters of their own, as browsers
    want them."""
    block = isinstance(node, nodes.math_block)
    formula = convert(node.astext(), display="block" if block else "inline")
    formula = BOLD.sub(lambda letter: f"<mi>{chr(ord('𝐚') + ord(letter[1]) - ord('a'))}</mi>", formula)
    page.body.append(f'<div style="padding: 0.6em 0">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def directives(app: Any, page: str, source: list[str]) -> None:
    """What only a site shows stands in a page as a comment, which a reader of the repository does not see."""
    source[0] = HIDDEN.sub(r"```{\1}\n\2```", source[0])


def setup(app: Any) -> None:
    app.connect("source-read", directives)
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
