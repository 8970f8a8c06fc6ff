"""Several objects of one design in one fit: an offset of each, from a population whose spread is learnt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm

import torchlc
from tests.effects.passes import magnitudes, model_with, orbiting, rows
from torchlc.diagnosis.hypotheses import Hypothesis
from torchlc.diagnosis.proof import log_density, make_blocks, unseen
from torchlc.errors import InputError
from torchlc.files.numbers import Free
from torchlc.inference.density import Posterior
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.posterior import fitted_at
from torchlc.inference.whitening import whitener
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.draw import draw
from torchlc.noise.object_scatter import Shared
from torchlc.readers import Recording
from torchlc.readers.recording import load_recording
from torchlc.stages.noise import Noise
from torchlc.tensors.least_squares import differences

SCENE = orbiting()
SPREAD, ERROR, OBJECTS = 0.3, 0.05, 24


def fleet(scene=SCENE, spread=SPREAD, count=OBJECTS, seed=0, error=ERROR, cadence_s=600.0):
    """The scene's light at its rows, dealt at random to objects with offsets of a known spread; and the offsets."""
    random = np.random.default_rng(seed)
    recording = rows(scene, cadence_s=cadence_s)
    number = random.integers(count, size=len(recording))
    number[:count] = np.arange(count)
    offset = spread * random.normal(size=count)
    observed = magnitudes(scene, recording) + offset[number] + error * random.normal(size=len(recording))
    return replace(
        recording,
        observed=observed,
        error=np.full(len(recording), error),
        object=number,
        object_ids=tuple(f"sat {k}" for k in range(count)),
    ), offset


def marginal(residual, error, *groups):
    """Log density of residuals by SciPy: white errors, and for each (numbers, spread) one offset a member."""
    covariance = np.diag(np.broadcast_to(error, residual.shape) ** 2)
    for number, spread in groups:
        covariance = covariance + spread**2 * (number[:, None] == number)
    return multivariate_normal(np.zeros(len(residual)), covariance).logpdf(residual)


def test_the_offset_of_each_object_is_integrated_out():
    recording, _ = fleet()
    model, theta = model_with(SCENE, recording, "object_scatter", object_scatter__mag=0.2)
    likelihood = Likelihood(model)
    residual = recording.observed - magnitudes(SCENE, recording)
    expected = marginal(residual, ERROR, (recording.object, 0.2))
    assert float(likelihood.log_likelihood(theta)) == pytest.approx(expected, rel=1e-11)
    batch = likelihood.log_likelihood(torch.stack([theta, theta]))
    torch.testing.assert_close(batch, batch[:1].expand(2), rtol=1e-13, atol=0)


def test_objects_and_other_groups_that_cross():
    """Rows that a chain of objects and nights links have one covariance."""
    recording, _ = fleet(count=6)
    night = np.random.default_rng(1).integers(3, size=len(recording))
    model, theta = model_with(SCENE, recording, "object_scatter", object_scatter__mag=0.3)
    nightly = Shared("nights", torch.tensor(0.1, dtype=torch.float64), torch.from_numpy(night))
    residual = recording.observed - magnitudes(SCENE, recording)
    expected = marginal(residual, ERROR, (recording.object, 0.3), (night, 0.1))
    noise = model.noise(theta).with_process(nightly)
    assert float(Likelihood(model).log_likelihood(theta, noise)) == pytest.approx(expected, rel=1e-10)


def test_beside_noise_that_rows_of_a_curve_share():
    """Red noise links the rows of each curve, objects link curves."""
    recording, _ = fleet(count=6)
    curve = np.arange(len(recording)) % 2
    recording = replace(recording, curve=curve, curve_ids=("a", "b"))
    values = {"object_scatter__mag": 0.3, "red_noise__mag": 0.1, "red_noise__tau_min": 40.0}
    model, theta = model_with(SCENE, recording, "object_scatter", "red_noise", **values)
    residual = recording.observed - magnitudes(SCENE, recording)
    minutes = recording.seconds / 60
    x = np.sqrt(3) * np.abs(minutes[:, None] - minutes) / 40.0
    covariance = ERROR**2 * np.eye(len(x)) + 0.09 * (recording.object[:, None] == recording.object)
    covariance += 0.01 * (1 + x) * np.exp(-x) * (curve[:, None] == curve)
    expected = multivariate_normal(np.zeros(len(x)), covariance).logpdf(residual)
    assert float(Likelihood(model).log_likelihood(theta)) == pytest.approx(expected, rel=1e-10)


