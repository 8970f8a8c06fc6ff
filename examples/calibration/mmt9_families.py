"""Families of Mini-MegaTORTORA's satellites: the tracks of one design in one fit, each predicted by the others, and what remains of each.

    python examples/calibration/mmt9_families.py DIRECTORY [--only TEXT] [--budget SECONDS]

Scenes are nominal, so sizes, the attitude, the angle of the arrays and the materials are free, and shared by all tracks of a family;
each satellite has an offset from a population whose spread is learnt. Rows err by what successive rows of their camera differ by, and
by what the family learns beyond that. What remains of a track, and of a track that was left out, is told beside that noise. Then each
track is diagnosed about its family's fit. Results go to mmt9_families.json, a step after the other; those that are there are not done
again. Needs ../shared/data/mmt9; without it the script says so and ends.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from real_recordings import begun

import torchlc
from torchlc.diagnosis.alternatives import with_free_sizes
from torchlc.diagnosis.run import diagnose
from torchlc.files.toml import parse_toml
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.readers import Recording

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "mmt9"
THIN = 40
"""Of the rows, which come at 10 Hz: one in 4 s. What the shared model leaves lasts for many seconds."""
THIN_ALONE = 10
"""Of the rows of a track that is diagnosed."""
STARTS, ADAM_STEPS, SEEDS = 6, 60, (0, 1)
OWN_DEG = 1.0
"""Standard deviation of the attitude and of the arrays' angle of one satellite about its family's."""
ANGLES = ("attitude_offset.x", "attitude_offset.y", "attitude_offset.z", "panel_offset.deg")
FREED_DEG = 5.0
"""Standard deviation of each angle about the nominal one."""


def freed(angles: str) -> str:
    """The table of a family's scene in place of its bare facet sum; ``angles`` is what is said of each angle beside its value."""
    return "\n".join(
        (
            "[model]",
            'effects = ["attitude_offset", "panel_offset", "sun_distance", "jitter"]',
            "[model.parameters]",
            'zero_point = { value = 0.0, sigma = 0.2, per = "object" }',
            '"jitter.mag" = { value = 0.1, sigma = 0.3, prior = "halfnormal" }',
            "band_sun_magnitude = -26.74",
            *(f'"{name}" = {{ value = 0.0, {angles} }}' for name in ANGLES),
        )
    )


SHARED = freed(f'sigma = {FREED_DEG}, prior = "normal"')
APART = freed(f'sigma = {FREED_DEG}, per = "object"')
"""Every satellite has an attitude and an angle of its arrays of its own."""


def families() -> dict[str, list[str]]:
    """Numbers of the tracks of each family, by the scenes' names."""
    known: dict[str, list[str]] = {}
    for scene in sorted(DATA.glob("scene_*.toml")):
        number = scene.stem.partition("_")[2]
        name = torchlc.Scene.from_toml(scene.read_text(), DATA).name.partition(",")[0]
        known.setdefault(name, []).append(number)
    return known


def successive_noise(mag: np.ndarray, curve: Sequence[str]) -> float:
    """1.4826 median |successive difference| / sqrt 2 within the cameras, mag."""
    steps = [np.diff(mag[np.array(curve) == camera]) for camera in dict.fromkeys(curve)]
    return float(1.4826 * np.median(np.abs(np.concatenate(steps))) / np.sqrt(2))


def track(number: str) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of a track's table."""
    lines = [line for line in (DATA / f"track_{number}.ecsv").read_text().splitlines() if line[0] != "#"]
    return lines[0].split(), [line.split() for line in lines[1:]]


def written(numbers: Sequence[str], thin: int, path: Path) -> dict[str, float]:
    """Writes every ``thin``-th row of the tracks as one table, each track an object, and returns the noise of each."""
    lines, noise = [], {}
    for number in numbers:
        names, rows = track(number)
        mag, curve = names.index("mag"), names.index("curve")
        noise[number] = successive_noise(
            np.array([float(row[mag]) for row in rows]), [row[curve] for row in rows]
        )
        lines = lines or [",".join([*names, "mag_err", "object"])]
        for row in rows[::thin]:
            row[curve] = f"{number} {row[curve]}"
            lines.append(",".join([*row, f"{noise[number]:.4f}", number]))
    path.write_text("\n".join(lines) + "\n")
    return noise


def nominal(number: str, model: str) -> torchlc.Scene:
    """A track's nominal scene with free sizes and another table of the model."""
    text = (DATA / f"scene_{number}.toml").read_text().split("[model]")[0]
    scene = with_free_sizes(torchlc.Scene.from_toml(text + model, DATA))
    assert scene is not None
    return scene


