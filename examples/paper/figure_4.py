"""Figure 4: the four attitudes of the cube, drawn along inertial axes at 14 h UT."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from publish import Made, publish
from setting import cube

import torchlc
from torchlc.figures.style import DATA, INK, OBSERVER, PALETTE, SUN

HOUR = "2020-10-10T14:00:00"
TITLES = (
    "1: nadir, turning about Y at 1 rev/h",
    "2: Z to the pole, X at 30°",
    "3: Z to the Sun, turning about it",
    "4: nadir, X along the velocity",
)
FACES = [
    [(s if i == axis else a if i == (axis + 1) % 3 else b) for i in range(3)]
    for axis in range(3)
    for s in (-1, 1)
    for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
]
"""Corners of the cube's six faces, four rows a face."""


def pose(attitude: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Body axes as columns (3, 3), and the directions to Sun and Earth, along GCRS axes."""
    scene = cube(attitude=attitude)
    model = torchlc.LightCurve(
        scene, torchlc.simulate(scene, start=HOUR, hours=1.0, cadence=3600.0).recording
    )
    with torch.no_grad():
        view = model.view(model.values())
    state = view.state
    assert state.position is not None  # elements give it
    sun, position = (one[0, 0].numpy() for one in (state.sun, state.position))
    return view.rotation[0, 0].numpy(), sun / np.linalg.norm(sun), -position / np.linalg.norm(position)


def draw(axes: Axes3D, body: np.ndarray, sun: np.ndarray, earth: np.ndarray) -> None:
    corners = (0.38 * np.array(FACES) @ body.T).reshape(6, 4, 3)
    faces = Poly3DCollection(corners, facecolors="#dfe3e8", edgecolors=DATA, lw=0.8, alpha=0.75, zorder=0)
    axes.add_collection3d(faces)
    arrows = [(body[:, i], name, PALETTE[3 + i], 1.0) for i, name in enumerate("XYZ")]
    arrows += [(sun, "Sun", SUN, 1.5), (earth, "Earth", OBSERVER, 1.5)]
    arrows += [(np.array([0, 0, 1.0]), "pole", INK, 1.35)]
    for vector, name, colour, length in arrows:
        axes.quiver(0, 0, 0, *(length * vector), color=colour, lw=1.5, arrow_length_ratio=0.1, zorder=2)
        axes.text(*((length + 0.22) * vector), name, color=colour, ha="center", va="center", zorder=3)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-0.75, 1.25))
    axes.set_box_aspect((1, 1, 1), zoom=1.0)
    towards = sun + earth
    axes.view_init(elev=22, azim=float(np.degrees(np.arctan2(towards[1], towards[0]))) + 55)
    axes.set_axis_off()


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(7.2, 6.8))
    for attitude, title in enumerate(TITLES, 1):
        axes = figure.add_subplot(2, 2, attitude, projection="3d", computed_zorder=False)
        body, sun, earth = pose(attitude)
        draw(axes, body, sun, earth)
        axes.set_title(title, fontsize=9.5, y=1.0)
        angles = np.degrees(np.arccos(np.clip(np.stack([sun, earth]) @ body, -1, 1)))
        numbers[f"attitude_{attitude}"] = {
            "sun_to_axes_deg": angles[0].tolist(),
            "earth_to_axes_deg": angles[1].tolist(),
        }
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.95, wspace=0.0, hspace=0.08)
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
