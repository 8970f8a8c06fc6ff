"""The ensemble: against posteriors known in closed form or on a grid, and killed and resumed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import arviz
import emcee
import numpy as np
import pytest
import torch
from scipy import stats

import torchlc
from tests.small_case import write_case
from torchlc.errors import InputError
from torchlc.inference.ensemble import moves
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior_draws import Posterior
from torchlc.inference.sampler import sample

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples" / "paper"))

import setting  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
BODY = setting.TABLE_3[1]["body"]
NIGHT = {"start": "2020-10-17T14:00:00", "hours": 7.0, "cadence": 1200.0}


def night(scene, noise=0.02, seed=1):
    """A recording of Object 1 with Table 3's materials."""
    curve = torchlc.simulate(setting.object_1(), **NIGHT, noise=noise, seed=seed)
    columns = {name: np.asarray(curve.columns[name]) for name in ("mag", "mag_err")}
    return replace(curve.recording, observed=columns["mag"], error=columns["mag_err"])


def independent(posterior: Posterior, column: int) -> np.ndarray:
    """Draws about two autocorrelation times apart, so that they may be tested as independent."""
    apart = max(1, int(np.ceil(2 * posterior.tau[column] / posterior.thin)))
    return posterior.theta[:, ::apart, column].reshape(-1).numpy()


def with_zero_point(scene: torchlc.Scene) -> torchlc.Scene:
    line = "[model.parameters]\nzero_point = { value = 0.0, sigma = 0.05 }"
    return torchlc.Scene.from_toml(scene.to_toml().replace("[model.parameters]", line))


def test_a_zero_point_alone_has_a_normal_posterior():
    scene = with_zero_point(setting.object_1())
    recording = night(scene)
    posterior = sample(fit_map(Likelihood(torchlc.LightCurve(scene, recording))), seed=0)
    residual = recording.observed - torchlc.simulate(setting.object_1(), recording).mag
    precision = (recording.error**-2).sum() + 0.05**-2
    mean, sd = (residual / recording.error**2).sum() / precision, precision**-0.5
    assert posterior.converged
    draws = independent(posterior, 0)
    assert len(draws) > 500
    assert stats.kstest(draws, stats.norm(mean, sd).cdf).pvalue > 1e-3


def test_two_reflectances_have_the_posterior_of_a_grid():
    """r_spec and r_diff of the panel on a fine grid: density, triangle, Jacobian of its coordinates."""
    panel = {"n": 154.244, "r_spec": setting.FREE["r_spec"], "r_diff": setting.FREE["r_diff"]}
    scene = setting.object_1({"body": BODY, "panel": panel})
    likelihood = Likelihood(torchlc.LightCurve(scene, night(scene, noise=0.5)))
    posterior = sample(fit_map(likelihood), seed=0)
    spec = torch.linspace(0, 0.1, 401, dtype=torch.float64)
    diff = torch.linspace(0, 0.2, 401, dtype=torch.float64)
    with torch.no_grad():
        log = likelihood.log_prob(torch.cartesian_prod(spec, diff)).reshape(401, 401)
    density = torch.exp(log - log.max())
    assert float(density[-1].max()) < 1e-4 and float(density[:, -1].max()) < 1e-4  # all within the grid
    for column, (axis, marginal) in enumerate([(spec, density.sum(1)), (diff, density.sum(0))]):
        steps = 0.5 * (marginal[1:] + marginal[:-1])
        cdf = np.concatenate([[0.0], torch.cumsum(steps, 0).numpy()]) / float(steps.sum())
        draws = independent(posterior, column)
        test = stats.kstest(draws, lambda x, axis=axis, cdf=cdf: np.interp(x, axis.numpy(), cdf))
        assert len(draws) > 300 and test.pvalue > 1e-3


def test_a_short_chain_from_a_bound_has_the_posterior_of_a_grid():
    """Beside a body that is too bright the best reflectance of the panel is 0, where the search leaves it a
    billionth of its range: walkers begin apart there."""
    panel = {"n": 154.244, "r_spec": setting.FREE["r_spec"], "r_diff": setting.FREE["r_diff"]}
    brighter = {**BODY, "r_diff": BODY["r_diff"] + 0.3}
    scene = setting.object_1({"body": brighter, "panel": panel})
    likelihood = Likelihood(torchlc.LightCurve(scene, night(scene, noise=0.1)))
    found = fit_map(likelihood)
    parameters, best = likelihood.model.parameter_set, found.modes[0]
    assert best.at_bound.tolist() == [False, True]
    theta = parameters.to_natural(parameters.to_unconstrained(best.theta))
    assert 0 < float(theta[1]) < 1.1e-9
    drawn = independent(sample(replace(found, modes=[replace(best, theta=theta)]), steps=300, seed=0), 1)
    spec = torch.linspace(0.02, 0.04, 201, dtype=torch.float64)
    diff = torch.linspace(0, 0.004, 801, dtype=torch.float64)
    with torch.no_grad():
        log = likelihood.log_prob(torch.cartesian_prod(spec, diff)).reshape(201, 801)
    marginal = torch.exp(log - log.max()).sum(0)
    assert float(marginal[-1] / marginal.max()) < 1e-3, "all within the grid"
    error = float(drawn.std()) / np.sqrt(len(drawn))
    assert error < 0.1 * float(drawn.mean()), "the chain says something"
    assert float(drawn.mean()) == pytest.approx(float(marginal @ diff / marginal.sum()), abs=4 * error)


