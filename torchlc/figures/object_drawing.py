"""The object at one row, drawn in its body frame with the Sun on it."""

from __future__ import annotations

import matplotlib
import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from torchlc.figures.raster import Mesh, fan, looking_along, render
from torchlc.figures.style import INK, OBSERVER, PALETTE, SUN, component_colour, plain, style
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording, iso_times
from torchlc.stages.light import View


def posed_mesh(model: LightCurve, view: View, row: int) -> Mesh:
    """The object at one row in the body frame, coloured by component."""
    triangles, colours = [], []
    for number, (part, facets) in enumerate(zip(model.assembly.shape.parts, view.facets, strict=True)):
        pieces, _ = fan(facets.vertices.numpy())
        pose = view.poses[number]
        if pose is not None:
            pieces = (pieces - part.pivot) @ pose[0, row].numpy().T + part.pivot
        triangles.append(pieces)
        colours.append(np.tile(matplotlib.colors.to_rgb(component_colour(number)), (len(pieces), 1)))
    return Mesh(np.concatenate(triangles), np.concatenate(colours))


def good_camera(to_sun: np.ndarray, to_observer: np.ndarray) -> np.ndarray:
    """A frame for :func:`~torchlc.figures.raster.render` that shows the lit side and both directions from aside."""
    middle = to_sun + to_observer
    middle = middle / np.linalg.norm(middle) if np.linalg.norm(middle) > 1e-3 else to_sun
    up = np.eye(3)[np.argmin(np.abs(middle))]
    aside = np.cross(up, middle)
    return looking_along(middle + 0.55 * aside / np.linalg.norm(aside) + 0.4 * up, up)


def draw_object(model: LightCurve, view: View, row: int, axes: Axes) -> Axes:
    """The object in its body frame at ``row``, lit by the Sun, with arrows to Sun and observer."""
    mesh = posed_mesh(model, view, row)
    to_sun, to_observer = (vector[0, row].numpy() for vector in (view.to_sun, view.to_observer))
    camera = good_camera(to_sun, to_observer)
    span = 2.7 * mesh.radius
    extent = (-span / 2, span / 2, -span / 2, span / 2)
    with matplotlib.rc_context(style()):
        axes.imshow(render(mesh, camera, to_sun, 700, span), extent=extent, zorder=2)
        for direction, colour, name in ((to_sun, SUN, "Sun"), (to_observer, OBSERVER, "observer")):
            x, y, towards = camera @ direction
            start, tip = ((share * span * x, share * span * y) for share in (0.12, 0.45))
            arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.0}
            axes.annotate("", tip, start, zorder=3 if towards > 0 else 1, arrowprops=arrow)
            axes.annotate(name, tip, (4, 4), textcoords="offset points", color=colour, zorder=4)
        _triad(axes, camera, span)
        parts = model.assembly.shape.parts[: len(PALETTE)]
        handles = [Patch(color=component_colour(k), label=plain(part.name)) for k, part in enumerate(parts)]
        axes.legend(handles=handles, loc="lower right", fontsize=8)
        when = iso_times(model.recording)[row][:19].replace("T", " ")
        axes.set_title(f"{when} {model.recording.time.scale.upper()}", fontsize=9)
        axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
        axes.axis("off")
    return axes


def _triad(axes: Axes, camera: np.ndarray, span: float) -> None:
    """The body axes in the corner."""
    corner = np.array([-0.4, -0.4]) * span
    for axis, name in zip(np.eye(3), "XYZ", strict=True):
        tip = corner + 0.07 * span * (camera @ axis)[:2]
        axes.plot([corner[0], tip[0]], [corner[1], tip[1]], color=INK, lw=1.2)
        x, y = corner + 1.35 * (tip - corner)
        axes.text(x, y, name, fontsize=8, ha="center", va="center")


def levelled(recording: Recording, values: np.ndarray) -> np.ndarray:
    """Magnitudes as they are; relative flux (T,) over the mean of its curve, so that curves compare."""
    if recording.kind == "mag":
        return values
    count = len(recording.curve_ids)
    mean = np.bincount(recording.curve, recording.observed, count) / np.bincount(
        recording.curve, minlength=count
    )
    return values / mean[recording.curve]


def brightest(recording: Recording, prediction: np.ndarray) -> int:
    """The row in which a model is brightest, in its curve where the scale of curves is their own."""
    values = levelled(recording, prediction)
    values = -values if recording.kind == "mag" else values
    return int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))
