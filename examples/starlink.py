"""Starlink v1.5: materials inferred from 720 recorded magnitudes, beside those measured in a laboratory.

    python examples/starlink.py [DIRECTORY]

The laboratory samples are read twice: through models fitted to the goniometer's table, and through the table
itself, interpolated. Both say too little light by a magnitude or half of one; materials fitted to the
recorded magnitudes leave the satellites' own scatter. Needs ../shared/data/starlink_v15; without it the
script says so and ends.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from torch import Tensor

import torchlc
from torchlc.brdf import MODELS, incidence
from torchlc.figures.style import DATA, MODEL, OBSERVER, style
from torchlc.inference.optimiser import fit_map
from torchlc.materials.goniometer import ReflectanceFit, ReflectanceTable, fit_table, read_table

ROOT = Path(__file__).parents[1]
STARLINK = ROOT.parent / "shared" / "data" / "starlink_v15"
PARTS = ("chassis", "array")
LAWS = ("ashikhmin-shirley", "phong-mirror", "ggx")
PUBLISHED = {"laboratory": (-0.52, 0.57), "inferred": (0.06, 0.45)}
"""Median and robust sigma of recorded minus published model, mag, on this file."""
STEPS = 3000
BIN_DEG = 1.5


def median_and_sigma(values: np.ndarray) -> tuple[float, float]:
    """Median, and 1.4826 median |deviation|."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))


def scene_of(law: str) -> torchlc.Scene:
    """The published geometry with both surfaces of one law of reflection, everything free."""
    text = (STARLINK / "scene.toml").read_text().replace('"ashikhmin-shirley"', f'"{law}"')
    if law == "ggx":
        text = re.sub(r"(?m)^n = .*", "alpha = { value = 0.3, low = 0.001, high = 1.0 }", text)
        text = text.replace("r_spec", "f0")
    return torchlc.Scene.from_toml(text, STARLINK)


def at_laboratory_values(model: torchlc.LightCurve, laboratory: Mapping[str, ReflectanceFit]) -> Tensor:
    """theta (P,) of the materials fitted to the goniometer's tables."""
    values = [laboratory[name.split(".")[0]].values[name.split(".")[1]] for name in model.names]
    return torch.tensor(values, dtype=torch.float64)


def read_directly(model: torchlc.LightCurve, tables: Mapping[str, ReflectanceTable]) -> np.ndarray:
    """Magnitudes (T,) with f_r read off the tables, no model between: ln f_r interpolated in the angle of
    incidence and in that between normal and bisector, which in the plane of incidence are all there is.
    """
    flux = np.zeros(len(model.recording))
    view = model.view(model.values(model.theta().detach()))
    range_m = view.range_m[0].detach().numpy()
    for patch in view.patches:
        if patch.faces[0] != "front":
            continue
        pose = torch.eye(3, dtype=torch.float64) if patch.pose is None else patch.pose[0].detach()
        normal = torch.einsum("...ij,j->...i", pose, patch.normal[0]).numpy()
        sun, observer = (direction[0].detach().numpy() for direction in (view.to_sun, view.to_observer))
        half = (sun + observer) / np.linalg.norm(sun + observer, axis=-1, keepdims=True)
        cos_i, cos_r, cos_h = ((normal * direction).sum(-1) for direction in (sun, observer, half))
        from_half = np.degrees(np.arccos(cos_h.clip(-1, 1)))
        columns, angles = [], np.unique(tables[patch.component].incidence_deg)
        for angle in angles:
            grid, log_brdf = along_half_angle(tables[patch.component], angle)
            columns.append(np.interp(from_half, grid, log_brdf))
        stacked, from_sun = np.array(columns), np.degrees(np.arccos(cos_i.clip(-1, 1)))
        log_brdf = [np.interp(one, angles, stacked[:, row]) for row, one in enumerate(from_sun)]
        seen = (cos_i > 0) & (cos_r > 0)
        area = float(patch.area[0].detach())
        flux += np.where(seen, np.exp(log_brdf) * cos_i * cos_r * area / range_m**2, 0.0)
    return float(model.assembly.sun_magnitude[0]) - 2.5 * np.log10(flux)


