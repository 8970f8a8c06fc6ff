"""Starlink v1.5 by unseen nights."""

from __future__ import annotations

from typing import Any

import numpy as np
from unseen import DATA, fitted, held_out, left, robust

import torchlc

V15 = {
    "two plates": "",
    "with a further surface": '"appendage"',
    "with a further surface and the Earth's shadow": '"appendage", "earth_shadow"',
}
"""Effects of each model. A diagnosis names the last two and a background of each night, which no unseen night has (docs/real_data)."""


def v15_scene(effects: str) -> torchlc.Scene:
    text = (
        (DATA / "starlink_v15" / "scene.toml").read_text().replace("effects = []", f"effects = [{effects}]")
    )
    return torchlc.Scene.from_toml(text, DATA / "starlink_v15")


def v15() -> dict[str, Any]:
    """Robust sigma of unseen nights by each model."""
    found: dict[str, Any] = {}
    for name, effects in V15.items():
        scene = v15_scene(effects)
        recording = torchlc.load(scene, DATA / "starlink_v15" / "recording.ecsv")[1]
        model, theta = fitted(scene, recording)
        seen = left(scene, recording, model.names, theta)
        unseen = held_out(scene, recording, recording.night)
        found[name] = {
            "seen": robust(seen),
            "unseen": robust(unseen),
            "unseen_median": float(np.median(unseen)),
            "parameters": dict(zip(model.names, theta.tolist(), strict=True)),
        }
        print(name, found[name], flush=True)
    found["rows"], found["nights"], found["published"] = len(recording), len(recording.night_ids), 0.47
    return found
