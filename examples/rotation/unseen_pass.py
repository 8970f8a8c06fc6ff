"""How well do some nights of a turning body predict another, whose phase nobody can know?

    python examples/rotation/unseen_pass.py SCENE RECORDING...

SCENE is one as ``torchlc rotation`` writes it (scene.toml, or scene_per_pass.toml). Each night in turn is left out: pole, materials and
what else is common are fitted to the others, and of the unseen night only its phase is found, and its period where the scene gives each
night its own. The rms of its rows is compared with that of a fit to it alone.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchlc
from torchlc.api import usable
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.polish import polish
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.readers.joining import joined
from torchlc.scene import Free, Scene

PHASES, REFINED = 48, 6
"""Phases that are tried over a turn, and of the best starts how many are refined."""
AT_ONCE = 32
PHASE = "attitude.phase"


@dataclass(frozen=True)
class Unseen:
    """Rms, mag, of a night's rows: predicted by the others with its own phase, and of a fit to it alone."""

    night: str
    rows: int
    predicted: float
    fitted: float


def unseen(scene: Scene, recording: Recording, night: str) -> Unseen:
    """One night predicted by the others."""
    number = recording.night_ids.index(night)
    inside = recording.night == number
    others = best(scene, recording.keep(~inside, "of the unseen night"), {})
    own = recording.keep(inside, "of other nights")
    known = {name: value for name, value in others.items() if "[" not in name and name != PHASE}
    predicted = best(scene, own, known)
    fitted = best(scene, own, {}, near=predicted)
    return Unseen(night, len(own), _rms(scene, own, predicted), _rms(scene, own, fitted))


def best(
    scene: Scene,
    recording: Recording,
    pinned: dict[str, float],
    near: dict[str, float] | None = None,
) -> dict[str, float]:
    """All numbers at the least squares; those of ``pinned`` stay. One night alone is tried at phases all around, and at periods
    a twelfth of a turn apart over it; ``near`` is another start."""
    model = LightCurve(scene, recording, assembly=assemble(scene, recording, pinned=pinned))
    likelihood, parameters = Likelihood(model), model.parameter_set
    start = parameters.start()
    starts = start[None]
    if len(recording.night_ids) == 1:
        starts = torch.cat([_around(scene, recording, model, start), _put(model, start, near or {})[None]])
        with torch.no_grad():
            cost = torch.cat([likelihood.chi2(one) for one in starts.split(AT_ONCE)])
        starts = starts[cost.argsort()[:REFINED]]
    noise = model.noise(start) if model.assembly.stage("noise") else None
    found = polish(likelihood, starts, noise, iterations=40)
    theta = parameters.from_flat(found.y[int(found.cost.argmin())])
    return {**pinned, **dict(zip(model.names, theta.tolist(), strict=True))}


def _around(scene: Scene, recording: Recording, model: LightCurve, start: torch.Tensor) -> torch.Tensor:
    """Starts (S, P) at all phases, and at all periods if the night has its own."""
    night = recording.night_ids[0]
    names = {key: f"attitude.{key}[{night}]" for key in ("phase", "period")}
    columns = {key: model.names.index(name) for key, name in names.items() if name in model.names}
    if "phase" not in columns:
        columns["phase"] = model.names.index(PHASE)
    # half a turn to either side is within the bounds that the search writes
    phases = start[columns["phase"]] + (torch.arange(PHASES, dtype=torch.float64) / PHASES - 0.5) * 360
    periods = start[columns["period"], None] if "period" in columns else torch.zeros(1, dtype=torch.float64)
    number = scene.attitude.period
    if "period" in columns and isinstance(number, Free):
        assert number.low is not None and number.high is not None
        low, high, span = 3600 * number.low, 3600 * number.high, float(np.ptp(recording.seconds))
        count = max(2, int(12 * span * (1 / low - 1 / high)) + 1)
        periods = 1 / torch.linspace(1 / high, 1 / low, count, dtype=torch.float64) / 3600
    starts = start.repeat(len(periods) * PHASES, 1)
    starts[:, columns["phase"]] = phases.repeat(len(periods))
    if "period" in columns:
        starts[:, columns["period"]] = periods.repeat_interleave(PHASES)
    return starts


def _put(model: LightCurve, start: torch.Tensor, numbers: dict[str, float]) -> torch.Tensor:
    return torch.tensor(
        [numbers.get(name, x) for name, x in zip(model.names, start.tolist(), strict=True)],
        dtype=torch.float64,
    )


def _rms(scene: Scene, recording: Recording, numbers: dict[str, float]) -> float:
    model = LightCurve(scene, recording)
    likelihood = Likelihood(model)
    with torch.no_grad():
        left = model(_put(model, model.parameter_set.start(), numbers)) - likelihood.observed
    return float(left[likelihood.measured].square().mean().sqrt())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+")
    given = parser.parse_args()
    scene = torchlc.load(given.scene)
    if not isinstance(scene.attitude.phase, Free):
        raise SystemExit(f"{given.scene}: attitude.phase is fixed; torchlc rotation writes it free")
    recording = joined([usable(scene, path) for path in given.recordings])
    for night in recording.night_ids:
        one = unseen(scene, recording, night)
        print(
            f"{one.night}: {one.rows} rows; predicted {one.predicted:.3f} mag rms, fitted {one.fitted:.3f} mag: "
            f"{one.predicted / one.fitted:.2f} times",
            flush=True,
        )


if __name__ == "__main__":
    main()
