"""Calibration of the posterior: ranks judged against closed forms, a small one run, and the example resumed."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

import torchlc
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.sampler import sample

EXAMPLES = Path(__file__).parents[1] / "examples"
sys.path[:0] = [str(EXAMPLES / "paper"), str(EXAMPLES / "calibration")]

import ranks  # noqa: E402
import recovery  # noqa: E402
import setting  # noqa: E402


def rows(truth: np.ndarray, draws: np.ndarray) -> list[dict[str, object]]:
    """As a case tells them: the rank of each truth (M,) among its draws (M, N)."""
    return [
        {"rank": int((one < value).sum()), "informed": True} for value, one in zip(truth, draws, strict=True)
    ]


@pytest.mark.parametrize(("width", "uniform"), [(1.0, True), (0.7, False), (1.4, False)])
def test_ranks_tell_a_right_width_from_a_wrong_one(width, uniform):
    """Truths from N(0, 1), draws from N(0, width): a 90 % interval holds 2 Phi(1.645 width) - 1 of them."""
    rng = np.random.default_rng(0)
    found = ranks.judged("x", rows(rng.normal(size=4000), width * rng.normal(size=(4000, 199))), 199)["every"]
    assert (found["p"] > 1e-3) is uniform
    assert found["within_90"] == pytest.approx(2 * stats.norm.cdf(1.6449 * width) - 1, abs=0.02)
    assert found["within_50"] == pytest.approx(2 * stats.norm.cdf(0.6745 * width) - 1, abs=0.03)


def test_a_few_rows_are_not_judged():
    found = ranks.judged("x", rows(np.zeros(9), np.ones((9, 199))), 199)
    assert found["every"]["p"] is None and found["every"]["bins"][0] == 9


@pytest.mark.long
def test_truths_from_the_prior_are_ranked_evenly():
    """Two reflectances drawn from their triangle, 14 recordings of twelve rows, draws from their posteriors."""
    panel = {"n": 30.0, "r_spec": setting.FREE["r_spec"], "r_diff": setting.FREE["r_diff"]}
    scene = setting.object_1({"body": setting.TABLE_3[1]["body"], "panel": panel})
    grid = torchlc.simulate(scene, start="2020-10-17T14:00:00", hours=7.0, cadence=2280.0).recording
    grid = replace(grid, error=np.full(len(grid), 0.3))
    model = torchlc.LightCurve(scene, grid)
    truths = model.parameter_set.sample_prior(14, torch.Generator().manual_seed(1))
    rng = np.random.default_rng(2)
    found = []
    for seed, truth in enumerate(truths):
        with torch.no_grad():
            observed = model(truth).numpy() + 0.3 * rng.normal(size=len(grid))
        one = Likelihood(torchlc.LightCurve(scene, replace(grid, observed=observed)))
        posterior = sample(fit_map(one, starts=4, adam_steps=20), walkers=128, steps=100, seed=seed)
        draws = posterior.theta[:, 30 // posterior.thin :: max(1, 20 // posterior.thin)]
        found.append((draws.reshape(-1, 2) < truth).double().mean(0).numpy())
    for column in np.array(found).T:
        assert stats.kstest(column, stats.uniform.cdf).pvalue > 1e-3


@pytest.mark.long
def test_the_example_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    """Two cases in two runs, the second after a line cut short; then the figure and the numbers."""
    monkeypatch.setattr(recovery, "STEPS", (60, 60))
    results, out = tmp_path / "results.jsonl", tmp_path / "docs"

    def run(count: int) -> list[dict]:
        line = ["recovery.py", str(results), "--count", str(count), "--out", str(out)]
        monkeypatch.setattr(sys, "argv", line)
        recovery.main()
        return [json.loads(line) for line in results.read_text().splitlines() if line.endswith("}")]

    (first,) = run(1)
    assert set(first["parameters"]) >= {"body.n", "panel.r_diff", "zero_point"}
    assert all(0 <= row["rank"] <= recovery.DRAWS for row in first["parameters"].values())
    with results.open("a") as file:
        file.write('{"case": 1, "kind"\n')
    assert [one["case"] for one in run(2)] == [0, 1]
    assert "case 0" not in capsys.readouterr().out.split("case 1")[1]
    numbers = json.loads((out / "posterior.json").read_text())
    assert numbers["cases"] == 2 and numbers["all"]["every"]["count"] >= 14
    assert (out / "posterior.png").stat().st_size > 10_000