def fitted(scene: torchlc.Scene, recording: Recording) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording and its most probable theta, the best of several searches."""
    model = torchlc.LightCurve(scene, recording)
    fits = [
        fit_map(Likelihood(model), starts=STARTS, adam_steps=ADAM_STEPS, seed=seed).modes[0] for seed in SEEDS
    ]
    return model, min(fits, key=lambda mode: mode.objective).theta


def left(scene: torchlc.Scene, recording: Recording, names: Sequence[str], theta: torch.Tensor) -> np.ndarray:
    """Recorded minus model, mag, (T,), at another recording's theta: every satellite at the mean of its population."""
    model = torchlc.LightCurve(scene, recording)
    assert model.names == list(names)
    with torch.no_grad():
        return recording.observed - model(theta).numpy()


def rms(delta: np.ndarray) -> float:
    return float(np.sqrt(np.mean(delta**2)))


def shared_fit(numbers: Sequence[str]) -> dict[str, Any]:
    """What the shared model of a family leaves, track by track; what is left where each track has angles of its own; and what the
    shared model leaves of tracks that it has not seen."""
    began = time.process_time()
    scene, apart = (nominal(numbers[0], model) for model in (SHARED, APART))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "family.csv"
        noise = written(numbers, THIN, path)
        recording = torchlc.load(scene, path)[1]
    assert recording.object is not None
    ids = list(recording.object_ids)
    model, theta = fitted(scene, recording)
    seen = left(scene, recording, model.names, theta)
    turned = left(apart, recording, *_names_and_theta(*fitted(apart, recording)))
    tracks = {}
    for number in numbers:
        rows = recording.object == ids.index(number)
        others, by_others = fitted(scene, recording.keep(~rows, "left out"))
        unseen = left(scene, recording, others.names, by_others)[rows]
        tracks[number] = {
            "rows": int(rows.sum()),
            "noise": noise[number],
            "recorded": float(np.std(recording.observed[rows])),
            "rms": rms(seen[rows]),
            "rms_about_own_offset": float(np.std(seen[rows])),
            "own_angles_rms_about_own_offset": float(np.std(turned[rows])),
            "unseen_rms": rms(unseen),
            "unseen_rms_about_own_offset": float(np.std(unseen)),
        }
        print(number, tracks[number], flush=True)
    return {
        "parameters": dict(zip(model.names, theta.tolist(), strict=True)),
        "tracks": tracks,
        "cpu_seconds": time.process_time() - began,
    }


def _names_and_theta(model: torchlc.LightCurve, theta: torch.Tensor) -> tuple[list[str], torch.Tensor]:
    return model.names, theta


def about_family(number: str, values: Mapping[str, float]) -> torchlc.Scene:
    """A track's scene with its family's sizes and materials; its angles are free about the family's, and its offset is."""
    tree = parse_toml(nominal(number, SHARED).to_toml(), None)
    for part in tree["components"]:
        part["size"] = [
            values[f"{part['name']}.size_{axis}"] for axis in ("xyz" if part["shape"] == "box" else "uv")
        ]
    for name, material in tree["materials"].items():
        material |= {key: values[f"{name}.{key}"] for key in material if f"{name}.{key}" in values}
    parameters = tree["model"]["parameters"]
    for name in ANGLES:
        parameters[name] = {"value": values[name], "sigma": OWN_DEG, "prior": "normal"}
    parameters["zero_point"] = {
        "value": values["zero_point"],
        "sigma": max(values["object_scatter.mag"], 0.1),
        "prior": "normal",
    }
    del parameters["jitter.mag"]
    tree["model"]["effects"].remove("jitter")
    return torchlc.Scene.from_toml(torchlc.Scene.model_validate(tree).to_toml(), DATA)


def remains(number: str, values: Mapping[str, float], budget: float) -> dict[str, Any]:
    """The verdict on a track about its family's fit."""
    began = time.process_time()
    scene = about_family(number, values)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "track.csv"
        written([number], THIN_ALONE, path)
        recording = torchlc.load(scene, path)[1]
    diagnosis = diagnose(scene, recording, budget=budget)
    content = diagnosis.to_json()
    return {
        **{key: content[key] for key in ("verdict", "named", "families", "global_p", "improvement")},
        "probability": content["probabilities"]["told"],
        "rows": len(recording),
        "budget": budget,
        "cpu_seconds": time.process_time() - began,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="families whose name contains this")
    parser.add_argument("--budget", type=float, default=8.0, help="CPU seconds of the search of each track")
    options, file, known = begun(parser, "mmt9_families.json", DATA)
    for name, numbers in families().items():
        if options.only not in name:
            continue
        if name not in known:
            known[name] = shared_fit(numbers)
            file.write_text(json.dumps(known, indent=1) + "\n")
            print(f"{name}: {known[name]['cpu_seconds']:.0f} CPU s", flush=True)
        for number, told in known[name]["tracks"].items():
            if "remains" not in told:
                told["remains"] = remains(number, known[name]["parameters"], options.budget)
                file.write_text(json.dumps(known, indent=1) + "\n")
                print(number, told["remains"]["verdict"], told["remains"]["named"], flush=True)


if __name__ == "__main__":
    main()