def test_whitened_rows_are_in_the_order_of_the_recording():
    """Of unit variance and uncorrelated: their sum of squares is the quadratic form of the covariance."""
    recording, _ = fleet()
    model, theta = model_with(SCENE, recording, "object_scatter", object_scatter__mag=SPREAD)
    likelihood = Likelihood(model)
    found = likelihood.residuals(theta)
    white = whitener(likelihood, found, model.noise(theta))(found).numpy()
    delta = found.delta.numpy()
    covariance = ERROR**2 * np.eye(len(delta)) + SPREAD**2 * (recording.object[:, None] == recording.object)
    assert white @ white == pytest.approx(delta @ np.linalg.solve(covariance, delta), rel=1e-10)
    alone = np.bincount(recording.object) == 1
    lonely = np.flatnonzero(alone[recording.object])
    np.testing.assert_allclose(white[lonely], delta[lonely] / np.hypot(ERROR, SPREAD), rtol=1e-10)


def test_a_spread_that_is_known_is_found():
    """The most probable zero point and spread are those that SciPy finds of the marginal density with the priors, to 1 % of the
    spread, for both searches stop where the density is flat; and the spread is that of the offsets within 3 of its standard deviations."""
    scene = _with_zero_point(SCENE)
    recording, offset = fleet(seed=3, cadence_s=300.0)
    model = LightCurve(scene, recording)
    assert model.names == ["zero_point", "object_scatter.mag"]  # no value for each object
    zero_point, spread = fit_map(Likelihood(model), starts=2, adam_steps=20).theta.tolist()
    bare = recording.observed - magnitudes(SCENE, recording)

    def cost(x):
        prior = norm.logpdf(x[0]) + norm.logpdf(x[1], scale=0.5)
        return -marginal(bare - x[0], ERROR, (recording.object, x[1])) - prior

    best = minimize(cost, [0.0, 0.2], method="Nelder-Mead").x
    np.testing.assert_allclose([zero_point, spread], best, atol=0.01 * SPREAD)
    assert abs(spread - offset.std()) < 3 * offset.std() / np.sqrt(2 * OBJECTS)


def test_unseen_objects_are_scored_with_the_spread():
    """Blocks are whole objects, and their density is that of the marginal distribution with what the fit knows."""
    recording, _ = fleet()
    model, theta = model_with(SCENE, recording, "object_scatter", object_scatter__mag=SPREAD)
    group = model.assembly.context.object
    assert group is not None
    blocks = make_blocks(model.assembly.context.seconds, group)
    held = [set(recording.object[rows.numpy()]) for rows, _ in blocks]
    assert sum(map(len, held)) == OBJECTS  # none in two blocks
    posterior = Posterior(Likelihood(model), False)
    at = fitted_at(Hypothesis(), posterior, posterior.coordinates(theta))
    physical = torch.tensor(posterior.physical, dtype=torch.long)
    one = blocks[0][0]
    slopes = at.slopes[one][:, physical].numpy()
    known = slopes @ at.covariance[physical][:, physical].numpy() @ slopes.T
    same = recording.object[one.numpy()][:, None] == recording.object[one.numpy()]
    covariance = known + ERROR**2 * np.eye(len(one)) + SPREAD**2 * same
    delta = at.delta[one].numpy()
    expected = multivariate_normal(np.zeros(len(one)), covariance).logpdf(delta)
    assert float(log_density(at, at, one)) == pytest.approx(expected, rel=1e-9)


def test_an_offset_of_an_unseen_curve_is_known_by_its_prior_alone():
    """Whole curves are left out, each with a zero point of its own: the density of each block is SciPy's of the marginal distribution over
    the prior, and what is left of its rows is all of their offset."""
    sigma = 0.4
    zero_point = Free(value=0.0, sigma=sigma, prior="normal", per="curve")
    scene = SCENE.model_copy(
        update={
            "model": SCENE.model.model_copy(
                update={"parameters": {**SCENE.model.parameters, "zero_point": zero_point}}
            )
        }
    )
    whole, _ = fleet(count=6)
    recording = replace(whole, object=None, object_ids=(), curve=whole.object, curve_ids=whole.object_ids)
    model = LightCurve(scene, recording)
    assert len(model.names) == 6
    at = fitted_at(
        Hypothesis(),
        Posterior(Likelihood(model), False),
        torch.as_tensor(np.random.default_rng(1).normal(size=6)),
    )
    blocks = make_blocks(model.assembly.context.seconds, model.assembly.context.curve)
    bare = recording.observed - magnitudes(SCENE, recording)
    scored = unseen(at, blocks)
    for (block, _), density in zip(blocks, scored.log_density.tolist(), strict=True):
        some = block.numpy()
        expected = marginal(bare[some], ERROR, (recording.curve[some], sigma))
        assert density == pytest.approx(
            expected, rel=1e-6
        )  # coordinates are 0 to rounding; slopes are differences
    assert scored.rms == pytest.approx(np.sqrt(np.mean(bare**2)), rel=1e-6)


