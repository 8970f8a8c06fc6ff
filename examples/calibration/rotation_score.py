"""Whether a rotation is found: the modes of an answer against the truth of a draw."""

from __future__ import annotations

from typing import Any

import numpy as np

NEAR_CHI2 = 10.0
"""Modes this near to the best in -2 ln likelihood are among the answers."""
BARS = {"pole_deg": 3.0, "period": 1e-3, "axis_deg": 5.0, "periods": 5e-3, "inertia": 0.05, "rate_sd": 3.0}


def score(truth: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """What of the truth is among the modes that fit nearly as well as the best, and whether a decided answer is wrong."""
    near = [one for one in answer["modes"] if one["above_best"] < NEAR_CHI2]
    told = [_compared(truth, one) for one in near]
    best = min(told, key=lambda one: (not one["right"], one["pole_deg"]))
    wrong = answer["decided"] and not told[0]["right"]
    return {**best, "modes": len(near), "decided": answer["decided"], "confidently_wrong": bool(wrong)}


def _compared(truth: dict[str, Any], mode: dict[str, Any]) -> dict[str, Any]:
    way = [_unit(truth["pole"]), _unit(mode["pole_icrs"])]
    pole = float(np.degrees(np.arccos(np.clip(way[0] @ way[1], -1, 1))))
    if "periods_s" not in truth:
        ratio = mode["period_s"] / truth["period_s"]
        right = pole < BARS["pole_deg"] and abs(ratio - 1) < BARS["period"] and mode["periods_s"] is None
        rate: dict[str, float] = {}
        if "period_rate_ms_per_day" in truth:
            sd = mode["period_rate_sd_ms_per_day"] or 0.0
            off = (mode["period_rate_ms_per_day"] or 0.0) - truth["period_rate_ms_per_day"]
            rate = {"rate_off_ms_per_day": off, "rate_sd_ms_per_day": sd}
            right = right and abs(off) < BARS["rate_sd"] * sd
        return {
            "right": bool(right),
            **rate,
            "pole_deg": pole,
            "period_ratio": ratio,
            "multiple": bool(abs(ratio - 1) < 0.02),
        }
    if mode["periods_s"] is None:
        return {
            "right": False,
            "pole_deg": pole,
            "period_ratio": mode["period_s"] / truth["periods_s"]["precession_long"],
        }
    ratios = {
        key: mode["periods_s"][key] / truth["periods_s"][key] for key in ("precession_long", "rotation")
    }
    inertia = max(
        abs(a / b - 1) for a, b in zip(mode["inertia_ratios"], truth["inertia_ratios"], strict=True)
    )
    right = pole < BARS["axis_deg"] and inertia < BARS["inertia"]
    right = right and all(abs(one - 1) < BARS["periods"] for one in ratios.values())
    return {
        "right": bool(right),
        "pole_deg": pole,
        "inertia": inertia,
        **{f"{key}_ratio": one for key, one in ratios.items()},
    }


def _unit(ra_dec: list[float]) -> np.ndarray:
    lon, lat = np.radians(ra_dec)
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
