"""What each effect leaves behind if a model lacks it: ``.venv/bin/python docs/effects/make_figures.py [--sizes] [NAME ...]``.

Every effect is put into a scene in which it matters. Its figure shows the magnitudes with it less those
without, once as the materials are and once after the materials have been refitted without it, against time
and against the coordinate that belongs to the effect. Noise effects show what they add to the errors.
sizes.json keeps sizes and costs for the page; ``--sizes`` leaves the costs as they were.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from settings import ERROR_MAG, SETTINGS, Setting, rows, with_effects

import torchlc
from torchlc.diagnosis.coordinates import coordinates
from torchlc.effects import registry
from torchlc.figures.style import BEFORE, DATA, MODEL, style
from torchlc.inference.density import Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.posterior import fit
from torchlc.stages.entry import Entry
from torchlc.stages.showing import TIME, Shown

HERE = Path(__file__).parent
FIGURES = HERE / "figures"
SIZES = HERE / "sizes.json"
BATCH = 8
REPEATS = 3
DARK = 1e-4
"""Rows with less than this share of the brightest row's light are not drawn."""


def materials_at(model: torchlc.LightCurve, materials: Mapping[str, float]) -> torch.Tensor:
    theta = model.theta().detach().clone()
    for name, value in materials.items():
        theta[model.names.index(name)] = value
    return theta


def measured(name: str, case: Shown) -> tuple[dict[str, Any], Mapping[str, np.ndarray]]:
    """Sizes of what ``name`` leaves, and the columns that its figure shows."""
    setting = SETTINGS[case.setting]
    entry = str(Entry(name, case.target))
    full = {
        f"{name}.{key}" + (f"[{case.target}]" if case.target else ""): value
        for key, value in case.values.items()
    }
    recording = rows(setting)
    holding = torchlc.LightCurve(with_effects(setting.text, [entry], full), recording)
    theta = materials_at(holding, case.materials)
    with torch.no_grad():
        light = holding.brightness(theta).flux
        bare = torchlc.LightCurve(with_effects(setting.text, [], {}), recording)
        light = torch.minimum(light, bare.brightness(materials_at(bare, case.materials)).flux)
        recording = recording.keep((light > DARK * light.max()).numpy(), "dark")
        holding = torchlc.LightCurve(with_effects(setting.text, [entry], full), recording)
        seen = holding(theta).numpy()
    lacking = torchlc.LightCurve(with_effects(setting.text, [], {}), replace(recording, observed=seen.copy()))
    without = materials_at(lacking, case.materials)
    posterior = Posterior(Likelihood(lacking), scaled=False)
    again = fit(None, posterior, posterior.coordinates(without[None]))
    with torch.no_grad():
        plain = seen - lacking(without).numpy()
        along = {key: value.numpy() for key, value in coordinates(lacking, without).items()}
        shares = lacking.brightness(without, shares=True)
        assert shares.shares is not None  # asked for
    along |= {f"share of {one}": shares.shares[i].numpy() for i, one in enumerate(shares.components)}
    sun = lacking.view(lacking.values(without)).state.sun.reshape(-1, len(recording), 3)[0]
    along["distance of the Sun, au"] = torch.linalg.vector_norm(sun, dim=-1).numpy() / 149_597_870.7
    if "period_min" in case.values:
        along["cycle of the wobble"] = (
            recording.seconds / 60 % case.values["period_min"] / case.values["period_min"]
        )
    left = again.delta.numpy()
    sizes = {
        "rms_mag": float(np.sqrt(np.mean((plain - np.median(plain)) ** 2))),
        "refitted_rms_mag": float(np.sqrt(np.mean(left**2))),
        "refitted_most_mag": float(np.abs(left).max()),
    }
    columns = {
        "hours": recording.seconds / 3600, "plain": plain, "left": left, "along": along[case.coordinate],
        "with": seen, "without": seen - left,
    }  # fmt: skip
    return sizes, columns


def cost(setting: Setting, entry: str) -> float:
    """Processor time of a call with BATCH sets of parameters, those of the effect free, over that of the bare
    model; taken in turn, the least of each."""
    recording = rows(setting)
    models = [torchlc.LightCurve(with_effects(setting.text, one, {}), recording) for one in ([], [entry])]
    sets = [nearby(model) for model in models]
    least = [float("inf"), float("inf")]
    with torch.no_grad():
        for _ in range(REPEATS + 1):
            for index, (model, theta) in enumerate(zip(models, sets, strict=True)):
                began = time.process_time()
                model(theta)
                least[index] = min(least[index], time.process_time() - began)
    return least[1] / least[0]


def nearby(model: torchlc.LightCurve) -> torch.Tensor:
    """BATCH sets (BATCH, P) of parameters about where the model starts."""
    generator = torch.Generator().manual_seed(0)
    parameters = model.parameter_set
    low, high = parameters.flat_bounds()
    spread = torch.where(torch.isfinite(high - low), high - low, 0.01)
    start = torch.where(torch.isfinite(model.theta().detach()), model.theta().detach(), 3.0)
    y = parameters.to_flat(start) + 1e-3 * spread * torch.rand(BATCH, len(start), generator=generator)
    return parameters.from_flat(torch.minimum(torch.maximum(y, low + 1e-6), high - 1e-6))