def along_half_angle(table: ReflectanceTable, incidence_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """One scan as the mean ln f_r of bins in the angle between normal and bisector, deg."""
    rows = table.incidence_deg == incidence_deg
    half = table.to_sun[rows] + table.to_observer[rows]
    angle = np.degrees(np.arccos((half[:, 2] / np.linalg.norm(half, axis=-1)).clip(-1, 1)))
    place = (angle / BIN_DEG).astype(int)
    used = np.unique(place)
    log_brdf = np.log(table.brdf[rows])
    return (
        np.array([angle[place == one].mean() for one in used]),
        np.array([log_brdf[place == one].mean() for one in used]),
    )


def in_plane(
    law: str, values: Mapping[str, Tensor], incidence_deg: float, exit_deg: np.ndarray
) -> np.ndarray:
    """f_r (..., N), 1/sr, in the plane of incidence; positive exit angles are on the mirror's side."""
    sun = torch.tensor([-np.sin(np.radians(incidence_deg)), 0.0, np.cos(np.radians(incidence_deg))])
    polar = torch.as_tensor(np.radians(exit_deg))
    observer = torch.stack([torch.sin(polar), torch.zeros_like(polar), torch.cos(polar)], -1)
    normal, u = torch.eye(3, dtype=torch.float64)[[2, 0]]
    angles = incidence(normal, u, sun.double().expand_as(observer), observer).flattened()
    kind = MODELS[law]
    full = {long: values[short] for short, group in kind.shared.items() for long in group if short in values}
    table = kind.tabulate(angles, 1 / (angles.cos_i * angles.cos_r))
    specular, diffuse = kind.parts(table, {**values, **full})
    return (specular + diffuse).numpy()


def infer() -> tuple[dict[str, object], torchlc.FitResult, np.ndarray]:
    """Numbers, the sampled fit, and the residuals (T,) of the laboratory's table read directly."""
    tables = {part: read_table(STARLINK / f"lab_brdf_{part}.csv") for part in PARTS}
    laboratory = {law: {part: fit_table(tables[part], law) for part in PARTS} for law in LAWS}
    numbers: dict[str, object] = {"published": PUBLISHED}
    for law in LAWS:
        scene, recording = torchlc.load(scene_of(law), STARLINK / "recording.ecsv")
        model = torchlc.LightCurve(scene, recording)
        with torch.no_grad():
            predicted = model(at_laboratory_values(model, laboratory[law])).numpy()
        found = fit_map(torchlc.Likelihood(model))
        with torch.no_grad():
            fitted = model(found.theta).numpy()
        numbers[law] = {
            "laboratory": median_and_sigma(recording.observed - predicted),
            "inferred": median_and_sigma(recording.observed - fitted),
            "laboratory values": {part: laboratory[law][part].values for part in PARTS},
            "laboratory rms dex": {part: laboratory[law][part].rms_dex for part in PARTS},
            "inferred values": dict(zip(model.names, found.theta.tolist(), strict=True)),
        }
    scene, recording = torchlc.load(scene_of(LAWS[0]), STARLINK / "recording.ecsv")
    result = torchlc.fit(scene, recording, steps=STEPS)
    direct = recording.observed - read_directly(result.model, tables)
    numbers["laboratory table, interpolated"] = median_and_sigma(direct)
    numbers["posterior"] = {
        name: {key: row[key] for key in ("median", "q05", "q95", "rhat")}
        for name, row in result.parameters().items()
    }
    return numbers, result, direct


def recorded_angles(model: torchlc.LightCurve, part: str) -> str:
    """Angles of incidence and exit at which the recording sees a part's lit front, 5 to 95 %, in words."""
    view = model.view(model.values(model.theta().detach()))
    (patch,) = (one for one in view.patches if one.component == part)
    front = patch.faces.index("front")
    pose = torch.eye(3, dtype=torch.float64) if patch.pose is None else patch.pose[0].detach()
    normal = torch.einsum("...ij,j->...i", pose, patch.normal[front])
    cos_i, cos_r = ((normal * one[0].detach()).sum(-1).numpy() for one in (view.to_sun, view.to_observer))
    seen = (cos_i > 0) & (cos_r > 0)
    ranges = [np.quantile(np.degrees(np.arccos(cosine[seen])), (0.05, 0.95)) for cosine in (cos_i, cos_r)]
    return ", ".join(
        f"{name} {low:.0f}–{high:.0f}°"
        for name, (low, high) in zip(("incidence", "exit"), ranges, strict=True)
    )


def draw(result: torchlc.FitResult, direct: np.ndarray, path: Path) -> None:
    law = LAWS[0]
    with plt.rc_context({**style(), "figure.facecolor": "white"}):
        figure, grid = plt.subplots(2, 2, figsize=(9.0, 6.4), layout="constrained")
        residual = result.delta
        bins = np.linspace(-3, 3, 49)
        for values, colour, label in (
            (direct, OBSERVER, "laboratory table"),
            (residual, MODEL, "inferred materials"),
        ):
            middle, sigma = median_and_sigma(values)
            text = f"{label}: {middle:+.2f} ± {sigma:.2f} mag"
            grid[0, 0].hist(values, bins, histtype="step", color=colour, lw=1.5, label=text)
        grid[0, 0].set(xlabel="recorded − model, mag", ylabel="satellite passes")
        grid[0, 0].legend(fontsize=8, loc="upper left")
        grid[0, 0].set_ylim(top=grid[0, 0].get_ylim()[1] * 1.25)
        phase = result.model.assembly.track.phase_angle_deg.numpy()
        grid[0, 1].plot(phase, direct, "o", ms=2, color=OBSERVER, alpha=0.5)
        grid[0, 1].plot(phase, residual, "o", ms=2, color=MODEL, alpha=0.6)
        grid[0, 1].axhline(0, color=DATA, lw=0.8)
        grid[0, 1].set(xlabel="phase angle, deg", ylabel="recorded − model, mag")
        grid[0, 1].invert_yaxis()
        draws = result.posterior.flat if result.posterior is not None else result.fit.theta[None]
        draws = draws[torch.linspace(0, len(draws) - 1, 400).long()]
        exits = np.linspace(-85, 85, 341)
        for axes, part in zip(grid[1], PARTS, strict=True):
            table = read_table(STARLINK / f"lab_brdf_{part}.csv")
            lobes = {
                name.split(".")[1]: draws[:, column]
                for column, name in enumerate(result.model.names)
                if name.startswith(part)
            }
            for angle, shade in ((5.0, 0.35), (75.0, 1.0)):
                rows = table.incidence_deg == angle
                sign = np.where(table.azimuth_deg[rows] == 180.0, 1.0, -1.0)
                order = np.argsort(sign * table.exit_deg[rows])
                place = (sign * table.exit_deg[rows])[order]
                label = f"laboratory, incidence {angle:g}°"
                axes.plot(place, table.brdf[rows][order], ".", ms=3, color=OBSERVER, alpha=shade, label=label)
                band = np.quantile(in_plane(law, lobes, angle, exits), (0.05, 0.95), axis=0)
                label = f"inferred, {angle:g}°"
                axes.fill_between(exits, *band, color=MODEL, alpha=0.25 + 0.4 * shade, lw=0, label=label)
            axes.set(yscale="log", ylim=(2e-4, 3e3), xlabel="exit angle in the plane, deg")
            seen = recorded_angles(result.model, part)
            axes.set_title(f"{part} (recorded: {seen})", fontsize=9)
            axes.set_ylabel("f$_r$, 1/sr" if part == "chassis" else "")
        grid[1, 0].legend(fontsize=7.5, loc="upper left")
        figure.savefig(path, dpi=110)
        plt.close(figure)


def main() -> None:
    if not STARLINK.exists():
        print(f"{STARLINK} is not here: nothing to do")
        return
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out")
    out.mkdir(parents=True, exist_ok=True)
    numbers, result, direct = infer()
    draw(result, direct, out / "starlink.png")
    (out / "starlink.json").write_text(json.dumps(numbers, indent=1) + "\n")
    print(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
