"""One hypothesis: its light, slopes and evidence against finite differences, importance sampling and dense algebra."""

from __future__ import annotations

import pytest
import torch

from tests.conftest import DEMO
from torchlc.diagnosis.hypotheses import Hypothesis, Workbench
from torchlc.diagnosis.proof import log_density, make_blocks
from torchlc.inference.posterior import integrated
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import load_recording
from torchlc.scene import load_scene


@pytest.mark.long
def test_a_hypothesis_that_shares_tables_shines_as_one_that_stands_alone() -> None:
    scene = load_scene(DEMO / "scene.toml")
    recording = load_recording(DEMO / "recording.ecsv", scene)
    bench = Workbench(scene, recording)
    base = bench.likelihood(Hypothesis()).model
    base(base.parameter_set.start())  # its tables are there to be shared
    own = [effect.entry for effect in bench.base.effects]
    generator = torch.Generator().manual_seed(3)
    for entry in bench.candidates(None):
        model = bench.likelihood(Hypothesis((entry,))).model
        alone = LightCurve(scene, recording, assembly=assemble(scene, recording, [*own, entry]))
        theta = model.parameter_set.sample_prior(3, generator)
        with torch.no_grad():
            light = model(theta)
            torch.testing.assert_close(light, alone(theta), msg=entry)
            if entry == "interreflection":
                bare = base(theta[:, [model.names.index(name) for name in base.names]])
                assert float((light - bare).abs().max()) > 1e-6, "it does something here"


def test_slopes_and_curvature_are_those_of_finite_differences(demo_search) -> None:
    """At a minimum with outliers and a scale: slopes of residuals by central differences; the peak's gradient is 0, and its
    second differences along noise coordinates are the inverse of the covariance."""
    at = demo_search.visited[Hypothesis().under(*demo_search.robust)]
    posterior, step = at.posterior, 1e-4
    for column in range(posterior.size):
        axis = torch.zeros_like(at.g)
        axis[column] = step
        with torch.no_grad():
            moved = posterior.residuals(at.g + axis).delta - posterior.residuals(at.g - axis).delta
            up, middle, down = posterior.log_density(torch.stack([at.g + axis, at.g, at.g - axis]))
        slope = moved / (2 * step)
        torch.testing.assert_close(
            at.slopes[:, column], slope, rtol=1e-3, atol=1e-5 * float(slope.abs().max()) + 1e-9
        )
        sd = float(1 / torch.sqrt(torch.linalg.inv(at.covariance)[column, column]))
        assert abs(float(up - down)) / (2 * step) * sd < 0.2  # standard deviations from the top
        if column in posterior.noise_columns:
            curvature = -float(up - 2 * middle + down) / step**2
            assert curvature == pytest.approx(
                float(torch.linalg.inv(at.covariance)[column, column]), rel=0.05
            )


def test_laplace_and_importance_sampling_agree(demo_search) -> None:
    """Two estimators of one evidence; the demo's posterior is nearly normal: off by a tenth for each of its numbers at most."""
    found = integrated(demo_search.visited[Hypothesis()], 2000, 1)
    assert found.evidence is not None and found.evidence.error < 0.1
    laplace = demo_search.visited[Hypothesis()]
    assert found.log_z == pytest.approx(laplace.log_z, abs=0.1 * len(laplace.g))


def test_unseen_rows_have_the_density_of_the_dense_normal(demo_search) -> None:
    """N(0, S + J C J') of a block written out with full matrices; the product of rows' densities under a mixture without
    outliers is the same."""
    at = demo_search.visited[Hypothesis()]
    rows = torch.arange(20, 60)
    slopes = at.slopes[rows]
    dense = torch.diag(at.wide[rows] ** 2) + slopes @ at.covariance @ slopes.T
    expected = torch.distributions.MultivariateNormal(torch.zeros(40).double(), dense).log_prob(
        at.delta[rows]
    )
    assert float(log_density(at, at, rows)) == pytest.approx(float(expected), abs=1e-6)
    seconds, curve = at.model.assembly.context.seconds, at.likelihood.curve
    blocks = make_blocks(seconds, curve)
    assert torch.equal(torch.sort(torch.cat([one for one, _ in blocks])).values, torch.arange(len(seconds)))
