"""How much of a concealed effect the baseline's own refit leaves: gains, and sizes of a given gain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import sky
from bruteforce import Placed, placed, scene_effects, simulate
from circumstances import QUICK, Setup
from curve import Curve
from detector import photometry
from observe import errors

GONE_DARK = 1e6
"""The gain of an effect that leaves a row without light, and so without a magnitude."""


class Baseline:
    """What the handed-out scene can do: curves of its free materials, refits under their priors, tangents."""

    def __init__(self, setup: Setup, sigma: sky.Array, exact: sky.Array | None = None) -> None:
        """``exact`` (T,): the curve at the true materials with full sampling, to correct quick curves by."""
        self.setup, self.sigma = setup, sigma
        self.scene = setup.scene()
        self._placed: dict[str, Placed] = {}
        self.effects = scene_effects(self.scene)
        self.free = [
            (material, key, table[key])
            for material, table in setup.tree["materials"].items()
            for key in table
            if isinstance(table[key], Mapping)
        ]
        self.truth = np.array([self._to(key, setup.materials[m][key]) for m, key, _ in self.free])
        self.correction = 0.0 if exact is None else exact - self.curve(self.truth, self.effects)
        self.physics = self.curve(self.truth) - self.curve(self.truth, {})

    @staticmethod
    def _to(key: str, value: float) -> float:
        return float(np.log(value)) if key == "n" else value

    def curve(
        self, theta: sky.Array, effects: Mapping[str, Any] | None = None, sampling: Mapping[str, int] = QUICK
    ) -> sky.Array:
        """Magnitudes (T,) at theta (n as its logarithm), with the baseline's effects or those given."""
        materials = deepcopy(self.setup.materials)
        for (material, key, _), value in zip(self.free, theta, strict=True):
            materials[material][key] = float(np.exp(value)) if key == "n" else float(value)
        scene = self.scene.with_materials(materials)
        use = self.effects if effects is None else effects
        setup = self.setup
        times = (scene, setup.t, setup.exptime, setup.station, use)
        fine = {name: sampling[name] for name in ("instants", "cylinder_facets") if name in sampling}
        key = repr((use, fine))
        if key not in self._placed:
            self._placed[key] = placed(*times, **fine)
        curve = simulate(*times, **sampling, known=self._placed[key])
        return photometry(curve, scene, use) + (self.correction if effects is None else 0.0)

    def _prior(self, theta: sky.Array) -> tuple[sky.Array, sky.Array]:
        """Residuals of normal priors (P,), and their slopes (P,)."""
        residual, slope = np.zeros(len(theta)), np.zeros(len(theta))
        for i, ((_, key, table), value) in enumerate(zip(self.free, theta, strict=True)):
            if "sigma" in table:
                natural = float(np.exp(value)) if key == "n" else value
                residual[i] = (natural - table["value"]) / table["sigma"]
                slope[i] = (natural if key == "n" else 1.0) / table["sigma"]
        return residual, slope

    def bounds(self) -> tuple[sky.Array, sky.Array]:
        low = np.zeros(len(self.free))
        high = np.array([np.log(1e6) if key == "n" else 1.0 for _, key, _ in self.free])
        return low, high

    def tangents(self, theta: sky.Array) -> sky.Array:
        """Whitened derivatives (T + P, P) of curve and priors, known physics left out to save time."""
        steps = np.array([0.02 if key == "n" else 0.003 for _, key, _ in self.free])
        low, high = self.bounds()
        columns = []
        for i, step in enumerate(steps):
            ends = np.clip([theta[i] - step, theta[i] + step], low[i], high[i])
            pair = [self.curve(np.r_[theta[:i], end, theta[i + 1 :]], {}) for end in ends]
            columns.append((pair[1] - pair[0]) / (ends[1] - ends[0]) / self.sigma)
        return np.vstack(
            [np.array(columns).reshape(len(steps), len(self.sigma)).T, np.diag(self._prior(theta)[1])]
        )

    def projected(self, change: sky.Array, tangents: sky.Array) -> sky.Array:
        """A whitened change (T,) less what the baseline can absorb, (T + P,)."""
        padded = np.r_[change, np.zeros(tangents.shape[1])]
        return padded - tangents @ np.linalg.lstsq(tangents, padded, rcond=1e-9)[0]

    def refit(
        self, target: sky.Array, start: sky.Array, bare: bool = False
    ) -> tuple[float, sky.Array, sky.Array]:
        """Least chi2 (data, priors), theta and curve for a target (T,): damped Gauss-Newton in the bounds.

        ``bare`` takes what the known physics changes at the truth as a constant, for the first steps.
        """
        low, high = self.bounds()

        def residuals(at: sky.Array) -> tuple[sky.Array, sky.Array]:
            model = self.curve(at, {}) + self.physics if bare else self.curve(at)
            return model, np.r_[(model - target) / self.sigma, self._prior(at)[0]]

        theta, damping = np.clip(start, low, high), 1e-3
        model, misfit = residuals(theta)
        for _ in range(20):
            jacobian = self.tangents(theta)
            normal, slope = jacobian.T @ jacobian, jacobian.T @ misfit
            before = float(misfit @ misfit)
            for _ in range(5):
                step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), -slope)
                trial = np.clip(theta + np.clip(step, -1.0, 1.0), low, high)
                trial_model, trial_misfit = residuals(trial)
                if trial_misfit @ trial_misfit < before:  # false if not finite
                    theta, model, misfit = trial, trial_model, trial_misfit
                    damping *= 0.2
                    break
                damping *= 6.0
            if before - misfit @ misfit < 0.05 + 1e-3 * before:
                break
        return float(misfit @ misfit), theta, model

    def best_refit(self, target: sky.Array) -> tuple[float, sky.Array, sky.Array]:
        """The best of refits from the truth and from a sharper, a blunter and a duller surface."""
        starts = [self.truth]
        for n_shift, r_factor in ((2.5, 0.5), (-1.2, 1.5), (0.0, 0.2)):
            moved = [
                value if "sigma" in table else (value + n_shift if key == "n" else value * r_factor)
                for (_, key, table), value in zip(self.free, self.truth, strict=True)
            ]
            starts.append(np.array(moved))
        best = min((self.refit(target, start, bare=True) for start in starts), key=lambda result: result[0])
        return self.refit(target, best[1])


