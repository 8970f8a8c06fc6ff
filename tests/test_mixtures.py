"""Effects that shine in proportion to reflectances: how much is solved for, and where the light goes is found."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from tests.small_case import write_case
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench, effect_columns
from torchlc.diagnosis.mixtures import APART_SD, Mixture, spread_out
from torchlc.diagnosis.probes import beyond, probe
from torchlc.inference.posterior import fit
from torchlc.readers import load_recording
from torchlc.scene import load_scene

PLATE = {"area": 0.3, "lon": 60.0, "lat": 65.0, "n": 40.0, "r_spec": 0.25, "r_diff": 0.35}
"""A plate that faces the Earth, half of its light in a lobe."""


@pytest.fixture(scope="module")
def search(tmp_path_factory: pytest.TempPathFactory) -> Search:
    """Of a scene whose recording has a plate that it lacks, beside the scene's own model."""
    folder = tmp_path_factory.mktemp("mixture")
    scene_file, recording_file = write_case(folder, noise=0.003)
    scene, recording = load_scene(scene_file), load_recording(recording_file, load_scene(scene_file))
    bench = Workbench(scene, recording)
    model = bench.likelihood(Hypothesis(("appendage",))).model
    theta = model.parameter_set.start()
    for name, value in PLATE.items():
        theta[model.names.index(f"appendage.{name}")] = value
    plain = bench.likelihood(Hypothesis()).model
    with torch.no_grad():
        more = (model(theta) - plain(plain.parameter_set.start())).numpy()
    recording = replace(recording, observed=recording.observed + more)
    found = Search(Workbench(scene, recording), Clock(None), 0)
    found.null()
    return found


def test_sizes_of_a_mixture_are_solved_for(search: Search) -> None:
    """At the plate's own normal and exponent, area times reflectance come out as they are, whatever is begun with; no other amount takes
    more off the residuals."""
    at = search.visited[Hypothesis().under(*search.robust)]
    posterior = search.posterior(at.hypothesis.with_effect("appendage"))
    parameters = posterior.model.parameter_set
    columns = effect_columns(parameters, "appendage")
    names = [parameters.free[one].origin.quantity for one in columns]
    mixture = Mixture.of("appendage", names)
    assert mixture is not None and [names[one] for one in mixture.where(len(names))] == ["lon", "lat", "n"]
    theta = parameters.start()[None]
    theta[:, [parameters.names.index(name) for name in at.names]] = at.theta

    def change(psi: torch.Tensor) -> torch.Tensor:
        many = theta.repeat(len(psi), 1)
        many[:, columns] = psi
        with torch.no_grad():
            return (at.delta - posterior.likelihood.residuals(many).delta) / at.sigma

    begun = torch.tensor([[PLATE[name] for name in names]], dtype=torch.float64)
    begun[:, names.index("area")], begun[:, names.index("r_spec")] = 3.0, 0.7
    values, moved = mixture.solved(begun, change, lambda light: beyond(light, at), at.residual_rows)
    found = dict(zip(names, values[0].tolist(), strict=True))
    assert {key: found[key] for key in ("lon", "lat", "n")} == {
        key: PLATE[key] for key in ("lon", "lat", "n")
    }
    left = at.residual_rows - beyond(moved, at)[0]
    for scale in (0.7, 1.3):
        other = at.residual_rows - scale * beyond(moved, at)[0]
        assert float(other.square().sum()) > float(left.square().sum())
    torch.testing.assert_close(moved, change(values))
    assert found["r_spec"] + found["r_diff"] <= 1.0


def test_a_plate_is_found_as_from_where_it_is(search: Search) -> None:
    """A fit from probes is as good as one that begins at the truth."""
    at = search.visited[Hypothesis().under(*search.robust)]
    hypothesis = at.hypothesis.with_effect("appendage")
    posterior = search.posterior(hypothesis)
    parameters = posterior.model.parameter_set
    theta = parameters.start()
    theta[[parameters.names.index(name) for name in at.names]] = at.theta
    for name, value in PLATE.items():
        theta[parameters.names.index(f"appendage.{name}")] = value
    best = fit(hypothesis, posterior, posterior.coordinates(theta[None]), turns=1)
    found = search.extend(at, "appendage", probe(search.bench, at, posterior, "appendage", 0))
    assert best.log_z > at.log_z + 20, "it is seen"
    assert found.log_z > best.log_z - 1.0


def test_places_that_are_kept_are_apart() -> None:
    g = torch.randn(200, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    kept = spread_out(g, 200)
    assert kept[0] == 0 and kept == sorted(kept)
    apart = torch.cdist(g[kept], g[kept]) + torch.eye(len(kept)) * 10
    assert float(apart.min()) >= APART_SD
    near = torch.cdist(g, g[kept])
    assert float(near.amin(1).max()) < APART_SD, "none that is left out stands apart from all"
    assert spread_out(g, 5) == kept[:5]


def test_what_is_no_mixture_has_none() -> None:
    assert Mixture.of("panel_offset", ["deg"]) is None
    assert Mixture.of("appendage", ["area", "lon", "lat", "n", "r_spec"]) is None, "a part of it is known"
