"""Passes that follow one of two models: the mixture's density against SciPy, and what is found of passes made with two known surfaces."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import norm

EXAMPLES = Path(__file__).parents[1] / "examples" / "fleets"
sys.path.insert(0, str(EXAMPLES))

import modes  # noqa: E402
import observers  # noqa: E402

from tests.effects.passes import BODY, MATERIALS, magnitudes, orbiting, rows  # noqa: E402

DIFFUSE = (0.15, 0.6)
"""Reflectance of the body in either mode: 0.8 mag apart, more or less with the share of the lobe."""
OBJECTS, SCATTER = 12, 0.05


def test_the_density_of_a_mixture_of_passes_is_that_of_products_of_normal_densities():
    random = np.random.default_rng(1)
    delta, group = random.normal(size=(2, 9)), np.array([0, 0, 1, 2, 2, 2, 2, 1, 0])
    found = modes.log_mixture(delta, group, 0.3, (0.5, 2.0))
    for mode, (share, sigma) in enumerate(((0.3, 0.5), (0.7, 2.0))):
        expected = [share * norm.pdf(delta[mode, group == k], scale=sigma).prod() for k in range(3)]
        np.testing.assert_allclose(np.exp(found[mode]), expected, rtol=1e-12)


def test_the_nearest_rows_are_those_of_other_members():
    """Against SciPy's k-d tree of the rows of all other members, for each row."""
    random = np.random.default_rng(2)
    columns, member = random.normal(size=(3, 80)) * [[1.0], [5.0], [0.2]], random.integers(9, size=80)
    bright = random.random(80) < 0.4
    scaled = (columns / columns.std(1)[:, None]).T
    expected = []
    for row in range(80):
        others = member != member[row]
        near = cKDTree(scaled[others]).query(scaled[row], observers.NEIGHBOURS)[1]
        expected.append(bright[others][near].mean())
    np.testing.assert_allclose(observers.of_neighbours(columns, bright, member), expected, rtol=1e-12)


@pytest.fixture(scope="module")
def passes():
    """A scene whose diffuse reflectance is free, and a night of objects whose mode is drawn anew every hour; the mode of each row."""
    random = np.random.default_rng(5)
    truths = [
        orbiting(components=BODY, materials=MATERIALS.replace("r_diff = 0.35", f"r_diff = {one}"))
        for one in DIFFUSE
    ]
    recording = rows(truths[0], hours=8.0, cadence_s=150.0)
    hour = np.floor(recording.seconds / 3600).astype(int)
    number = (3 * hour + np.arange(len(recording)) % 3) % OBJECTS
    _, group = np.unique(np.stack([number, hour]), axis=1, return_inverse=True)
    second = random.random(group.max() + 1) < 0.4
    light = np.where(second[group.ravel()], *(magnitudes(one, recording) for one in truths[::-1]))
    scene = orbiting(
        components=BODY,
        materials=MATERIALS.replace("r_diff = 0.35", "r_diff = { value = 0.35, low = 0.0, high = 1.0 }"),
    )
    return scene, replace(
        recording,
        observed=light + SCATTER * random.normal(size=len(recording)),
        error=np.full(len(recording), SCATTER),
        object=number,
        object_ids=tuple(f"sat {k}" for k in range(OBJECTS)),
    ), second  # fmt: skip


@pytest.fixture(scope="module")
def told(passes):
    return modes.modes(*passes[:2], folds=2)


def test_each_pass_is_told_its_mode_and_each_mode_its_surface(passes, told):
    # the brighter passes begin as the first, and these are of the second surface
    assert told["first_passes"] == passes[2].sum()
    fitted = [values["foil.r_diff"] for values in told["parameters"]]
    assert fitted == pytest.approx(DIFFUSE[::-1], rel=0.02)  # 100 rows of 5 % each
    assert told["sigma"] == pytest.approx(
        [SCATTER] * 2, rel=0.2
    )  # 1 / sqrt(2 * 80 rows) is 8 %, of a robust sigma 13 %


def test_what_is_gained_of_unseen_satellites_is_what_one_model_misses(told):
    """One model of two modes 1 mag apart leaves half of that; the scatter alone is left where the mode is known."""
    assert told["unseen_in_its_mode"] == pytest.approx(SCATTER, rel=0.2)
    assert told["unseen_one_model"] > 5 * SCATTER
    assert (
        told["log_density_gained"] > 5 * told["standard_error"] > 0
    )  # 25 passes: chance would be below 1e-4 of Student's t
