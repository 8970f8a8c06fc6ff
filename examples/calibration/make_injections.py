"""Concealed-effect cases.

    python examples/calibration/make_injections.py OUT [--seed 1] [--only TEXT] [--subset] [--from-priors]

Each case is a folder with scene.toml (what the model may assume), recording.ecsv (what the brute-force
reference saw, noise included) and answer.json (what was concealed). Geometry, materials, priors and noise are
drawn at random per case, from the seed and the case's name. An effect's size is set by its gain, the square
root of the chi2 that is left when the baseline (materials under their priors) is refitted to the noiseless
truth: near 3, 6 and 20. An effect without a size is sized by what makes it matter: a wing's distance, an
exposure, a polish. Surfaces are such as spacecraft have; with --from-priors they are all that the scene's priors allow, as
they must be where intervals and probabilities are held to what they promise.

Under another law of reflection the gain that an effect is sized by is what numbers of that law leave of it; where that is under 5
``verdicts_accepted`` holds "unexplained" as well, for then the law alone explains the rows.
In answer.json, ``family`` lists the sets of effects that are right answers: the truth; each single rival of a single effect, and
of several effects each part of the set, alone or with one other effect, that leaves less than 4 in chi2 of the noiseless truth (``rivals_chi2``, by linear projection at
the refit of the baseline, so that rivals of large effects are only roughly judged).
``intervals``: rows where the truth and the best refit without the effect differ by more than 2 sigma;
``effect_intervals``: the effect itself, at the true materials.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "reference"))

import observe
import sky
from cases import NOISE, OUTSIDE, SUBSET, Composed, compose, listed, names
from circumstances import Setup
from concealed import Concealed, Rng
from gain import Baseline, beyond_own_law, truth_of
from nominal import error_factor, loose_tangents, mishaps
from rivals import ENOUGH, others, rivals
from scene_files import toml


def shares(with_it: Any, without: Any, sigma_flux: sky.Array, rows: sky.Mask) -> list[dict[str, Any]]:
    """Components by their share of the sum of |change of flux|/sigma over the rows."""
    total = {}
    for name in with_it.components:
        mine = with_it.component_flux[:, with_it.components.index(name)]
        other = (
            without.component_flux[:, without.components.index(name)] if name in without.components else 0.0
        )
        total[name] = float((np.abs(mine - other) / sigma_flux)[rows].sum())
    whole = sum(total.values())
    return (
        [{"name": k, "share": round(v / whole, 3)} for k, v in sorted(total.items(), key=lambda i: -i[1])]
        if whole
        else []
    )


class Observed(NamedTuple):
    """What is concealed in one case, what that shines like, and what was recorded of it, bad rows apart."""

    setup: Setup
    concealed: Concealed
    said: dict[str, Any]
    physics: Concealed
    curve: Any
    mag: sky.Array
    error: sky.Array
    recorded: sky.Array
    bad: sky.Array
    quoted: sky.Array
    from_their_priors: bool

    def write(self, folder: Path) -> None:
        """scene.toml and recording.ecsv."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scene.toml").write_text(toml(self.setup.tree))
        rows = len(self.mag)
        observe.write_recording(
            folder / "recording.ecsv",
            self.setup.t,
            self.recorded + self.bad,
            self.quoted,
            np.full(rows, self.setup.exptime),
            np.full(rows, self.setup.station),
        )