def test_scatter_between_objects_is_not_named_as_physics():
    """Offsets of 0.4 mag between objects, and effects that follow airmass and time: what differs from object to object at random is
    none of them."""
    recording, _ = fleet(spread=0.4, count=12, seed=5, cadence_s=300.0)
    scene = _with_zero_point(SCENE)
    names = ["extinction_residual", "zero_point_drift"]
    found = torchlc.diagnose(scene, recording, effects=names, quick=True, seed=0).to_json()
    assert found["verdict"] != "missing_physics"
    assert not set(found["named"]) & set(names)


def test_draws_of_a_fleet():
    """Offsets of 400 objects of 5 rows: their standard deviation is the spread to 3 of its own, spread / sqrt(2 N)."""
    number = torch.arange(2000) % 400
    noise = Noise().with_process(
        Shared("object_scatter", torch.tensor([SPREAD], dtype=torch.float64), number)
    )
    quoted = torch.full((2000,), 1e-6, dtype=torch.float64)
    delta = draw(noise, quoted, torch.zeros(2000, dtype=torch.long), np.random.default_rng(2))
    each = delta.reshape(5, 400)
    assert float(each.std(0).max()) < 1e-4  # one offset for all rows of an object
    assert abs(float(each[0].std()) - SPREAD) < 3 * SPREAD / np.sqrt(800)


def test_without_objects_it_is_refused():
    with pytest.raises(InputError, match="which object a row belongs to"):
        LightCurve(_with_zero_point(SCENE), rows(SCENE))


def _with_zero_point(scene):
    """The scene with a zero point of each object."""
    number = torchlc.scene.Free(value=0.0, sigma=1.0, prior="normal", per="object")
    parameters = {**scene.model.parameters, "zero_point": number}
    return scene.model_copy(update={"model": scene.model.model_copy(update={"parameters": parameters})})


TABLE = "time,mag,mag_err,{}\n" + "".join(
    f"2024-01-01T0{k}:00:00,{6 + 0.1 * k},0.1,{name}\n" for k, name in enumerate("abacb")
)


@pytest.mark.parametrize("column", ["object", "satellite_name", "Satellite", "norad_cat_id"])
def test_a_recording_says_which_object_a_row_is(tmp_path, column):
    path = tmp_path / "fleet.csv"
    path.write_text(TABLE.format(column))
    recording = load_recording(path)
    assert [recording.object_ids[k] for k in recording.object] == list("abacb")
    kept = recording.keep(recording.object != 0, "test")
    assert [kept.object_ids[k] for k in kept.object] == list("bcb") and len(kept.object_ids) == 2
    again = Recording.from_table(recording.to_table())
    assert again.object_ids == recording.object_ids and (again.object == recording.object).all()
    other = load_recording(path, columns="object=b")
    assert len(other) == 2 and other.dropped == {"of another object": 3}


def test_a_column_of_another_name_is_told(tmp_path):
    path = tmp_path / "fleet.csv"
    path.write_text(TABLE.format("craft"))
    assert load_recording(path).object is None
    assert load_recording(path, columns="objects=craft").object_ids == ("a", "b", "c")


def test_the_slope_of_a_held_coordinate_is_none():
    """Residuals of two batches may differ by rounding, which is no slope: a coordinate that cannot move has 0."""

    def residual(y):
        return torch.stack([3 * y[:, 0], 1.0 + 1e-16 * len(y) * 1e3 + 0 * y[:, 1]], -1)

    y, low, high = (torch.tensor(one, dtype=torch.float64) for one in ([[1.0, 2.0]], [0.0, 2.0], [5.0, 2.0]))
    slopes = differences(residual, y, low, high)
    torch.testing.assert_close(
        slopes, torch.tensor([[[3.0, 0.0], [0.0, 0.0]]], dtype=torch.float64), rtol=1e-6, atol=1e-3
    )
    assert (slopes[..., 1] == 0).all()
