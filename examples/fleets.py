"""Fleets of Starlink satellites: v1.5 by unseen nights, v2 mini by unseen satellites, visor or none from 23 magnitudes.

    python examples/fleets.py [DIRECTORY]

Satellites of one design share geometry and materials; each differs by an offset from a population whose spread is
learnt. Needs ../shared/data/starlink_v15, starlink_v2mini and starlink_2021_visor; without them the script says so and ends.
"""

from __future__ import annotations

import csv
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import norm, t

import torchlc
from torchlc.cli import scaffold
from torchlc.files.numbers import Free
from torchlc.geometry.orbit import earth
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.lightcurve.assembly import assemble
from torchlc.readers import Recording

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
FOLDS = 5
STARTS, ADAM_STEPS = 8, 100
LOWEST_DEG = 10.0
"""Elevation below which visual estimates suffer from extinction."""
LOW_KM = 430.0
"""Between the satellites at 330 to 380 km and those at 480 to 580 km, where held-out scores are told by class."""
ERROR_MAG = 0.05
"""Of every row of the v2 mini; what rows differ by beyond it is fitted. The quoted errors, 0.02 to 0.3 mag, are a tenth of that."""
ROUNDS = 4
"""Of expectation and maximisation: passes stop changing their mode."""
SURVEY_DEG = 43.65
"""Latitude of the survey's station; no visual observer is there."""
BRIGHT_MAG = 3.0
"""At 400 km: between the two kinds of passes of the satellites below LOW_KM."""
TOLD_BY = ("height", "day", "phase angle", "elevation", "azimuth", "station's latitude")
NEIGHBOURS = 15
LEAST_OBJECTS = 15
"""On either side of a split of the population."""


def robust(values: np.ndarray) -> float:
    """1.4826 median |deviation from the median|."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def fitted(
    scene: torchlc.Scene, recording: Recording, seed: int = 0
) -> tuple[torchlc.LightCurve, torch.Tensor]:
    """The model of a recording and its most probable theta."""
    model = torchlc.LightCurve(scene, recording)
    return model, fit_map(Likelihood(model), starts=STARTS, adam_steps=ADAM_STEPS, seed=seed).theta


def left(scene: torchlc.Scene, recording: Recording, names: Sequence[str], theta: torch.Tensor) -> np.ndarray:
    """Recorded minus model, mag, (T,), of a recording at another's theta: every object, night and station at the mean of its
    population."""
    model = torchlc.LightCurve(scene, recording, assembly=assemble(scene, recording))
    assert model.names == list(names)
    with torch.no_grad():
        return recording.observed - model(theta).numpy()


def held_out(scene: torchlc.Scene, recording: Recording, member: np.ndarray) -> np.ndarray:
    """Recorded minus model, mag, (T,), each row by a fit that has seen nothing of its member (T,): night or object."""
    ids = np.unique(member)
    order = np.random.default_rng(0).permutation(len(ids))
    delta = np.full(len(recording), np.nan)
    for fold in range(FOLDS):
        unseen = np.isin(member, ids[order[fold::FOLDS]])
        model, theta = fitted(scene, recording.keep(~unseen, "held out"))
        delta[unseen] = left(scene, recording.keep(unseen, "fitted to"), model.names, theta)
    return delta


# ------------------------------------------------------------------ v1.5


def v15_scene(effects: str) -> torchlc.Scene:
    text = (
        (DATA / "starlink_v15" / "scene.toml").read_text().replace("effects = []", f"effects = [{effects}]")
    )
    return torchlc.Scene.from_toml(text, DATA / "starlink_v15")


V15 = {
    "two plates": "",
    "with a further surface": '"appendage"',
    "with a further surface and the Earth's shadow": '"appendage", "earth_shadow"',
}
"""Effects of each model. A diagnosis names the last two and a background of each night, which no unseen night has (docs/real_data)."""


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


# ------------------------------------------------------------------ v2 mini


def v2mini(
    folder: Path, lowest_deg: float = LOWEST_DEG
) -> tuple[torchlc.Scene, Recording, np.ndarray, dict[str, np.ndarray]]:
    """Scene and recording with the satellite of each row, which rows are flagged as lit, and what else is recorded of each."""
    with (DATA / "starlink_v2mini" / "v2mini_part.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if float(row["alt_deg_satchecker"]) > lowest_deg]
    rows.sort(key=lambda row: row["observation_time_utc"])

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])

    latitude, longitude, up = (
        column(f"observer_{key}") for key in ("latitude_deg", "longitude_deg", "altitude_m")
    )
    alt, az = column("alt_deg_satchecker"), column("az_deg_satchecker")
    place = earth.station_itrs(latitude, longitude, up)
    sight = column("range_to_sat_km_satchecker")[:, None] * earth.horizontal_itrs(place, alt, az)
    height = earth.height_km(place + sight)
    places = list(zip(latitude, longitude, up, strict=True))
    ids = {one: f"s{k}" for k, one in enumerate(dict.fromkeys(places))}
    stations = "".join(
        f'[[stations]]\nid = "{key}"\nlatitude = {a}\nlongitude = {b}\nheight = {c}\n'
        for (a, b, c), key in ids.items()
    )
    scene = torchlc.Scene.from_toml(f"""