@pytest.mark.long
def test_data_that_say_nothing_give_the_prior_back():
    """Errors of 1000 mag: n is log-uniform, and the reflectances are uniform on their triangle."""
    scene = setting.object_1({"body": BODY, "panel": setting.FREE})
    recording = night(scene)
    blind = replace(recording, error=np.full(len(recording), 1e3))
    posterior = sample(fit_map(Likelihood(torchlc.LightCurve(scene, blind))), seed=0)
    names = posterior.names
    log_n = np.log10(independent(posterior, names.index("panel.n")))
    assert stats.kstest(log_n, stats.uniform(0, 6).cdf).pvalue > 1e-3
    for name in ("panel.r_spec", "panel.r_diff"):
        draws = independent(posterior, names.index(name))
        assert stats.kstest(draws, stats.beta(1, 2).cdf).pvalue > 1e-3


def test_every_move_leaves_a_normal_distribution_as_it_is():
    """Independent draws of N(0, s) in seven dimensions, moved by one kind at a time, keep variance and shape."""
    scene = with_zero_point(setting.object_1())
    chosen = moves(fit_map(Likelihood(torchlc.LightCurve(scene, night(scene)))))
    assert len(chosen) == 3
    sd = np.geomspace(0.1, 10.0, 7)
    for move, _ in chosen:
        sampler = emcee.EnsembleSampler(
            2000, 7, lambda x: -0.5 * ((x / sd) ** 2).sum(-1), moves=move, vectorize=True
        )
        state = np.random.RandomState(1)
        start = emcee.State(sd * state.standard_normal((2000, 7)), random_state=state.get_state())
        end = sampler.run_mcmc(start, 100)
        assert end is not None
        for column in (end.coords / sd).T:
            assert stats.kstest(column, stats.norm.cdf).pvalue > 1e-3, type(move)


@pytest.mark.long
def test_modes_are_all_visited_and_weighed():
    """A cube turned by a quarter looks as before: the prior alone weighs the quarters."""
    text = (
        setting.cube(attitude=2, n=30.0)
        .to_toml()
        .replace("x_angle = 30.0", "x_angle = { value = 5.0, sigma = 40.0 }")
    )
    scene = torchlc.Scene.from_toml(text)
    recording = night(scene)
    model = torchlc.LightCurve(scene, recording)
    turned = torch.tensor(
        [[40.0], [40.0 - 90.0]], dtype=torch.float64
    )  # a cube: every quarter turn looks alike
    with torch.no_grad():
        same = model(turned).numpy()
    np.testing.assert_allclose(same[0], same[1], rtol=1e-9)
    observed = same[0] + 0.02 * np.random.default_rng(1).normal(size=len(recording))
    likelihood = Likelihood(torchlc.LightCurve(scene, replace(recording, observed=observed)))
    posterior = sample(fit_map(likelihood), steps=800, seed=0)
    angle = posterior.flat[:, 0]
    share = {k: float(((angle - 40.0 + 90.0 * k).abs() < 5).double().mean()) for k in range(3)}
    prior = {k: stats.norm(5.0, 40.0).pdf(40.0 - 90.0 * k) for k in range(3)}
    for k in range(3):
        assert share[k] == pytest.approx(prior[k] / sum(prior.values()), abs=0.12)


# ------------------------------------------------------------------ killed and resumed


def sampled(chain: Path, steps: int, *, resume: bool = False) -> None:
    """A chain of 32 walkers over three numbers."""
    scene = setting.object_1({"body": BODY, "panel": setting.FREE})
    found = fit_map(Likelihood(torchlc.LightCurve(scene, night(scene))), starts=2, adam_steps=20)
    sample(found, steps=steps, walkers=32, seed=5, chain_file=chain, resume=resume)


def chain_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    backend = emcee.backends.HDFBackend(str(path), name="mcmc", read_only=True)
    return backend.get_chain(), backend.get_log_prob()


