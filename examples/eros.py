"""433 Eros: the recorded light curves against a spacecraft's shape, without and with self-shadowing.

    python examples/eros.py [DIRECTORY]

Nothing is fitted but the scale of each curve: pole, period and phase are the scene's, the law of reflection
is Lommel-Seeliger with a tenth of Lambert. An independent ray-casting program's residuals stand beside ours.
Needs ../shared/data/eros; without it the script says so and ends.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch

import torchlc
from torchlc.figures.style import DATA, MODEL, OBSERVER, style

ROOT = Path(__file__).parents[1]
EROS = ROOT.parent / "shared" / "data" / "eros"
SHOWN = ("e103_2445001", "e047_2442400", "e101_2444994", "e075_2442461")
Table = dict[str, dict[str, float]]
"""By curve: what the reference says of it, and our residuals."""
HARD = {"phase_angle": 30.0, "amplitude": 0.3}
"""The curves in which shadows count: beyond these, deg and mag."""


def residuals(model: torchlc.LightCurve) -> tuple[dict[str, float], np.ndarray]:
    """Rms of each curve in per cent of its mean with its own best gain, and the scaled model (T,)."""
    theta = model.parameter_set.start()
    with torch.no_grad():
        found = torchlc.Likelihood(model).residuals(theta)
    recording = model.recording
    rms = {}
    for index, name in enumerate(recording.curve_ids):
        rows = recording.curve == index
        delta = found.delta.numpy()[rows]
        rms[name] = 100 * float(np.sqrt(np.mean(delta**2)) / recording.observed[rows].mean())
    return rms, recording.observed - found.delta.numpy()


def evaluate() -> tuple[torchlc.Recording, Table, dict[str, np.ndarray]]:
    """The recording; for each curve our residuals and the reference's; the two models (T,)."""
    scene, recording = torchlc.load(EROS / "scene.toml", EROS / "recording.ecsv")
    models = {
        "plain": torchlc.LightCurve(scene, recording, effects=[]),
        "shadowed": torchlc.LightCurve(scene, recording, effects=["self_shadowing"]),
    }
    with (EROS / "reference.csv").open() as file:
        table = {
            row["curve"]: {key: float(row[key]) for key in ("phase_angle", "amplitude", "plain", "shadowed")}
            for row in csv.DictReader(file)
        }
    curves = {}
    for kind, model in models.items():
        rms, curves[kind] = residuals(model)
        for name, value in rms.items():
            table[name][f"our_{kind}"] = value
    return recording, table, curves


def hard(row: dict[str, float]) -> bool:
    return all(row[key] > limit for key, limit in HARD.items())


def summary(table: Table) -> dict[str, float]:
    """Medians over the hard curves, and the largest departure of any curve from the reference."""
    chosen = [row for row in table.values() if hard(row)]
    found: dict[str, float] = {"curves": len(table), "hard_curves": len(chosen)}
    for kind in ("plain", "shadowed"):
        found[f"median_{kind}"] = float(np.median([row[f"our_{kind}"] for row in chosen]))
        found[f"reference_{kind}"] = float(np.median([row[kind] for row in chosen]))
        ratio = [row[f"our_{kind}"] / row[kind] - 1 for row in table.values()]
        found[f"worst_{kind}"] = float(np.abs(ratio).max())
    return found


def draw(recording: torchlc.Recording, table: Table, curves: dict[str, np.ndarray], path: Path) -> None:
    with plt.rc_context({**style(), "figure.facecolor": "white"}):
        figure = plt.figure(figsize=(9.0, 5.6), layout="constrained")
        grid = figure.add_gridspec(2, 3, width_ratios=(1, 1, 1.15))
        for place, name in enumerate(SHOWN):
            axes = figure.add_subplot(grid[place // 2, place % 2])
            rows = recording.curve == recording.curve_ids.index(name)
            hours = (recording.seconds[rows] - recording.seconds[rows][0]) / 3600
            axes.plot(hours, recording.observed[rows], "o", ms=2.5, color=DATA, label="recorded")
            axes.plot(hours, curves["plain"][rows], color=OBSERVER, lw=1.2, label="without shadows")
            axes.plot(hours, curves["shadowed"][rows], color=MODEL, lw=1.4, label="with shadows")
            row = table[name]
            change = f"{row['our_plain']:.1f} → {row['our_shadowed']:.1f} %"
            axes.set_title(f"{name}, phase {row['phase_angle']:.0f}°: {change}", fontsize=8.5)
            axes.set_xlabel("hours" if place > 1 else "")
            axes.set_ylabel("relative flux" if place % 2 == 0 else "")
            if place == 0:
                figure.legend(
                    *axes.get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9
                )
        upper, lower = figure.add_subplot(grid[0, 2]), figure.add_subplot(grid[1, 2])
        for kind, colour in (("plain", OBSERVER), ("shadowed", MODEL)):
            ours = [row[f"our_{kind}"] for row in table.values()]
            upper.plot([row[kind] for row in table.values()], ours, "o", ms=3, color=colour)
        upper.plot([0.4, 20], [0.4, 20], color=DATA, lw=0.8)
        upper.set(xscale="log", yscale="log", xlabel="reference, rms %", ylabel="torchlc, rms %")
        upper.set_title("every curve, two programs", fontsize=8.5)
        phase = [row["phase_angle"] for row in table.values()]
        gain = [row["our_plain"] - row["our_shadowed"] for row in table.values()]
        strong = [hard(row) for row in table.values()]
        lower.scatter(phase, gain, s=14, c=[MODEL if one else DATA for one in strong])
        lower.axhline(0, color=DATA, lw=0.8)
        lower.set(xlabel="phase angle, deg", ylabel="rms % that shadows remove")
        lower.set_title("orange: phase > 30°, amplitude > 0.3 mag", fontsize=8.5)
        figure.savefig(path, dpi=110)
        plt.close(figure)


def main() -> None:
    if not EROS.exists():
        print(f"{EROS} is not here: nothing to do")
        return
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out")
    out.mkdir(parents=True, exist_ok=True)
    recording, table, curves = evaluate()
    numbers = summary(table)
    draw(recording, table, curves, out / "eros.png")
    (out / "eros.json").write_text(json.dumps(numbers, indent=1) + "\n")
    for name, value in numbers.items():
        print(f"{name:20} {value:.4g}")


if __name__ == "__main__":
    main()
