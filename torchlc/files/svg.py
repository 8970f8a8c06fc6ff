"""Small drawings as SVG text, for what notebooks show of an object; no plotting library is loaded for them."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

WIDTH, HEIGHT, MARGIN = 420.0, 130.0, 8.0
MOST_DOTS = 600
"""Dots of a picture of this width: more lie on each other."""
INKS = ("#2a6fbb", "#d1732c", "#3a8f5c", "#8a5bb0", "#b03a48", "#5c6670")


def scatter(x: np.ndarray, y: np.ndarray, group: np.ndarray, label: str, *, upwards: bool = True) -> str:
    """Dots at x, y (N,), coloured by ``group`` (N,) of small integers; ``upwards``: larger values are higher."""
    known = np.isfinite(x) & np.isfinite(y)
    places = np.flatnonzero(known)
    places = places[:: max(1, -(-len(places) // MOST_DOTS))]
    if not len(places):
        return ""
    across = _spread(x[places], WIDTH)
    along = _spread(y[places] if not upwards else -y[places], HEIGHT)
    dots = [
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="1.6" fill="{INKS[int(k) % len(INKS)]}"/>'
        for a, b, k in zip(across, along, group[places], strict=True)
    ]
    return _svg(dots, label)


def polygons(shapes: Sequence[np.ndarray], group: Sequence[int], shade: Sequence[float], label: str) -> str:
    """Polygons, each (V, 2) with y upwards, drawn in order at one scale; ``shade`` 0 (dark) to 1 (bright)."""
    if not shapes:
        return ""
    corners = np.concatenate(list(shapes))
    low, high = corners.min(0), corners.max(0)
    scale = min(
        (WIDTH - 2 * MARGIN) / max(high[0] - low[0], 1e-9),
        (HEIGHT - 2 * MARGIN) / max(high[1] - low[1], 1e-9),
    )
    middle = (low + high) / 2
    drawn = []
    for shape, k, light in zip(shapes, group, shade, strict=True):
        placed = (shape - middle) * scale * np.array([1.0, -1.0]) + np.array([WIDTH, HEIGHT]) / 2
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in placed)
        drawn.append(
            f'<polygon points="{points}" fill="{INKS[k % len(INKS)]}" fill-opacity="{0.35 + 0.6 * light:.2f}" '
            'stroke="#44505c" stroke-width="0.6" stroke-linejoin="round"/>'
        )
    return _svg(drawn, label)


def _spread(values: np.ndarray, length: float) -> np.ndarray:
    low, span = values.min(), np.ptp(values)
    return MARGIN + (values - low) / (span if span > 0 else 1.0) * (length - 2 * MARGIN)


def _svg(content: Sequence[str], label: str) -> str:
    escaped = html.escape(label, quote=True)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" width="{WIDTH:g}" '
        f'height="{HEIGHT:g}" role="img" aria-label="{escaped}"><title>{escaped}</title>{"".join(content)}</svg>'
    )