format = "torchlc-scene/1"
name = "Starlink v2 mini"
[orbit]
altaz = true
{stations}
{V2MINI}""")
    path = folder / "v2mini.csv"
    lines = ["time,mag,mag_err,station,alt,az,height,object,curve"]
    lines += [
        f"{row['observation_time_utc']},{row['apparent_magnitude']},{ERROR_MAG},"
        f"{ids[places[k]]},{alt[k]},{az[k]},{height[k]},{row['norad_cat_id']},all"
        for k, row in enumerate(rows)
    ]
    path.write_text("\n".join(lines) + "\n")
    recording = torchlc.load(scene, path)[1]
    lit = np.array([row["illuminated"] == "True" for row in rows])
    assert len(recording) == len(rows)
    recorded = {
        "height": height,
        "day": recording.time.jd - recording.time.jd[0],
        "catalogue number": column("norad_cat_id"),
        "phase angle": column("phase_angle_deg_satchecker"),
        "elevation": alt,
        "azimuth": az,
        "station's latitude": latitude,
        "range": column("range_to_sat_km_satchecker"),
    }
    return scene, recording, lit, recorded


V2MINI = (
    scaffold.PRESETS["starlink-v2-mini"]
    .shape(exact=True)
    .split("[materials.chassis]")[0]
    .replace("# What it is made of", "#")
    + """