def noise_of(name: str, case: Shown) -> tuple[dict[str, Any], Mapping[str, np.ndarray]]:
    """Errors drawn without and with a noise effect."""
    setting = SETTINGS[case.setting]
    full = {f"{name}.{key}": value for key, value in case.values.items()}
    drawn = []
    for effects, values in (([], {}), ([name], full)):
        scene = with_effects(setting.text, effects, values)
        clean = torchlc.simulate(scene, rows(setting)).mag
        drawn.append(torchlc.simulate(scene, rows(setting), noise=ERROR_MAG, seed=3).mag - clean)
    plain, left = drawn
    sizes = {
        "rms_mag": float(np.std(left)),
        "refitted_rms_mag": None,
        "refitted_most_mag": float(np.abs(left).max()),
    }
    return sizes, {"hours": rows(setting).seconds / 3600, "plain": plain, "left": left}


def draw(name: str, case: Shown, sizes: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> None:
    noise = registry()[name].stage == "noise"
    with plt.rc_context({**style(8.5), "figure.facecolor": "white"}):
        figure, (left, right) = plt.subplots(1, 2, figsize=(7.6, 2.7), layout="constrained")
        hours = columns["hours"]
        scale, unit = (1.0, "hours") if hours.max() < 100 else (24.0, "days")
        if hours.max() < 0.5:
            scale, unit = 1 / 60, "minutes"
        labels = (
            ("quoted errors alone", "with the noise")
            if noise
            else ("left out", "left out, materials refitted")
        )
        dots = {"ls": "", "marker": "o", "ms": 2.2}
        for values, colour, label in zip(
            (columns["plain"], columns["left"]), (BEFORE, MODEL), labels, strict=True
        ):
            left.plot(hours / scale, values, color=colour, label=label, **dots)
        left.set_xlabel(unit)
        left.set_ylabel("drawn error, mag" if noise else "with − without, mag")
        if noise:
            shown_noise(case, columns, right)
        elif case.coordinate == TIME:
            right.plot(hours / scale, columns["with"], color=DATA, label="with it", **dots)
            right.plot(
                hours / scale, columns["without"], color=MODEL, lw=1.1, label="without it, materials refitted"
            )
            right.invert_yaxis()
            right.set(xlabel=unit, ylabel="mag")
        else:
            for key, colour in (("plain", BEFORE), ("left", MODEL)):
                right.plot(columns["along"], columns[key], color=colour, **dots)
            right.set_xlabel(case.coordinate.replace("_deg", ", deg ").replace("_", " "))
        for axes in (left, right):
            if not (axes is right and (noise or case.coordinate == TIME)):
                axes.axhline(0, color=DATA, lw=0.7, zorder=0)
                axes.invert_yaxis()
        figure.legend(loc="outside lower center", ncols=4, fontsize=8, handletextpad=0.3)
        shown = ", ".join(f"{key} {value:g}" for key, value in case.values.items())
        rms = f"rms {sizes['rms_mag']:.2g} mag"
        if not noise:
            rms += f", refitted {sizes['refitted_rms_mag']:.2g}"
        figure.suptitle(f"{name}{': ' + shown if shown else ''} ({case.setting}): {rms}", fontsize=8.5)
        FIGURES.mkdir(exist_ok=True)
        figure.savefig(FIGURES / f"{name}.png", dpi=110)
        plt.close(figure)


def shown_noise(case: Shown, columns: Mapping[str, np.ndarray], axes: Any) -> None:
    """Distribution of the errors, or their autocorrelation where that is what the noise changes."""
    if case.coordinate != "mag":
        minutes = 60 * columns["hours"][:40]
        for key, colour in (("plain", BEFORE), ("left", MODEL)):
            one = columns[key] - columns[key].mean()
            lagged = [np.mean(one[: len(one) - k] * one[k:]) / np.mean(one**2) for k in range(len(minutes))]
            axes.plot(minutes - minutes[0], lagged, "o-", ms=2.2, lw=0.8, color=colour)
        axes.axhline(0, color=DATA, lw=0.7)
        axes.set(xlabel="lag, min", ylabel="autocorrelation")
        return
    edges = np.linspace(-1, 1, 41) * np.abs(columns["left"]).max()
    for key, colour in (("plain", BEFORE), ("left", MODEL)):
        axes.hist(columns[key], edges, histtype="step", color=colour, log=True)
    axes.set(xlabel="drawn error, mag", ylabel="rows")


def main(names: list[str], *, costs: bool) -> None:
    told = json.loads(SIZES.read_text(encoding="utf-8")) if SIZES.exists() else {}
    for name in names or registry():
        case = registry()[name].shown
        work: Callable[[str, Shown], Any] = noise_of if registry()[name].stage == "noise" else measured
        sizes, columns = work(name, case)
        draw(name, case, sizes, columns)
        told[name] = {"setting": case.setting, **sizes, "cost": told.get(name, {}).get("cost")}
        if costs:
            told[name]["cost"] = cost(SETTINGS[case.setting], str(Entry(name, case.target)))
        print(name, told[name], flush=True)
        whole = {one: told[one] for one in registry() if one in told}
        SIZES.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main([name for name in sys.argv[1:] if name != "--sizes"], costs="--sizes" not in sys.argv)
