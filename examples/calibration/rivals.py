"""Which other answers leave hardly more of the noiseless truth than the right one."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

import sky
from body import DEFAULT_EFFECTS
from circumstances import Setup
from concealed import Concealed, instant
from gain import Baseline, truth_of

ENOUGH = 4.0
"""Chi-square of the noiseless truth below which what is left is no reason to ask for more."""
LINEAR = 0.5
"""Share of the chi2 that a refit leaves which its linear form must leave to be believed."""
SHARE = 0.05
"""Of its size by which a number of an effect is changed for its derivative."""


def probes(setup: Setup, taken: set[str]) -> Iterator[tuple[str, list[Concealed]]]:
    """Small doses of every rival: members of a list may be mixed; an effect may come twice."""
    moving = any("tracks" in c for c in setup.tree["components"])
    spinning = "spin_rate" in setup.tree["attitude"]
    mid = [instant(setup, s) for s in (0.15, 0.3, 0.5, 0.7, 0.85)]
    several = len(setup.tree["components"]) > 1
    yield "time_offset", [{"time_offset": {"s": 0.5}}]
    yield "along_track_offset", [{"along_track_offset": {"deg": 0.02}}]
    yield "attitude_offset", [{"attitude_offset": {axis: 0.1}} for axis in "xyz"]
    if moving:
        yield "panel_offset", [{"panel_offset": {"deg": 0.1}}]
        yield "panel_cant", [{"panel_cant": {"deg": 0.1}}]
        if sum("tracks" in c for c in setup.tree["components"]) > 1:
            yield "wing_split", [{"wing_split": {"deg": 0.1}}]
    if spinning:
        yield "spin_rate_offset", [{"spin_rate_offset": {"rev_per_hour": 1e-4}}]
    for when in mid:
        yield "attitude_jump", [{"attitude_jump": {axis: 0.1, "time": when}} for axis in "xyz"]
    span_min = float(setup.t[-1] - setup.t[0]) / 60.0
    for period in (0.3, 0.6, 1.2, 2.4):
        for axis in "xyz":
            doses = [
                {"deg": 0.1, "period_min": period * span_min, "axis": axis, "phase_deg": one}
                for one in (0.0, 90.0)
            ]
            yield "wobble", [{"wobble": dose} for dose in doses]
    yield "extinction_residual", [{"extinction_residual": {"mag_per_airmass": 0.01}}]
    yield "zero_point_drift", [{"zero_point_drift": {"mag_per_hour": 0.01}}]
    yield "background", [{"background": {"fraction": 0.02}}]
    yield "saturation", [{"saturation": {"q": 0.02}}]
    for when in mid:
        yield "zero_point_step", [{"zero_point_step": {"mag": 0.02, "time": when}}]
    for component in (c["name"] for c in setup.tree["components"]):
        if several:
            yield "color_term", [{"color_term": {"mag": 0.02, "component": component}}]
        if component.startswith("panel"):
            yield "back_transmission", [{"back_transmission": {"t_d": 0.01, "component": component}}]
    for material in setup.materials:
        yield "normal_dispersion", [{"normal_dispersion": {"deg": 2.0, "material": material}}]
        for g in (1.5, 3.0):
            yield "lobe_tail", [{"lobe_tail": {"g": g, "material": material}}]
        for h in (0.03, 0.15):
            yield "opposition_surge", [{"opposition_surge": {"b0": 0.1, "h": h, "material": material}}]
        for n in (4.0, 30.0, 250.0, 2500.0, 50000.0):
            second = {"weight": 0.03, "n": n, "material": material}
            yield (
                "second_material",
                [
                    {"second_material": {**second, "r_spec": 0.3, "r_diff": 0.0}},
                    {"second_material": {**second, "r_spec": 0.0, "r_diff": 0.5}},
                ],
            )
    plate = {"area": 0.05, "n": 30.0}
    for k in range(60):
        z = 1.0 - (2 * k + 1) / 60.0
        way = {"lon": (k * 137.50776) % 360.0, "lat": float(np.rad2deg(np.arcsin(z)))}
        yield (
            "appendage",
            [
                {"appendage": {**plate, **way, "r_spec": 0.3, "r_diff": 0.0}},
                {"appendage": {**plate, **way, "r_spec": 0.0, "r_diff": 0.5}},
            ],
        )
    known = [e for e in (*DEFAULT_EFFECTS, "interreflection", "earthshine") if e not in taken]
    for effect in known:
        yield effect, [{effect: {}}]


def rivals(
    baseline: Baseline,
    theta: sky.Array,
    model: sky.Array,
    target: sky.Array,
    truth: set[str],
    tangents: sky.Array,
) -> dict[str, float]:
    """Least chi2 that each effect leaves of target - model after its own and the linear refit of what is free."""
    still = baseline.curve(theta, {})
    change = baseline.projected((target - model) / baseline.sigma, tangents)
    left: dict[str, float] = {}
    taken = set(baseline.effects)
    for effect, doses in probes(baseline.setup, taken):
        if effect in taken or truth == {effect}:
            continue
        columns = []
        for dose in doses:
            curve = baseline.curve(theta, dose)
            if not np.isfinite(curve).all():
                continue
            columns.append(baseline.projected((curve - still) / baseline.sigma, tangents))
        if not columns:
            continue
        matrix = np.array(columns).T
        whole = effect in DEFAULT_EFFECTS  # takes no dose
        part = matrix[:, 0] if whole else matrix @ np.linalg.lstsq(matrix, change, rcond=1e-9)[0]
        left[effect] = min(left.get(effect, np.inf), float(((change - part) ** 2).sum()))
    return dict(sorted(left.items(), key=lambda item: item[1]))


def others(
    setup: Setup, physics: Concealed, baseline: Baseline, truth: sky.Array, seed: int, worth: float
) -> list[list[str]]:
    """In the place of several effects: some of them, or some and one other, that leave less than ENOUGH of the noiseless truth (T,) in
    chi2, after the linear refit of their numbers and of the materials. What the rest do is too weak to be seen, or done by these as well.
    None where that refit leaves less than half of ``worth``, the chi2 of the refit without any: it knows no bounds of the materials then."""
    whole = baseline.curve(baseline.truth, physics)
    one_more: list[tuple[str, sky.Array]] = []
    for effect, doses in probes(setup, set(baseline.effects)):
        if effect not in physics:
            moved = [baseline.curve(baseline.truth, {**physics, **dose}) - whole for dose in doses]
            columns = np.array([one / baseline.sigma for one in moved if np.isfinite(one).all()]).T
            one_more += [(effect, columns)] if columns.size else []
    found: list[list[str]] = []
    for size in range(len(physics)):
        for names in itertools.combinations(sorted(physics), size):
            some = {name: physics[name] for name in names}
            without = truth_of(setup, some, seed=seed)[1]
            tangents = _with_numbers(setup, some, baseline, without, seed)
            left = baseline.projected((truth - without) / baseline.sigma, tangents)
            if not np.isfinite(left).all():
                continue
            if not size and float(left @ left) < LINEAR * worth:
                return []
            if size and float(left @ left) < ENOUGH:
                found.append(list(names))
            for effect, columns in one_more:
                beside = np.array([baseline.projected(column, tangents) for column in columns.T]).T
                rest = left - beside @ np.linalg.lstsq(beside, left, rcond=1e-9)[0]
                instead = sorted([*names, effect])
                if float(rest @ rest) < ENOUGH and instead not in found:
                    found.append(instead)
    return found


def _with_numbers(
    setup: Setup, some: Concealed, baseline: Baseline, without: sky.Array, seed: int
) -> sky.Array:
    """Whitened derivatives (T + P, P + K) of curve and priors, by the materials and by the K numbers of some effects."""
    columns = []
    for name, numbers in some.items():
        for key, value in numbers.items():
            if isinstance(value, float) and value and key != "time":
                moved = {**some, name: {**numbers, key: value * (1 + SHARE)}}
                columns.append((truth_of(setup, moved, seed=seed)[1] - without) / baseline.sigma)
    materials = baseline.tangents(baseline.truth)
    rows, count = materials.shape
    tangents = np.zeros((rows + len(columns), count + len(columns)))
    tangents[:rows, :count] = materials
    tangents[: len(without), count:] = np.array(columns).reshape(-1, len(without)).T
    return tangents
