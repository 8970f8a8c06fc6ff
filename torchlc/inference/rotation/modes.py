"""Rotations that fit, best first, and what the data say of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from torchlc.geometry.rotation.rigid_body import FreeRotation, frequencies
from torchlc.inference.rotation.model_fit import Candidate
from torchlc.inference.rotation.passes import Rows
from torchlc.inference.rotation.trials import Count
from torchlc.readers import Recording
from torchlc.scene import Scene

KEPT_CHI2 = 25.0
"""A mode this far above the best is 4e-6 times as likely."""
LEAST_PROBABILITY = 0.01
"""Of a rotation that counts beside the best when it is asked whether the data decide."""
SAME_DEG = 1.5
"""Two fits with poles this near, and periods alike to SAME_PERIOD, are of one minimum found twice."""
SAME_PERIOD = 1e-3
CHANGED = 16.0
"""Fall of chi-square that a change of the period has to bring."""
ALIKE_DEG = 12.0
"""A mirror image is one of the geometry in the middle of a pass, which changes by some degrees on the way."""
LEAST_CYCLES = 2.0
"""Of the longer period of a free rotation that a pass has to hold for the light to have repeated: less is one stretch without
a second to hold it against."""
LEAST_BEAT = 0.25
"""Turn by which the two periods of a free rotation must fall out of step over the rows: light that repeats as a whole is also that of
a body of other paint about one axis."""
NOISY = 1.3
"""Rms over the noise of successive rows up to which a rotation fits rows without errors."""


@dataclass(frozen=True)
class RotationMode:
    """One state that fits: ``numbers`` of the attitude and ``sd`` of the free ones by name (pole deg in the scene's frame,
    period h, phase deg, period_rate ms a day, tilt, nutation and polhode_phase deg); ``counts``, turns less those of the
    most probable mode between passes, and ``possible``, how many counts its phases leave; ``likely``, the likeliest of these as
    differences from that of the mode, with probabilities; ``above``, how far its -2 ln likelihood is above the best; ``rms`` of
    the rows, mag; ``periods`` of the passes, s, each by itself, with standard deviations; ``probability`` among the modes that were found; ``mirror``, what it is of the best; ``apart``, what
    each night has for itself, which ``numbers`` hold as "phase[night]"."""

    numbers: Mapping[str, float]
    sd: Mapping[str, float]
    chi2: float
    counts: tuple[float, ...]
    probability: float
    mirror: str | None
    theta: Tensor
    scene: Scene
    possible: int = 1
    likely: tuple[Count, ...] = ()
    above: float = 0.0
    rms: float = math.nan
    periods: tuple[tuple[float, float], ...] = ()
    apart: tuple[str, ...] = ()

    @property
    def nights(self) -> list[str]:
        """Names of the nights that have a phase for themselves."""
        return [key[len("phase[") : -1] for key in self.numbers if key.startswith("phase[")]

    @property
    def period_s(self) -> float:
        return 3600.0 * self.numbers["period"]

    @property
    def period_sd_s(self) -> float:
        return 3600.0 * self.sd.get("period", 0.0)

    @property
    def tumbling(self) -> bool:
        """Whether it is a free rotation about no axis fixed in the body."""
        return self.scene.attitude.tumbles

    @property
    def moments(self) -> tuple[float, float, float] | None:
        """Moments of inertia about body x, y and z over the last, of a free rotation."""
        return (self.numbers["inertia_x"], self.numbers["inertia_y"], 1.0) if self.tumbling else None

    @property
    def rates(self) -> FreeRotation | None:
        """Mean rates of a free rotation, turns a second."""
        if not self.tumbling:
            return None
        nutation = torch.tensor(math.radians(self.numbers["nutation"]), dtype=torch.float64)
        moments = torch.tensor(self.moments, dtype=torch.float64)
        return frequencies(moments, nutation, torch.tensor(self.period_s, dtype=torch.float64))


@dataclass(frozen=True)
class RotationSearch:
    """Modes best first, and what was looked at. ``loose``: modes with a phase for each night, where those of ``modes`` take one of
    several counts of turns between nights for granted. ``pole_map``: unit vectors (D, 3), GCRS, and misfits (D,) of the grid."""

    modes: Sequence[RotationMode]
    rows: int
    dof: int
    passes: int
    symmetry: int
    searched_s: tuple[float, float]
    frequency: np.ndarray
    power: np.ndarray
    pole_map: tuple[np.ndarray, np.ndarray]
    connected: bool
    decided: bool
    verdict: str
    recording: Recording
    warnings: Sequence[str] = field(default_factory=tuple)
    loose: Sequence[RotationMode] = ()


def apart_deg(a: Tensor, b: Tensor) -> float:
    return math.degrees(2 * math.asin(min(1.0, float(torch.linalg.vector_norm(a - b)) / 2)))


def merged(found: Sequence[Candidate], rows: Rows) -> list[RotationMode]:
    """Modes within KEPT_CHI2 of the best, those of one pole and kind once. A change of the period counts only where it takes
    CHANGED off chi-square, and so does a free rotation against one about an axis of the body."""
    kept_kinds = list(found)
    for simpler, richer in (
        (lambda candidate: not candidate.trial.changing, lambda candidate: candidate.trial.changing),
        (lambda candidate: not candidate.tumbling, lambda candidate: candidate.tumbling),
    ):
        plain = [candidate.deviance for candidate in kept_kinds if simpler(candidate)]
        rich = [candidate.deviance for candidate in kept_kinds if richer(candidate)]
        if plain and rich and min(rich) > min(plain) - CHANGED:
            kept_kinds = [candidate for candidate in kept_kinds if simpler(candidate)]
    ranked = sorted(kept_kinds, key=lambda candidate: candidate.deviance)
    kept: list[Candidate] = []
    for fit in ranked:
        if fit.deviance > ranked[0].deviance + KEPT_CHI2:
            break
        if all(
            apart_deg(fit.pole, other.pole) > SAME_DEG
            or abs(fit.numbers["period"] / other.numbers["period"] - 1) > SAME_PERIOD
            or fit.tumbling != other.tumbling
            for other in kept
        ):
            kept.append(fit)
    if not kept:
        return []
    weights = np.exp(-0.5 * np.array([candidate.deviance - kept[0].deviance for candidate in kept]))
    weights /= weights.sum()
    base = kept[0].trial.counts
    return [
        RotationMode(
            candidate.numbers,
            candidate.sd,
            candidate.chi2,
            tuple(a - b for a, b in zip(candidate.trial.counts, base, strict=False)),
            float(weight),
            None if candidate is kept[0] else _mirror(candidate.pole, kept[0].pole, rows),
            candidate.theta,
            candidate.trial.scene,
            candidate.trial.possible,
            candidate.trial.likely,
            candidate.deviance - kept[0].deviance,
            candidate.rms,
            candidate.trial.periods,
            candidate.trial.apart,
        )
        for candidate, weight in zip(kept, weights, strict=True)
    ]


def _mirror(pole: Tensor, best: Tensor, rows: Rows) -> str | None:
    """What a pole is of the best one, if it is a mirror image."""
    if apart_deg(pole, -best) < ALIKE_DEG:
        return "the opposite pole"
    normal = torch.linalg.cross(rows.to_sun.mean(0), rows.to_observer.mean(0))
    if float(torch.linalg.vector_norm(normal)) < 1e-6:
        return None
    normal = normal / torch.linalg.vector_norm(normal)
    image = best - 2 * (best @ normal) * normal
    if apart_deg(pole, image) < ALIKE_DEG:
        return "the mirror image in the plane of Sun and observer"
    if apart_deg(pole, -image) < ALIKE_DEG:
        return "the opposite of the mirror image in the plane of Sun and observer"
    return None


def fits_the_rows(chi2: float, rms: float, dof: int, noise: float | None) -> bool:
    """Whether a rotation leaves no more than the errors, or where they are not given the ``noise`` of successive rows, mag."""
    return chi2 < dof + 5 * math.sqrt(2 * max(dof, 1)) if noise is None else rms < NOISY * noise


def verdict(
    modes: Sequence[RotationMode],
    dof: int,
    passes: int,
    longest_s: float,
    noise: float | None = None,
    *,
    all_s: float | None = None,
) -> tuple[bool, str]:
    """Whether the data decide, and what they say. ``longest_s``: of the longest pass; ``noise``: that of successive rows, mag, where
    errors are not given; ``all_s``: from the first row to the last, where there are several passes."""
    best = modes[0]
    poles = [mode for mode in modes if mode.probability > LEAST_PROBABILITY]
    period, slowest_s, beat = _course(best, longest_s, all_s)
    if not fits_the_rows(best.chi2, best.rms, dof, noise):
        return False, (
            f"cannot tell: the best rotation found, {period}, leaves "
            + (
                f"chi-square {best.chi2:.0f} for {dof} degrees of freedom"
                if noise is None
                else f"{best.rms:.2f} mag rms where successive rows differ by {noise:.2f} mag"
            )
            + "; shape, materials or the kind of rotation are not those of the scene"
        )
    if longest_s < LEAST_CYCLES * slowest_s:
        return False, (
            f"cannot tell: {period}, fits, but the longest pass, of {longest_s:.4g} s, does not hold {LEAST_CYCLES:g} of the longer of "
            "these: a body of another shape or paint that turns about one axis may shine alike"
        )
    if best.tumbling and beat < LEAST_BEAT:
        return False, (
            f"cannot tell: {period}, fits, but over the rows these fall out of step by {beat:.2g} of a turn only: light that repeats as a "
            "whole is also that of a body of another paint that turns about one axis"
        )
    if len(poles) > 1:
        return False, (
            f"cannot tell: {len(poles)} rotations fit about as well, the best {period}; the table lists them"
        )
    if best.apart:
        return False, (
            f"{period}, but the turns between the nights are not counted: each has its own {' and '.join(best.apart)}"
        )
    if passes > 1 and best.possible > 1:
        return False, (
            f"{period}, but cannot tell how often it turned between the passes: {best.possible} counts fit, and the errors of period and "
            "rate are those of all"
        )
    joined = "" if passes < 2 else ", the turns between the passes counted"
    return True, f"{period}{joined}"


def _course(mode: RotationMode, longest_s: float, all_s: float | None) -> tuple[str, float, float]:
    """How a mode turns, in words; of a free rotation the longer of its two periods, s, and the turn by which these fall out of step in
    the longest pass, or from first to last where turns between passes are counted; 0 of a turn about one axis."""
    if not mode.tumbling:
        in_pass = " in the longest pass" if "period" in mode.apart else ""
        return f"one turn in {mode.period_s:.6g} s{in_pass}", 0.0, 0.0
    rates = mode.rates
    assert rates is not None
    way_s = 1 / float(rates.polhode)
    slowest_s, fastest_s = max(mode.period_s, way_s), min(mode.period_s, way_s)
    counted = mode.possible == 1 and not mode.apart
    beat = (all_s if all_s is not None and counted else longest_s) / slowest_s
    beat *= abs(slowest_s / fastest_s - round(slowest_s / fastest_s))
    words = (
        f"not about one axis: the long axis turns about the angular momentum in {mode.period_s:.6g} s, and the latter "
        f"about the body in {way_s:.6g} s"
    )
    return words, slowest_s, beat