@pytest.mark.long
def test_a_killed_chain_resumes_to_the_same_end(tmp_path):
    """SIGKILL once the first block is on disk; resumed, the chain is the undisturbed one to the bit."""
    whole, broken = tmp_path / "whole.h5", tmp_path / "broken.h5"
    steps = 300
    sampled(whole, steps)
    code = f"from pathlib import Path; from tests.test_sample import sampled; sampled(Path({str(broken)!r}), {steps})"
    run = subprocess.Popen([sys.executable, "-W", "ignore", "-c", code], cwd=ROOT)
    deadline = time.monotonic() + 120
    while not broken.exists() and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    assert 0 < len(chain_of(broken)[0]) < steps
    sampled(broken, steps, resume=True)
    for one, other in zip(chain_of(whole), chain_of(broken), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_chain_of_another_problem_is_refused(tmp_path):
    scene = with_zero_point(setting.object_1())
    chain = tmp_path / "chain.h5"
    sample(fit_map(Likelihood(torchlc.LightCurve(scene, night(scene)))), steps=200, chain_file=chain)
    other = setting.object_1({"body": BODY, "panel": setting.FREE})
    found = fit_map(Likelihood(torchlc.LightCurve(other, night(other))), starts=2, adam_steps=5)
    with pytest.raises(InputError, match=r"chain of 32 walkers over zero_point"):
        sample(found, steps=400, chain_file=chain, resume=True)


def test_too_few_walkers_are_refused():
    scene = setting.object_1({"body": BODY, "panel": setting.FREE})
    found = fit_map(Likelihood(torchlc.LightCurve(scene, night(scene))), starts=2, adam_steps=5)
    with pytest.raises(InputError, match="at least 8 for 3 parameters"):
        sample(found, walkers=4)


def test_the_seed_decides_the_chain():
    scene = with_zero_point(setting.object_1())
    found = fit_map(Likelihood(torchlc.LightCurve(scene, night(scene))))
    first, second, other = (sample(found, steps=200, seed=seed).theta for seed in (1, 1, 2))
    assert torch.equal(first, second) and not torch.equal(first, other)


def test_walkers_that_disagree_do_not_pass_for_a_converged_chain():
    """Independent normal draws give 1 (Vehtari et al. 2021, section 4), and all of them count; a shift of one standard
    deviation in half of the walkers is a variance between chains of 0.25: sqrt(1 + 0.25) = 1.12."""
    generator = torch.Generator().manual_seed(0)
    draws = torch.randn(32, 400, 1, generator=generator, dtype=torch.float64)

    def posterior(theta):
        return Posterior(["x"], theta, theta[..., 0], np.ones(1), 0.3, 400, 0, 1)

    assert posterior(draws).rhat[0] == pytest.approx(1.0, abs=0.002)  # 1 / 400 of the 12,800 draws
    assert posterior(draws).ess[0] == pytest.approx(32 * 400, rel=0.1)  # a few times 1 / sqrt(12,800)
    assert posterior(draws).converged
    shifted = draws.clone()
    shifted[:16] += 1.0
    assert posterior(shifted).rhat[0] == pytest.approx(np.sqrt(1.25), abs=0.02)  # ranks are not quite normal
    assert not posterior(shifted).converged and "R-hat up to 1.1" in posterior(shifted).reason
    assert not posterior(draws[:, :3]).converged and "too few draws to say" in posterior(draws[:, :3]).reason


def test_the_advice_about_a_short_chain_is_one_that_can_be_followed(tmp_path: Path, caplog):
    """There is something to resume only where the chain was kept; a budget is not lengthened by more steps."""
    scene, recording = write_case(tmp_path)

    def advice(**settings) -> str:
        (told,) = (
            text
            for text in torchlc.fit(scene, recording, **settings).warnings
            if "the chain is short" in text
        )
        return told

    assert advice(steps=3).endswith("at most 1.03: fit with more steps")
    assert advice(budget=1e-3).endswith("at most 1.03: fit with a longer budget")
    assert advice(steps=3, out=tmp_path / "out").endswith(": run on with resume=True and more steps")
    resumed = torchlc.fit(scene, recording, steps=5, out=tmp_path / "out", resume=True)
    assert resumed.posterior is not None and resumed.posterior.steps == 5
    assert advice(budget=1e-3, out=tmp_path / "out").endswith(": run on with resume=True and a longer budget")
    assert not caplog.records  # of ArviZ, for which these chains are too short


@pytest.mark.long
@pytest.mark.parametrize("steps", [3, 60, 2000])
def test_what_is_told_of_a_chain_is_what_arviz_says_of_the_exported_one(steps: int, tmp_path: Path):
    """fit.json, the table of the report and the sentence against arviz.summary of posterior.nc."""
    scene, recording = write_case(tmp_path)
    result = torchlc.fit(scene, recording, steps=steps, seed=1, out=tmp_path / "out")
    told = json.loads((tmp_path / "out" / "fit.json").read_text())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what ArviZ says of very short chains
        summary = arviz.summary(arviz.from_netcdf(tmp_path / "out" / "posterior.nc"), round_to="none")
    assert set(summary.index) == set(told["parameters"])
    page = (tmp_path / "out" / "report.html").read_text()
    for name, row in summary.iterrows():
        parameter = told["parameters"][name]
        if steps == 3:
            assert np.isnan(row["r_hat"]) and parameter["rhat"] is None
            continue
        assert parameter["rhat"] == row["r_hat"] and parameter["ess"] == row["ess_bulk"]
        assert f">{row['r_hat']:.3f}<" in page and f">{row['ess_bulk']:.0f}<" in page
    worst = float(summary["r_hat"].max())
    assert told["converged"] is (steps == 2000) and told["converged"] is result.converged
    if steps == 2000:
        assert worst <= 1.03 and f"R-hat up to {worst:.3f}" in told["reason"]
    else:
        assert not worst <= 1.1
        assert any("the chain is short" in text for text in told["warnings"])
