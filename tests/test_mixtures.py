"""Effects that shine in proportion to reflectances: how much is solved for, and where the light goes is found."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from tests.small_case import write_case
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench, effect_columns
from torchlc.diagnosis.mixtures import APART_SD, FINER, FINER_PLACES, FINER_SD, Mixture, finer, spread_out
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


class Hill:
    """Values (a, b, size) of which a and b say where light goes. Their coordinates are log10 a and b / 10. Scores fall off with the
    distance from the nearest of some tops there, and sizes are solved for as 2 a. What was asked is kept."""

    WHERE = (0, 1)

    def __init__(self, *tops: tuple[float, float]) -> None:
        self.tops = torch.tensor(tops, dtype=torch.float64)
        self.asked: list[torch.Tensor] = []

    def coordinates(self, values: torch.Tensor) -> torch.Tensor:
        return torch.stack([torch.log10(values[:, 0]), values[:, 1] / 10.0, values[:, 2]], 1)

    def natural(self, g: torch.Tensor) -> torch.Tensor:
        return torch.stack([10.0 ** g[:, 0], 10.0 * g[:, 1], g[:, 2]], 1)

    def distance(self, values: torch.Tensor) -> torch.Tensor:
        """To the nearest top, (G,)."""
        return torch.cdist(self.coordinates(values)[:, :2], self.tops).amin(1)

    def solved(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        self.asked.append(values)
        solved = values.clone()
        solved[:, 2] = 2.0 * values[:, 0]
        return solved, solved @ torch.eye(3, 5, dtype=values.dtype), 100.0 - self.distance(values) ** 2

    def finer(self, begun: list[tuple[float, float]], seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
        g = torch.tensor([(*where, 7.0) for where in begun], dtype=torch.float64)
        values = self.natural(g)
        scores = 100.0 - self.distance(values) ** 2
        return finer(self.WHERE, values, scores, self.coordinates, self.natural, self.solved, seed)


def test_places_are_sought_about_the_best_and_come_nearer_the_top() -> None:
    """From half a standard deviation away to within a fifth, more often than not: by two rounds of twelve, in steps of 0.3 and 0.12."""
    nearest = []
    for seed in range(20):
        hill = Hill((1.0, -0.5))
        values, light = hill.finer([(1.4, -0.8)], seed)
        reached = hill.distance(values)
        assert 1 <= len(values) <= len(FINER_SD)
        assert bool((reached < 0.5).all()), "each is better than where it was begun"
        assert reached.tolist() == sorted(reached.tolist(), reverse=True), "and than the round before"
        nearest.append(float(reached[-1]))
        torch.testing.assert_close(values[:, 2], 2.0 * values[:, 0])  # the size as it was solved for
        torch.testing.assert_close(light[:, :3], values)  # and the light of the same values
        assert [len(asked) for asked in hill.asked] == [FINER] * len(FINER_SD)
        assert all(bool((asked[:, 2] == 7.0).all()) for asked in hill.asked), (
            "what is solved for is not moved"
        )
        again = Hill((1.0, -0.5)).finer([(1.4, -0.8)], seed)
        assert torch.equal(again[0], values)
        assert not torch.equal(Hill((1.0, -0.5)).finer([(1.4, -0.8)], seed + 1)[0], values)
    assert sorted(nearest)[10] < 0.2


def test_a_round_that_comes_to_nothing_better_is_left_out() -> None:
    """So near the top that the second round often is no better than the first: what is kept rises all the same."""
    for seed in range(20):
        hill = Hill((1.0, -0.5))
        values, _ = hill.finer([(1.1, -0.4)], seed)
        reached = hill.distance(values).tolist()
        assert reached == sorted(reached, reverse=True) and max(reached, default=0.0) < 0.1415


def test_rounds_are_as_wide_as_they_say_and_the_second_is_about_the_best_of_the_first() -> None:
    """In standard deviations of the priors, whatever the unit: twelve draws of two numbers in each of a hundred searches."""
    rounds: list[list[torch.Tensor]] = [[], []]
    for seed in range(100):
        hill = Hill((0.0, 3.0))  # so far that each round has a better place
        hill.finer([(0.0, 0.0)], seed)
        first, second = (hill.coordinates(asked)[:, :2] for asked in hill.asked)
        rounds[0].append(first)
        rounds[1].append(second - first[hill.distance(hill.asked[0]).argmin()])
    for offsets, sd in zip(rounds, FINER_SD, strict=True):
        together = torch.stack(offsets).flatten(0, 1)
        # a standard deviation of 1200 draws is known to a fiftieth
        assert together.std(0).tolist() == pytest.approx([sd, sd], rel=0.07)
        assert together.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.1 * sd)


def test_a_second_top_is_refined_beside_a_crowd_about_the_first() -> None:
    """Ten places within a hair of the best are one. A place that stands at a top already gets nothing in its stead."""
    crowd = [(0.01 * number, 0.0) for number in range(1, 11)]
    hill = Hill((0.0, 0.0), (3.0, 3.0))
    values, _ = hill.finer([*crowd, (3.3, 3.3)])
    assert [len(asked) for asked in hill.asked] == [2 * FINER] * len(FINER_SD)
    about_second = hill.coordinates(values)[:, 0] > 1.5
    assert bool(about_second.any()) and float(hill.distance(values[about_second]).min()) < 0.2
    alone = Hill((0.0, 0.0))
    values, light = alone.finer([(0.0, 0.0)])
    assert values.shape == (0, 3) and light.shape == (0, 5)


def test_no_more_than_the_best_few_places_are_refined() -> None:
    places = [(float(number), 0.0) for number in range(10)]
    hill = Hill((0.0, 0.0))
    values, _ = hill.finer(places[::-1])
    begun = hill.coordinates(hill.asked[0])[:, 0].reshape(-1, FINER).mean(1)
    assert begun.round().tolist() == [float(number) for number in range(FINER_PLACES)]
    # the worst of them are bettered too, though they stay behind the best
    assert bool((hill.coordinates(values)[:, 0] > 4.0).any())
