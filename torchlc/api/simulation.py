"""The verbs of what a scene shows: its light curve, and what of it is lit and seen."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from torchlc.api.inputs import Columns, Moment, Rows, amount, grid_or, read_scene
from torchlc.errors import InputError, option
from torchlc.readers.column_limits import LIMITS
from torchlc.results.simulated_curve import SimulatedCurve, simulated_curve
from torchlc.scene import Scene
from torchlc.tensors.moving import on_cpu

if TYPE_CHECKING:
    from torchlc.prediction.visibility import Visibility


@on_cpu
def simulate(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    start: Moment | None = None,
    hours: float | None = None,
    cadence: float | None = None,
    noise: float | None = None,
    seed: int = 0,
    columns: Columns = None,
    trust: bool = False,
) -> SimulatedCurve:
    """The light curve of a scene at a recording's rows, or for ``hours`` from ``start`` (ISO UTC or JD)
    every ``cadence`` seconds.

    Free numbers have their scene's values. ``noise`` (mag) makes a recording of it: normal errors, quoted,
    and on top what noise effects of the scene say (jitter, say), unquoted.
    """
    scene = read_scene(scene, trust)
    rows = grid_or(scene, recording, start, hours, cadence, columns)
    noise = amount(noise, "mag", "noise")
    low, high = LIMITS["mag_err"]
    if noise is not None and not low <= noise <= high:
        raise InputError(None, option("noise"), f"{noise:g} mag", f"> 0: {low:g} to {high:g} mag")
    return simulated_curve(scene, rows, noise, seed)


@on_cpu
def visibility(
    scene: str | Path | Scene,
    recording: Rows = None,
    *,
    start: Moment | None = None,
    hours: float | None = None,
    cadence: float | None = None,
    values: Mapping[str, Tensor] | None = None,
    towards: Mapping[str, Tensor] | None = None,
    trust: bool = False,
) -> Visibility:
    """Lit, seen, and lit-and-seen shares, and projected areas, of every component, at a recording's rows or for
    ``hours`` from ``start`` (ISO UTC or JD) every ``cadence`` seconds.

    Tensors in, tensors out: ``values`` puts tensors in place of numbers of the scene by full name ("panel.size_u"), and
    gradients reach them. ``towards`` names further directions, vectors (3,) or (T, 3) in GCRS; the velocity is one
    where it is known.
    """
    from torchlc.prediction.visibility import component_visibility

    scene = read_scene(scene, trust)
    return component_visibility(scene, grid_or(scene, recording, start, hours, cadence), values, towards)
