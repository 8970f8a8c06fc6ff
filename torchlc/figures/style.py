"""How figures look: colours that hold on light and dark ground, and matplotlib's settings."""

from __future__ import annotations

from typing import Any

INK = "#16191d"
GRID = "#c9ced6"
DATA = "#7d8590"
MODEL = "#c2410c"
BEFORE = "#2f6fae"
MARK = "#e0b23c"
SUN = "#b87503"
OBSERVER = "#2374c6"
PALETTE = ("#2a7fb8", "#d9772b", "#3f9b5c", "#8a63b8", "#b8902a", "#c24d6f", "#3d9aa1", "#8c6d58")
"""Colours of components: told apart by the colour-blind, and on light and dark ground."""


def style(size: float = 10) -> Any:
    """matplotlib's settings of a figure with letters of ``size`` points."""
    return {
        "font.family": "sans-serif",
        "font.size": size,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "text.color": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "grid.color": GRID,
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "svg.fonttype": "none",
        "svg.hashsalt": "torchlc",
        "figure.facecolor": "none",
        "axes.facecolor": "none",
    }


def component_colour(index: int) -> str:
    return PALETTE[index % len(PALETTE)]


def plain(text: str) -> str:
    """A name as matplotlib should print it: no formula."""
    return text.replace("$", r"\$")