def observed(name: str, number: int, seed: int, from_their_priors: bool = False) -> Observed:
    """The case of that name; ``number`` is that of its elements."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    composed = compose(name, number, rng, from_their_priors)
    return seen(composed, seed, rng)._replace(from_their_priors=from_their_priors)


def seen(composed: Composed, seed: int, rng: Rng) -> Observed:
    """What was composed, observed."""
    setup, concealed, said = composed
    setup = listed(setup, concealed, rng)
    physics = {k: v for k, v in concealed.items() if k not in NOISE}
    curve, mag = truth_of(setup, physics, seed=seed)
    keep = np.isfinite(mag) & (mag < 17.0)
    setup = replace(setup, t=setup.t[keep])
    curve, mag = truth_of(setup, physics, seed=seed)
    error = observe.errors(mag, setup.floor)
    recorded = mag + observe.noise(setup.t, error, concealed, rng)
    brought = bool(said.get("nominal"))
    bad = mishaps(len(mag), rng) if brought else np.zeros(len(mag))
    quoted = np.round(error * error_factor(rng), 4) if brought else error
    return Observed(setup, concealed, said, physics, curve, mag, error, recorded, bad, quoted, False)


def write_case(name: str, folder: Path, number: int, seed: int, from_their_priors: bool = False) -> str:
    """Makes one case; returns a line about it."""
    return write_observed(name, folder, seed, observed(name, number, seed, from_their_priors))


def write_composed(name: str, folder: Path, seed: int, rng: Rng, composed: Composed) -> str:
    """Observes what was composed and writes its three files; returns a line about it."""
    return write_observed(name, folder, seed, seen(composed, seed, rng))


def write_observed(name: str, folder: Path, seed: int, case: Observed) -> str:
    """Writes the three files of a case with what its answer needs to know; returns a line about it."""
    setup, concealed, said, physics, curve, mag, error, recorded, bad, quoted, from_their_priors = case
    brought = bool(said.get("nominal"))
    plain, plain_mag = truth_of(setup, {}, seed=seed)
    as_in_scene = setup.true_tree is None and setup.true_materials is None
    tree = setup.tree
    if brought:  # the refit begins at the true geometry, and sizes and zero point join it in linear form
        tree = {**(setup.true_tree or tree), "materials": tree["materials"]}
    as_listed = replace(setup, tree=tree, true_tree=None, true_materials=None)
    baseline = Baseline(as_listed, error, truth_of(as_listed, {}, seed=seed)[1])
    start = baseline.best_refit(recorded)
    left, theta, model = min(
        (baseline.refit(mag, at) for at in (start[1], baseline.truth)), key=lambda result: result[0]
    )
    if brought:
        tangents = loose_tangents(setup, baseline, theta)
        change = baseline.projected((mag - model) / error, tangents)
        left, model = float(change @ change), mag - change[: len(mag)] * error
    family, competing = [], {}
    if physics and said.get("note") != OUTSIDE:
        family = [sorted(physics), *said.get("family", [])]
        if len(physics) > 1 and as_in_scene:
            family += others(setup, physics, baseline, mag, seed, left)
        if len(physics) == 1 and (as_in_scene or brought):
            tangents = loose_tangents(setup, baseline, theta) if brought else baseline.tangents(theta)
            competing = rivals(baseline, theta, model, mag, set(physics), tangents)
            family += [[effect] for effect, chi2 in competing.items() if chi2 < ENOUGH]
    elif set(concealed) - set(physics):
        family = [sorted(concealed)]
    changed = np.abs(mag - model) > 2.0 * error
    effect_rows = np.abs(mag - plain_mag) > 2.0 * error
    flux_error = error * curve.flux
    accepted = said.get("accepted", [said["verdict"]])
    if said["verdict"] in ("missing_physics", "unexplained") and left < 25.0:
        accepted = [*accepted, "adequate", *(["noise_model"] if brought else [])]  # too weak to be sure of
    if setup.true_materials is not None and physics:
        own = beyond_own_law(setup, mag - plain_mag, error)
        if float(own @ own) < 25.0:  # the law alone explains the rows as well
            accepted = [*accepted, "unexplained"]
    answer = {
        "key": name,
        "kind": setup.kind,
        "baseline": sorted(baseline.effects),
        "effects": sorted(concealed),
        "parameters": {
            effect: {k: sky.iso(v) if k == "time" else v for k, v in values.items()}
            for effect, values in concealed.items()
        },
        "verdict": said["verdict"],
        "verdicts_accepted": accepted,
        "note": said.get("note", ""),
        "family": family,
        "gain": round(float(np.sqrt(left)), 2),
        "bad_rows": np.flatnonzero(bad),
        "quoted_over_true_error": round(float(np.median(quoted / error)), 3),
        "where": {
            "intervals": observe.intervals(setup.t, changed),
            "effect_intervals": observe.intervals(setup.t, effect_rows),
            "rows_flagged": int(changed.sum()),
            "components": shares(curve, plain, flux_error, changed) if physics else [],
        }
        if said["verdict"] != "adequate"
        else None,
        "chi2": {
            "baseline_refit": round(start[0], 1),
            "truth": round(float((((recorded - mag) / error) ** 2).sum()), 1),
            "dof": len(mag) - len(baseline.free),
        },
        "largest_raw_change_mag": round(float(np.abs(mag - plain_mag).max()), 4),
        "rivals_chi2": {k: round(v, 2) for k, v in list(competing.items())[:8]},
        "materials": setup.true_materials or setup.materials,
        "materials_from_their_priors": from_their_priors,
        "materials_baseline_refit": {
            f"{m}.{k}": round(float(np.exp(v)) if k == "n" else float(v), 5)
            for (m, k, _), v in zip(baseline.free, start[1], strict=True)
        },
        "recording": {
            "rows": len(mag),
            "mag": [round(float(mag.min()), 2), round(float(mag.max()), 2)],
            "phase": [round(float(curve.phase_deg.min()), 1), round(float(curve.phase_deg.max()), 1)],
            "airmass": [round(float(curve.airmass.min()), 2), round(float(curve.airmass.max()), 2)],
            "rows_in_shadow": int((curve.sunlit < 1).sum()),
        },
    }
    case.write(folder)
    observe.write_answer(folder / "answer.json", answer)
    return (
        f"{name}: {setup.kind}, {len(mag)} rows, gain {answer['gain']}, "
        f"chi2 {answer['chi2']['baseline_refit']} -> {answer['chi2']['truth']}, family {family}"
    )


def numbered() -> Iterator[tuple[int, str]]:
    """The catalogue number and the name of every case."""
    return enumerate(names(), 70001)


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Write concealed-effect cases; those already there are kept."
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--subset", action="store_true", help="a few cases, one of nearly every kind")
    parser.add_argument(
        "--from-priors", action="store_true", help="surfaces drawn from their priors in the scene"
    )
    options = parser.parse_args()
    for number, name in numbered():
        wanted = options.only in name and (name in SUBSET or not options.subset)
        if wanted and not (options.out / name / "answer.json").exists():
            print(write_case(name, options.out / name, number, options.seed, options.from_priors), flush=True)


if __name__ == "__main__":
    main()