def truth_of(setup: Setup, concealed: Mapping[str, Any], **sampling: int) -> tuple[Curve, sky.Array]:
    """The true curve and its noiseless magnitudes (T,)."""
    scene = setup.true_scene()
    effects = {**scene_effects(scene), **concealed}

    def seen(more: Mapping[str, Any]) -> Curve:
        return simulate(scene, setup.t, setup.exptime, setup.station, {**effects, **more}, **sampling)

    if "detachment" in concealed:  # outside torchlc's library: a part that flies off
        part = {key: value for key, value in concealed["detachment"].items() if key != "time"}
        gone = setup.t > concealed["detachment"]["time"]
        with_it, curve = seen({"appendage": part}), seen({})
        curve.flux[~gone] = with_it.flux[~gone]
        return curve, photometry(curve, scene, effects)
    if "flexing" in concealed:  # outside torchlc's library: wings that swing on their hinges
        swing = concealed["flexing"]
        turn = 2 * np.pi * (setup.t - setup.t[0]) / 60.0 / swing["period_min"]
        angles = swing["deg"] * np.linspace(-1, 1, 9)
        fluxes = np.array([seen({"panel_offset": {"deg": float(angle)}}).flux for angle in angles])
        curve = seen({})
        for row, angle in enumerate(swing["deg"] * np.sin(turn)):
            curve.flux[row] = np.exp(np.interp(angle, angles, np.log(np.maximum(fluxes[:, row], 1e-300))))
        return curve, photometry(curve, scene, effects)
    curve = seen({})
    return curve, photometry(curve, scene, effects)


