"""Figure 1: one facet, the directions to Sun and observer, and their bisector, which the paper leaves undefined."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from publish import Made, publish

from torchlc.figures.style import DATA, INK, MODEL, OBSERVER, SUN

SUN_DEG = (48.0, 215.0)
OBSERVER_DEG = (32.0, 10.0)
"""Polar angle and azimuth in the facet's frame (u, v, n)."""


def direction(polar_deg: float, azimuth_deg: float) -> np.ndarray:
    polar, azimuth = np.radians((polar_deg, azimuth_deg))
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def make() -> Made:
    sun, observer = direction(*SUN_DEG), direction(*OBSERVER_DEG)
    half = (sun + observer) / np.linalg.norm(sun + observer)
    figure = Figure(figsize=(5.2, 4.2))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.62
    axes.add_collection3d(Poly3DCollection([np.c_[corners, np.zeros(4)]], fc="#dfe3e8", ec=DATA, zorder=0))
    arrows = (
        (np.array([1.0, 0, 0]), "u$_u$", INK),
        (np.array([0, 1.0, 0]), "u$_v$", INK),
        (np.array([0, 0, 1.0]), "u$_n$", INK),
        (sun, "u$_{sun}$", SUN),
        (observer, "u$_{obs}$", OBSERVER),
        (half, "u$_h$", MODEL),
    )
    for vector, name, colour in arrows:
        axes.quiver(0, 0, 0, *vector, color=colour, lw=1.8, arrow_length_ratio=0.08, zorder=3)
        axes.text(*(1.09 * vector), name, color=colour, fontsize=12, ha="center", va="center", zorder=4)
    for one in (sun, observer):
        turn = np.linspace(0.0, 1.0, 30)[:, None]
        arc = (1 - turn) * one + turn * half
        axes.plot(*(0.45 * arc / np.linalg.norm(arc, axis=1, keepdims=True)).T, color=MODEL, lw=1.0, zorder=2)
    axes.set(xlim=(-0.7, 0.7), ylim=(-0.7, 0.7), zlim=(0.0, 1.05))
    axes.set_box_aspect((1.4, 1.4, 1.05), zoom=1.15)
    axes.view_init(elev=22, azim=-68)
    axes.set_axis_off()
    degrees = np.degrees(np.arccos([sun @ observer, half @ sun, half @ observer]))
    return dict(zip(("phase_deg", "half_to_sun_deg", "half_to_observer_deg"), degrees, strict=True)), figure


if __name__ == "__main__":
    publish(__file__, make)