[materials.chassis]
n      = { value = 10.0, low = 1.0, high = 1e4, prior = "loguniform" }
r_spec = { value = 0.05, low = 0.0, high = 1.0 }
r_diff = { value = 0.036, low = 0.0, high = 1.0 }
[materials.arrays]
n      = { value = 45.0, low = 1.0, high = 1e4, prior = "loguniform" }
r_spec = { value = 0.5, low = 0.0, high = 1.0 }
r_diff = { value = 0.01, low = 0.0, high = 1.0 }
[model]
effects = ["sun_distance", "earth_shadow", "jitter"]
[model.parameters]
band_sun_magnitude = -26.76
zero_point = { value = 0.0, sigma = 0.02, per = "object" }
"jitter.mag" = { value = 0.2, sigma = 0.3, prior = "halfnormal" }
"""
)


def log_population(mean: np.ndarray, variance: np.ndarray) -> float:
    """ln of the evidence of objects' means (N,) of variance (N,): normal about a centre, N(0, 1) mag, with a spread, half-normal
    of 0.5 mag. By the trapezoidal rule over the spread, and in closed form over the centre."""
    spread = np.linspace(1e-3, 3.0, 1500)
    total = variance[:, None] + spread**2
    weight = (1 / total).sum(0)
    first = (mean[:, None] / total).sum(0)
    square = (mean[:, None] ** 2 / total).sum(0) - first**2 / (weight + 1)
    log_density = -0.5 * (square + np.log(2 * np.pi * total).sum(0) + np.log1p(weight))
    log_density += np.log(2) + norm.logpdf(spread, scale=0.5)
    top = log_density.max()
    return float(top + np.log(np.trapezoid(np.exp(log_density - top), spread)))


def split(
    delta: np.ndarray, number: np.ndarray, recorded: dict[str, np.ndarray], jitter: float
) -> list[dict[str, Any]]:
    """Where each recorded column divides the population best into two, each with a centre and a spread of its own, and by how much
    ln of the evidence is larger than that of one population, over all places of the cut alike. Best column first."""
    ids = np.unique(number)
    mean = np.array([delta[number == one].mean() for one in ids])
    variance = jitter**2 / np.array([(number == one).sum() for one in ids])
    one = log_population(mean, variance)
    found = []
    for name, column in recorded.items():
        value = np.array([np.median(column[number == k]) for k in ids])
        cuts = np.unique(np.quantile(value, np.linspace(0.05, 0.95, 46)))
        cuts = [cut for cut in cuts if LEAST_OBJECTS <= (value < cut).sum() <= len(ids) - LEAST_OBJECTS]
        if not cuts:
            continue
        gains = np.array(
            [
                log_population(mean[value < cut], variance[value < cut])
                + log_population(mean[value >= cut], variance[value >= cut])
                - one
                for cut in cuts
            ]
        )
        best, low = cuts[int(gains.argmax())], value < cuts[int(gains.argmax())]
        found.append(
            {
                "column": name,
                "log_evidence": float(gains.max() + np.log(np.exp(gains - gains.max()).mean())),
                "cut": float(best),
                "between": [float(value[low].max()), float(value[~low].min())],
                "below": {
                    "objects": int(low.sum()),
                    "median": float(np.median(mean[low])),
                    "sigma": robust(mean[low]),
                },
                "above": {
                    "objects": int((~low).sum()),
                    "median": float(np.median(mean[~low])),
                    "sigma": robust(mean[~low]),
                },
            }
        )
    found.sort(key=lambda row: -row["log_evidence"])
    total = np.logaddexp.reduce([0.0, *(row["log_evidence"] - np.log(len(found)) for row in found)])
    for row in found:
        row["probability"] = float(np.exp(row["log_evidence"] - np.log(len(found)) - total))
    return found


def low_modes() -> dict[str, Any]:
    """Two ways to fly of the satellites below LOW_KM."""
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, lit, recorded = v2mini(Path(folder))
    return modes(scene, recording.keep(lit & (recorded["height"] < LOW_KM), "of the other class"))


def observers() -> dict[str, Any]:
    """The satellites below LOW_KM by who saw them: the survey's photometer, or visual observers, each fitted by itself and asked for
    satellites that it has not seen, with an offset of each, or with rows that may be of another kind; how much rows of one pass differ,
    and the share of rows of each station that are bright."""
    with tempfile.TemporaryDirectory() as folder:
        scene, recording, lit, recorded = v2mini(Path(folder))
    low = lit & (recorded["height"] < LOW_KM)
    latitude, distance = recorded["station's latitude"][low], recorded["range"][low]
    some = recording.keep(low, "of the other class")
    parameters = scene.model.parameters | {"zero_point": Free(value=0.0, sigma=0.5, prior="normal")}
    spared = scene.model_copy(
        update={
            "model": scene.model.model_copy(
                update={"effects": [*(scene.model.effects or ()), "outliers"], "parameters": parameters}
            )
        }
    )
    surveyed = np.abs(latitude - SURVEY_DEG) < 0.05
    found: dict[str, Any] = {}
    for name, rows in (("photometer", surveyed), ("visual", ~surveyed)):
        kept = some.keep(rows, "of the other observers")
        assert kept.object is not None
        group = passes(kept)
        mean = np.bincount(group, kept.observed) / np.bincount(group)
        apart = len(kept) - len(mean)
        unseen = held_out(scene, kept, kept.object)
        among_bad = held_out(spared, kept, kept.object)
        found[name] = {
            "rows": len(kept),
            "objects": len(kept.object_ids),
            "passes": len(mean),
            "within_pass": float(np.sqrt(((kept.observed - mean[group]) ** 2).sum() / apart)),
            "unseen": robust(unseen),
            "unseen_with_outliers": robust(among_bad),
            "unseen_median_of_passes": robust(
                np.array([np.median(unseen[group == k]) for k in range(len(mean))])
            ),
        }
        print(name, found[name], flush=True)
    at_400_km = some.observed - 5 * np.log10(distance / 400.0)
    found["stations"] = [
        {
            "latitude": float(one),
            "rows": int((latitude == one).sum()),
            "bright": float(np.mean(at_400_km[latitude == one] < BRIGHT_MAG)),
        }
        for one in np.unique(latitude)
        if (latitude == one).sum() >= LEAST_OBJECTS
    ]
    columns = np.array([column[low] for name, column in recorded.items() if name in TOLD_BY])
    assert some.object is not None
    share = of_neighbours(columns, at_400_km < BRIGHT_MAG, some.object)
    found["bright_told"] = area_under_curve(share, at_400_km < BRIGHT_MAG)
    return found


def of_neighbours(columns: np.ndarray, bright: np.ndarray, member: np.ndarray) -> np.ndarray:
    """Share (T,) of bright rows among the NEIGHBOURS nearest rows of other members, in columns (C, T) scaled to a deviation of 1."""
    scaled = columns / columns.std(1, keepdims=True)
    apart = ((scaled[:, :, None] - scaled[:, None]) ** 2).sum(0)
    apart[member[:, None] == member] = np.inf
    return bright[np.argsort(apart, 1)[:, :NEIGHBOURS]].mean(1)


def passes(recording: Recording) -> np.ndarray:
    """Which pass each row (T,) is of: those of one object within an hour of the clock."""
    assert recording.object is not None
    hours = np.floor(recording.seconds / 3600).astype(int)
    return np.unique(np.stack([recording.object, hours]), axis=1, return_inverse=True)[1].ravel()


def fleet() -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        dark = told_dark(*v2mini(Path(folder), 0.0)[:3])
        scene, recording, lit, recorded = v2mini(Path(folder))
    lighted = recording.keep(lit, "flagged as not illuminated")
    recorded = {name: column[lit] for name, column in recorded.items() if name != "range"}
    assert lighted.object is not None
    model, theta = fitted(scene, lighted)
    values = dict(zip(model.names, theta.tolist(), strict=True))
    delta = left(scene, lighted, model.names, theta)
    found: dict[str, Any] = {
        "rows": len(lighted),
        "objects": len(lighted.object_ids),
        "together": values,
        "splits": split(delta, lighted.object, recorded, values["jitter.mag"]),
        "dark": dark,
    }
    print(json.dumps(found, indent=1), flush=True)
    height = recorded["height"]
    for name, rows in (("high", height >= LOW_KM), ("low", height < LOW_KM)):
        some = lighted.keep(rows, "of the other class")
        assert some.object is not None
        model, theta = fitted(scene, some)
        unseen = held_out(scene, some, some.object)
        each = np.array([np.median(unseen[some.object == k]) for k in range(len(some.object_ids))])
        found[name] = {
            "rows": len(some),
            "objects": len(some.object_ids),
            "unseen": robust(unseen),
            "unseen_objects": robust(each),
            "unseen_median": float(np.median(unseen)),
            "parameters": dict(zip(model.names, theta.tolist(), strict=True)),
        }
        print(name, found[name], flush=True)
    return found


def log_mixture(delta: np.ndarray, group: np.ndarray, share: float, sigma: tuple[float, float]) -> np.ndarray:
    """ln of the joint density (2, G) of the rows of each group and of either mode: residuals ``delta`` (2, T) of both models, normal
    with a spread each, and the share of groups in the first."""
    scaled = delta / np.array(sigma)[:, None]
    rows = -0.5 * scaled**2 - np.log(np.array(sigma) * np.sqrt(2 * np.pi))[:, None]
    groups = np.stack([np.bincount(group, weights=one) for one in rows])
    return groups + np.log([[share], [1 - share]])


def two_modes(
    scene: torchlc.Scene, recording: Recording, group: np.ndarray, rounds: int = ROUNDS
) -> dict[str, Any]:
    """Two models of which each pass, ``group`` (T,), follows one: materials of their own, by expectation and maximisation with whole
    passes; begun from passes that are brighter and fainter than one model of all."""
    model, theta = fitted(scene, recording)
    delta = left(scene, recording, model.names, theta)
    many = group.max() + 1
    middle = np.array([np.median(delta[group == k]) for k in range(many)])
    first = middle < np.median(middle)
    thetas: list[torch.Tensor] = []
    share, sigma = 0.5, (1.0, 1.0)
    for _ in range(rounds):
        thetas = [
            fitted(scene, recording.keep(some[group], "of the other mode"))[1] for some in (first, ~first)
        ]
        both = np.stack([left(scene, recording, model.names, one) for one in thetas])
        share = float(np.clip(first.mean(), 0.02, 0.98))
        sigma = tuple(
            max(robust(one[some[group]]), ERROR_MAG) for one, some in zip(both, (first, ~first), strict=True)
        )
        joint = log_mixture(both, group, share, sigma)  # pyright: ignore[reportArgumentType]
        first = joint[0] > joint[1]
    return {
        "names": model.names,
        "thetas": thetas,
        "share": share,
        "sigma": sigma,
        "first": first,
        "delta": delta,
    }


def modes(scene: torchlc.Scene, recording: Recording, folds: int = FOLDS) -> dict[str, Any]:
    """Whether satellites of one class fly in two ways, changing from pass to pass: what two models predict of unseen satellites, against
    one model with a population of offsets."""
    assert recording.object is not None
    group = passes(recording)
    seen = two_modes(scene, recording, group)
    owner = np.array([recording.object[group == k][0] for k in range(group.max() + 1)])
    turned = [one for one in np.unique(owner) if len(set(seen["first"][owner == one])) == 2]
    order = np.random.default_rng(0).permutation(len(recording.object_ids))
    gain, nearer, single = [], [], []
    for fold in range(folds):
        unseen = np.isin(recording.object, order[fold::folds])
        part = np.unique(group[~unseen], return_inverse=True)[1].ravel()
        made = two_modes(scene, recording.keep(~unseen, "held out"), part, ROUNDS - 1)
        rest = recording.keep(unseen, "fitted to")
        both = np.stack([left(scene, rest, made["names"], one) for one in made["thetas"]])
        own = np.unique(group[unseen], return_inverse=True)[1].ravel()
        joint = log_mixture(both, own, made["share"], made["sigma"])
        mixed = np.logaddexp(joint[0], joint[1])
        one_model = fitted(scene, recording.keep(~unseen, "held out"))
        alone = left(scene, rest, one_model[0].names, one_model[1])
        spread = robust(made["delta"])
        plain = log_mixture(np.stack([alone, alone]), own, 0.5, (spread, spread))
        gain += [mixed - np.logaddexp(plain[0], plain[1])]
        chosen = np.where(joint[0] > joint[1], 0, 1)[own]
        nearer += [both[chosen, np.arange(len(own))]]
        single += [alone]
    total = np.concatenate(gain)
    return {
        "passes": int(group.max() + 1),
        "first_passes": int(seen["first"].sum()),
        "sigma": list(seen["sigma"]),
        "satellites_of_several_passes": int(sum((owner == one).sum() > 1 for one in np.unique(owner))),
        "satellites_in_both": len(turned),
        "unseen_in_its_mode": robust(np.concatenate(nearer)),
        "unseen_one_model": robust(np.concatenate(single)),
        "log_density_gained": float(total.sum()),
        "standard_error": float(total.std(ddof=1) * np.sqrt(len(total))),
        "parameters": [dict(zip(seen["names"], one.tolist(), strict=True)) for one in seen["thetas"]],
    }


def told_dark(scene: torchlc.Scene, recording: Recording, lit: np.ndarray) -> dict[str, Any]:
    """How much of the Sun the Earth hides at the place and time of each row flagged as not illuminated, and at how many of the
    others it hides all."""
    hidden = torchlc.simulate(scene, recording).columns["eclipse_fraction"]
    assert hidden is not None and recording.object is not None and recording.alt is not None
    rows = [
        {
            "object": recording.object_ids[recording.object[k]],
            "time": str(recording.time[k].isot)[:19],
            "mag": float(recording.observed[k]),
            "elevation_deg": float(recording.alt[k]),
            "hidden": float(hidden[k]),
        }
        for k in np.flatnonzero(~lit)
    ]
    wholly = np.array([row["hidden"] for row in rows]) == 1.0
    return {
        "rows": rows,
        "wholly_hidden": int(wholly.sum()),
        "others_wholly_hidden": int((hidden[lit] == 1.0).sum()),
    }


# ------------------------------------------------------------------ visor


def visor() -> dict[str, Any]:
    """Probability of a visor for each of 23 satellites from the other 22: magnitudes at 550 km, linear in the phase angle, with a
    mean for either kind and one spread; and the area under the curve with the 90 % interval of resampled satellites, of these
    probabilities and of the magnitudes themselves, the fainter the likelier."""
    lines = (DATA / "starlink_2021_visor" / "mags-streaks.dat").read_text().splitlines()[1:]
    cells = [line.split() for line in lines if line.strip()]
    zero, counts, streak, rate, range_km, phase = (
        np.array([float(one[k]) for one in cells]) for k in (1, 3, 6, 7, 8, 10)
    )
    fitted_visor = np.array([one[11] == "T" for one in cells])
    mag = zero - 2.5 * np.log10(counts * EXPOSURE_S / (streak / rate))
    reduced = mag - 5 * np.log10(range_km / 550.0)
    basis = np.stack([np.ones(len(mag)), fitted_visor, phase - phase.mean()], 1)
    chance = np.empty(len(mag))
    for k in range(len(mag)):
        rest = np.arange(len(mag)) != k
        log_density = []
        for kind in (0.0, 1.0):
            row = np.array([1.0, kind, phase[k] - phase.mean()])
            inverse = np.linalg.inv(basis[rest].T @ basis[rest])
            best = inverse @ basis[rest].T @ reduced[rest]
            dof = rest.sum() - 3
            variance = ((reduced[rest] - basis[rest] @ best) ** 2).sum() / dof
            width = np.sqrt(variance * (1 + row @ inverse @ row))
            log_density.append(t.logpdf((reduced[k] - row @ best) / width, dof) - np.log(width))
        share = fitted_visor[rest].mean()
        odds = np.log(share / (1 - share)) + log_density[1] - log_density[0]
        chance[k] = 1 / (1 + np.exp(-odds))
    random = np.random.default_rng(0)
    areas, plain = [], []
    while len(areas) < 4000:
        some = random.integers(len(mag), size=len(mag))
        if 0 < fitted_visor[some].sum() < len(some):
            areas.append(area_under_curve(chance[some], fitted_visor[some]))
            plain.append(area_under_curve(reduced[some], fitted_visor[some]))
    best = np.linalg.lstsq(basis, reduced, rcond=None)[0]
    return {
        "satellites": [
            {"name": one[0], "mag": m, "reduced": r, "visor": bool(v), "probability": p}
            for one, m, r, v, p in zip(
                cells, mag.tolist(), reduced.tolist(), fitted_visor, chance.tolist(), strict=True
            )
        ],
        "fainter_with_visor": float(best[1]),
        "sigma": float(np.std(reduced - basis @ best, ddof=3)),
        "auc": area_under_curve(chance, fitted_visor),
        "auc_of_magnitude": area_under_curve(reduced, fitted_visor),
        "auc_of_magnitude_90": np.quantile(plain, (0.05, 0.95)).tolist(),
        "auc_90": np.quantile(areas, (0.05, 0.95)).tolist(),
        "right": int(((chance > 0.5) == fitted_visor).sum()),
        "of": len(mag),
    }


EXPOSURE_S = 30.0
"""Of the images whose zero points are quoted; a satellite crosses its streak in a fraction of a second."""


def area_under_curve(score: np.ndarray, positive: np.ndarray) -> float:
    """Share of pairs of a positive and a negative in which the positive scores more, ties half."""
    difference = score[positive][:, None] - score[~positive]
    return float(np.mean((difference > 0) + 0.5 * (difference == 0)))


PARTS = {"v15": v15, "v2mini": fleet, "modes": low_modes, "observers": observers, "visor": visor}


def main() -> None:
    if not (DATA / "starlink_v2mini").exists():
        print(f"{DATA / 'starlink_v2mini'} is not here: nothing to do")
        return
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out")
    out.mkdir(parents=True, exist_ok=True)
    path = out / "fleets.json"
    found: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    for name in sys.argv[2:] or PARTS:
        began = time.process_time()
        found[name] = PARTS[name]()
        found[name]["cpu_seconds"] = time.process_time() - began
        path.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