def gain(setup: Setup, concealed: Mapping[str, Any], linear: bool = False) -> float:
    """Square root of the chi2 that the baseline leaves of the noiseless truth.

    Known physics is left out on both sides (it hardly changes a gain, and costs most of the time), and priors
    are centred on the truth. ``linear``: by projection on the tangents at the truth, quick, never too small.
    GONE_DARK where the effect leaves a row no light, and so no magnitude. Where the surfaces obey another law than the
    scene's, what numbers of that law leave, always linear.
    """
    bare = with_effects(setup, [])
    target = truth_of(bare, concealed, **QUICK)[1]
    if not np.isfinite(target).all():
        return GONE_DARK
    if setup.true_materials is not None:
        change = target - truth_of(bare, {}, **QUICK)[1]
        return float(np.linalg.norm(beyond_own_law(bare, change, errors(target, setup.floor), **QUICK)))
    baseline = Baseline(centred(bare), errors(target, setup.floor))
    if linear:
        change = (target - baseline.curve(baseline.truth)) / baseline.sigma
        left = baseline.projected(change, baseline.tangents(baseline.truth))
        return float(np.linalg.norm(left))
    return float(np.sqrt(baseline.best_refit(target)[0]))


def beyond_own_law(setup: Setup, change: sky.Array, sigma: sky.Array, **sampling: int) -> sky.Array:
    """What of a change (T,) of magnitudes, in errors, the numbers of the law that the surfaces have do not take up, (T,)."""
    assert setup.true_materials is not None
    slopes = []
    for name, surface in setup.true_materials.items():
        for key, value in surface.items():
            if not isinstance(value, float):
                continue
            ends = [value, 0.99 * value if value else 0.003]
            mags = [
                truth_of(
                    replace(setup, true_materials={**setup.true_materials, name: {**surface, key: end}}),
                    {},
                    **sampling,
                )[1]
                for end in ends
            ]
            slopes.append((mags[1] - mags[0]) / (ends[1] - ends[0]) / sigma)
    tangents = np.array(slopes).T
    return change / sigma - tangents @ np.linalg.lstsq(tangents, change / sigma, rcond=1e-9)[0]


def centred(setup: Setup) -> Setup:
    """The setup with normal priors centred on the truth, so that their own miss is no misfit."""
    tree = deepcopy(setup.tree)
    for material, table in tree["materials"].items():
        for key, entry in table.items():
            if isinstance(entry, Mapping) and "sigma" in entry:
                table[key] = {**entry, "value": setup.materials[material][key]}
    return replace(setup, tree=tree)


def with_effects(setup: Setup, effects: list[str] | None) -> Setup:
    """The setup with another ``effects`` list; None leaves the key out."""
    tree, true_tree = deepcopy(setup.tree), deepcopy(setup.true_tree)
    for one in (tree, true_tree):
        if one is not None:
            one["model"].pop("effects", None)
            if effects is not None:
                one["model"] = {"effects": effects, **one["model"]}
    return replace(setup, tree=tree, true_tree=true_tree)


Make = Callable[[float, Setup], tuple[Setup, dict[str, Any]]]


def sized(setup: Setup, make: Make, first: float, limits: tuple[float, float], target: float) -> float:
    """The size whose gain is near ``target``, by secants in logarithms: linear gains first, then refits."""
    low, high = limits
    size = float(np.clip(first, low, high))
    for linear, trials in ((True, 8), (False, 3)):
        known: list[tuple[float, float]] = []
        for _ in range(trials):
            known.append((np.log(size), np.log(max(gain(*make(size, setup), linear), 1e-3) / target)))
            if abs(known[-1][1]) < 0.1:
                break
            slope = 1.0
            if len(known) > 1 and known[-1][0] != known[-2][0]:
                slope = (known[-1][1] - known[-2][1]) / (known[-1][0] - known[-2][0])
                slope = float(np.clip(slope, 0.4, 3.0))
            size = float(np.clip(size * np.exp(np.clip(-known[-1][1] / slope, -2.5, 2.5)), low, high))
            if np.log(size) == known[-1][0]:
                break
        size = float(np.exp(min(known, key=lambda pair: abs(pair[1]))[0]))
    return size
