"""When a flat face mirrors the Sun to the observer, and how sure that is.

Letters: D draws, F flat facets, T rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from torchlc.inference.identifiability import bare_model
from torchlc.lightcurve.model import LightCurve
from torchlc.prediction.passes import Pass
from torchlc.shapes import Band, Dome
from torchlc.stages.light import Patch, View
from torchlc.tensors.vectors import unit

NEAR_WIDTHS = 2.0
"""Lobe widths from the mirror direction within which a face glints: the lobe is at exp(-2) of its top."""
SHARP_DEG = 5.0
"""Lobes wider than this make no glint, but a broad maximum."""
LEAST_PROBABILITY = 0.05
"""Below it a glint is not told: it would be waited for twenty times in vain."""
EDGE_ON = "the face turns edge-on"
MOST_GEOMETRIES = 24
"""Draws of which each has its own sizes and attitude, which are searched for glints one by one."""
MESH_FACETS = 200
"""Flat facets of one mesh beyond which its glints are not looked for."""


@dataclass(frozen=True)
class Glint:
    """A face's mirror direction passes the observer: ``seconds`` after the start of the span, the closest approach in
    ``degrees`` between the face's normal and the bisector of Sun and observer, with ``width_deg``, the lobe's width on
    the same scale. ``probability`` is the share of draws whose lobe is sharp and in which the bisector comes
    within NEAR_WIDTHS widths. All else is the median over these draws: a draw with a wide lobe says nothing of a glint.
    ``time_sd_s`` holds the draws and the error of the elements; ``duration_s`` the time within. ``edge`` says, where the angle
    has no turning point, what cuts its fall or rise: the pass, the umbra, the face turning away.
    """

    component: str
    face: str
    seconds: float
    time_sd_s: float
    degrees: float
    width_deg: float
    duration_s: float
    probability: float
    edge: str = ""


def facet_angles(model: LightCurve, theta: Tensor) -> tuple[list[tuple[str, str, str]], np.ndarray, bool]:
    """Component, face and material of every flat facet, and the angle (D, F, T), deg, between its normal and the bisector of
    Sun and observer; infinite where it is not turned to both. D is 1 where all draws theta (D, P) share one
    geometry. And whether a mesh was passed over.
    """
    bare = bare_model(model)
    draws = theta[:MOST_GEOMETRIES] if model.geometry_free else theta[:1]
    names: list[tuple[str, str, str]] = []
    angles, passed_over = [], False
    with torch.no_grad():
        for one in draws:
            view = bare.view(model.values(one))
            flat = [patch for patch in view.patches if not isinstance(patch.surface, Band | Dome)]
            small = [patch for patch in flat if len(patch.faces) <= MESH_FACETS]
            passed_over = len(small) < len(flat)
            names = [(p.component, face, p.material) for p in small for face in p.faces]
            angles.append(torch.cat([_angles(view, patch) for patch in small]).numpy() if small else None)
    kept = [one for one in angles if one is not None]
    rows = len(model.recording)
    return names, np.stack(kept) if kept else np.zeros((1, 0, rows)), passed_over


def _angles(view: View, patch: Patch) -> Tensor:
    """(F, T), deg, of one patch."""
    normal = patch.normal if patch.normal.ndim == 2 else patch.normal[0]
    turned = normal[:, None] if patch.pose is None else torch.einsum("tij,fj->fti", patch.pose[0], normal)
    sun, observer = view.to_sun[0], view.to_observer[0]
    bisector = unit(sun + observer)
    facing = torch.minimum((turned * sun).sum(-1), (turned * observer).sum(-1)) > 0
    across = torch.linalg.cross(turned.expand(-1, len(sun), 3), bisector.expand(len(normal), -1, -1))
    angle = torch.atan2(torch.linalg.vector_norm(across, dim=-1), (turned * bisector).sum(-1))
    return torch.where(facing, torch.rad2deg(angle), math.inf)


def lobe_widths_deg(model: LightCurve, theta: Tensor, material: str) -> np.ndarray | None:
    """Angle (D,), deg, from the top of a material's lobe at which it has fallen to exp(-1/2), on the scale of the normal's
    tilt: 1/sqrt(n) for cos^n, half of it about the mirror direction, which moves twice as fast as the normal, m/sqrt(2) or
    alpha/2 for a distribution of slopes; None without a lobe. Numbers apart along u and v count by those of the wider axis.
    """
    a = model.assembly
    brdf = a.models[material]
    own = a.material_values(material, brdf, model.values(theta))
    along = brdf.along_axes
    alike = [dict.fromkeys(along, own[other]) for other in along] or [{}]
    widest = torch.stack(
        [brdf.lobe_variance({**own, **numbers}).expand(len(theta)) for numbers in alike]
    ).amax(0)
    if not bool(torch.isfinite(widest).any()):
        return None
    return torch.rad2deg(widest.sqrt()).detach().numpy()


@dataclass(frozen=True)
class Run:
    """Rows one after the other in sunlight, and what happens before the first and after the last."""

    rows: slice
    begins: str
    ends: str


def lit_runs(path: Pass, seconds: np.ndarray) -> list[Run]:
    """Runs of the lit rows of a pass, at ``seconds`` (T,): the umbra parts them, even where it is shorter than a step."""
    lit = np.flatnonzero(path.lit)
    crossings = [at for at, word in path.events if word in ("enters umbra", "leaves umbra")]
    crossed = np.searchsorted(np.sort(crossings), seconds)
    breaks = np.flatnonzero((np.diff(lit) > 1) | (np.diff(crossed) > 0)) + 1
    last = len(path.index) - 1
    return [
        Run(
            slice(start, stop),
            _in_words(path.begins) if lit[start] == 0 else "it leaves the umbra",
            _in_words(path.ends) if lit[stop - 1] == last else "it enters the umbra",
        )
        for start, stop in pairwise([0, *breaks.tolist(), len(lit)])
        if stop > start
    ]


def _in_words(edge: str) -> str:
    """An edge of a pass as a clause: "rises" and "sets" lack their subject."""
    return edge if " " in edge else f"it {edge}"


def find_glints(
    names: list[tuple[str, str, str]],
    angles: np.ndarray,
    widths: dict[str, np.ndarray | None],
    seconds: np.ndarray,
    runs: Sequence[Run],
    orbit_sd_s: float,
) -> list[Glint]:
    """Glints of one pass: ``angles`` (D or 1, F, T) at its lit rows, ``seconds`` (T,); ``widths`` (D,) by material;
    ``runs`` of rows, since nothing passes from one to the next; ``orbit_sd_s``, how far off in time the elements may be."""
    found = []
    for f, (component, face, material) in enumerate(names):
        width = widths[material]
        if width is None:
            continue
        own = angles[:, f]
        if len(own) > 1:  # one geometry for all draws, or one each
            width = width[: len(own)]
        sharp = width <= SHARP_DEG
        if np.mean(sharp) < LEAST_PROBABILITY:
            continue
        reach = np.where(sharp, NEAR_WIDTHS * width, -math.inf)
        for run in runs:
            for piece in _pieces(own[:, run.rows], float(reach.max())):
                closest = [_closest(seconds[run.rows], one[run.rows], piece, run) for one in own]
                when, near, edges = (np.array(values) for values in zip(*closest, strict=True))
                for edge in np.unique(edges):
                    counted = (near < reach) & (edges == edge)
                    probability = float(np.mean(counted))
                    if probability < LEAST_PROBABILITY:
                        continue
                    kept = counted if len(own) > 1 else slice(None)
                    curves = own[kept, run.rows][:, piece]
                    limits = reach[counted] if len(own) > 1 else [np.median(reach[counted])]
                    times = [
                        _duration(seconds[run.rows][piece], one, float(limit))
                        for one, limit in zip(curves, limits, strict=True)
                    ]
                    found.append(
                        Glint(
                            component=component,
                            face=face,
                            seconds=float(np.median(when[kept])),
                            time_sd_s=math.hypot(float(np.std(when[kept])), orbit_sd_s),
                            degrees=float(np.median(near[kept])),
                            width_deg=float(np.median(width[counted])),
                            duration_s=float(np.median(times)),
                            probability=probability,
                            edge=str(edge),
                        )
                    )
    return sorted(found, key=lambda one: one.seconds)


def _pieces(angles: np.ndarray, limit: float) -> Iterator[slice]:
    """Rows about each smallest angle (1, T) below ``limit``, from one largest angle to the next; all rows together where
    draws have geometries of their own (D, T)."""
    if len(angles) > 1:
        if angles.min() < limit:
            yield slice(0, angles.shape[1])
        return
    (angle,) = angles
    above = np.minimum(angle, 360.0)
    ends = np.flatnonzero((above[1:-1] >= above[:-2]) & (above[1:-1] > above[2:])) + 1
    for start, stop in pairwise([0, *ends.tolist(), len(angle)]):
        piece = slice(start, min(stop + 1, len(angle)))
        if angle[piece].min() < limit:
            yield piece


def _closest(seconds: np.ndarray, angle: np.ndarray, piece: slice, run: Run) -> tuple[float, float, str]:
    """When an angle (T,) of a run is smallest in a piece of it, and how small, by the parabola of its square about the
    smallest row; and, in words, the edge at which it is smallest and that ends it, if it has no turning point."""
    k = piece.start + int(np.argmin(angle[piece]))
    if not np.isfinite(angle[k]):
        return math.nan, math.inf, ""
    if not 0 < k < len(angle) - 1:
        return float(seconds[k]), float(angle[k]), run.ends if k else run.begins
    if not np.isfinite(angle[[k - 1, k + 1]]).all():
        return float(seconds[k]), float(angle[k]), EDGE_ON
    moved, near, _ = _turning(seconds[k - 1 : k + 2], angle[k - 1 : k + 2])
    return float(seconds[k] + moved), near, ""


def _turning(seconds: np.ndarray, angle: np.ndarray) -> tuple[float, float, float]:
    """By the parabola of the squares of three angles: how long after the middle row they are smallest, how small they
    are then, and the parabola's bend. No further than the outer rows."""
    y = angle**2
    slope, bend = np.polynomial.polynomial.polyfit(seconds - seconds[1], y, 2)[1:]
    if bend <= 0:
        return 0.0, float(angle[1]), float(bend)
    moved = float(np.clip(-slope / (2 * bend), seconds[0] - seconds[1], seconds[2] - seconds[1]))
    return moved, math.sqrt(max(y[1] + slope * moved + bend * moved**2, 0.0)), float(bend)


def _duration(seconds: np.ndarray, angle: np.ndarray, limit: float) -> float:
    """Time, s, that an angle (T,) stays below a limit about its smallest row: by straight lines between rows, or by the
    parabola of :func:`_closest` where that is below and no row is."""
    k = int(np.argmin(angle))
    if angle[k] < limit:
        times = []
        for step in (-1, 1):
            place = k
            while 0 <= place + step < len(angle) and angle[place + step] < limit:
                place += step
            beyond = place + step
            moved = seconds[place]
            if 0 <= beyond < len(angle) and np.isfinite(angle[beyond]):
                share = (limit - angle[place]) / (angle[beyond] - angle[place])
                moved = moved + share * (seconds[beyond] - seconds[place])
            times.append(float(moved))
        return times[1] - times[0]
    if not (0 < k < len(angle) - 1 and np.isfinite(angle[k - 1 : k + 2]).all()):
        return 0.0
    _, least, bend = _turning(seconds[k - 1 : k + 2], angle[k - 1 : k + 2])
    return 2 * math.sqrt((limit**2 - least**2) / bend) if least < limit and bend > 0 else 0.0
