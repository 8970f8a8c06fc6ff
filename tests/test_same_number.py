"""One theta, one number: whatever was asked before, alone or in a batch, with or without gradients.

Sums of the same terms in another order differ in their last digits, hence 1e-11 of the brightest row.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.effects.cases import seen_from, still, unit
from tests.effects.passes import BODY, CELLS, LOW_PASS, TUMBLING, WINGS, orbiting, rows
from tests.effects.test_finite_sun import CYLINDER
from tests.paper_orbits import LOW
from tests.test_gradients import FREE_FOIL, SIZED, clocked, flux, many_boxes, shaped, tumbling
from torchlc.brdf.ashikhmin_shirley import AshikhminShirley
from torchlc.lightcurve.model import LightCurve
from torchlc.readers import Recording
from torchlc.scene import Scene

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
SAME = 1e-11
WING = (BODY + WINGS, FREE_FOIL + CELLS)
LOBE = (
    '[materials.white]\nn = { value = 50.0, low = 1.0, high = 1e6, prior = "loguniform" }\n'
    "r_spec = { value = 0.3, low = 0.0, high = 1.0 }\nr_diff = { value = 0.1, low = 0.0, high = 1.0 }\n"
)


def turning(components: str, materials: str, *effects: str, count: int = 8):
    scene = orbiting(TUMBLING, components, materials)
    return scene, tumbling(scene, count), effects


def low(components: str, materials: str, *effects: str):
    scene = orbiting(TUMBLING, components, materials, tle=LOW)
    return scene, rows(scene, LOW_PASS, 0.16, 72.0), effects


CASES = {
    "kept": lambda: turning(*WING),
    "kept, tabulated": lambda: turning(many_boxes(), FREE_FOIL),
    "kept, of very many pairs": lambda: turning(CYLINDER, LOBE, "finite_sun", count=700),
    "kept, lit by the Earth": lambda: low(*WING, "earthshine", "earth_shadow", "self_shadowing"),
    "kept, shares in the model": lambda: turning(*WING, "color_term[body]", "background"),
    "stepped": lambda: turning(*WING, "exposure_smearing", "saturation"),
    "on a grid": lambda: turning(*WING, "panel_offset", "appendage"),
    "on a grid, several instants": lambda: turning(*WING, "exposure_smearing", "panel_cant"),
    "each by itself": lambda: turning(SIZED + WINGS, FREE_FOIL + CELLS, "wobble"),
    "with shadows": lambda: turning(SIZED + WINGS, FREE_FOIL + CELLS, "self_shadowing", "attitude_offset"),
    "with bounces": lambda: turning(SIZED + WINGS, FREE_FOIL + CELLS, "interreflection", count=2),
    "a dish": lambda: (shaped("dish"), tumbling(shaped("dish")), ("background",)),
    "in the Earth's shadow": lambda: low(*WING, "along_track_offset", "earth_shadow"),
}


def model(case: tuple[Scene, Recording, tuple[str, ...]]) -> LightCurve:
    return flux(*case)


def points(curve: LightCurve, count: int) -> torch.Tensor:
    """theta (count, P) from the prior, of which some share their geometry."""
    theta = curve.parameter_set.sample_prior(count, torch.Generator().manual_seed(3))
    theta[: count // 3, curve.assembly.geometry_columns] = theta[0, curve.assembly.geometry_columns]
    return theta


ASKED = {
    "alone": lambda curve, theta: curve(theta),
    "no gradient": lambda curve, theta: torch.no_grad()(curve)(theta),
    "with a gradient": lambda curve, theta: graded(curve, theta),
    "a batch of one": lambda curve, theta: curve(theta[None])[0],
    "first of a batch": lambda curve, theta: torch.no_grad()(curve)(padded(curve, theta, 7))[0],
    "first of a batch with gradients": lambda curve, theta: graded(curve, padded(curve, theta, 3))[0],
    "last of a large batch": lambda curve, theta: torch.no_grad()(curve)(padded(curve, theta, 30).flip(0))[
        -1
    ],
    "under vmap": lambda curve, theta: torch.vmap(curve)(padded(curve, theta, 2))[0],
    "with shares": lambda curve, theta: torch.no_grad()(curve.brightness)(theta, shares=True).flux,
    "with shares, in a batch": lambda curve, theta: curve.brightness(theta[None], shares=True).flux[0],
    "its own parameters": lambda curve, theta: curve.set_theta(theta) or curve(),
}


def graded(curve: LightCurve, theta: torch.Tensor) -> torch.Tensor:
    leaf = theta.clone().requires_grad_()
    light = curve(leaf)
    torch.autograd.grad(light.sum(), leaf, allow_unused=True)
    return light


def padded(curve: LightCurve, theta: torch.Tensor, count: int) -> torch.Tensor:
    """theta and others after it."""
    return torch.cat([theta[None], points(curve, count)[1:]])


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_in_any_order_of_calls(name):
    """Each call on a model to which calls of other kinds and other theta were made before in a random order, against
    a model that was just made and asked once."""
    case = CASES[name]()
    used = model(case)
    theta = points(used, 6)
    fresh = []
    with torch.no_grad():
        fresh = [model(case)(row) for row in theta[-2:]]
    generator = np.random.default_rng(len(name))
    order = [(ask, which) for ask in ASKED for which in (0, 1)]
    for ask, which in generator.permutation(np.array(order, dtype=object)):
        row = theta[-2:][which]
        if ask == "its own parameters":  # what lies beyond a bound is set just inside it
            row = used.parameter_set.to_natural(used.parameter_set.to_unconstrained(row))
            with torch.no_grad():
                expected = model(case)(row)
        else:
            expected = fresh[which]
        found = ASKED[ask](used, row).detach()
        worst = float((found - expected).abs().max() / expected.abs().max())
        assert worst < SAME, (ask, worst)


def test_by_a_clock_offset_between_tables(tmp_path):
    scene, recording = clocked(tmp_path)
    case = scene, recording, ("time_offset", "earth_shadow")
    used, theta = model(case), points(model(case), 3)[-1]
    with torch.no_grad():
        expected = model(case)(theta)
    for name, ask in ASKED.items():
        if name != "its own parameters":
            found = ask(used, theta).detach()
            assert float((found - expected).abs().max() / expected.max()) < SAME, name


# ------------------------------------------------------------------ what the ways neglect


def exact(curve: LightCurve, theta: torch.Tensor) -> torch.Tensor:
    """Light with every table made at theta and every pair summed."""
    values = curve.values(theta)
    return curve.shine(curve.make_tables(curve.view(values), False, compact=True), values).flux


def worst_mag(curve: LightCurve, theta: torch.Tensor) -> float:
    """Largest error, mag, at rows of theta (B, P), where there is more than 1e-6 of the brightest light at any of them:
    a lobe without diffuse light leaves 1e-260 elsewhere."""
    with torch.no_grad():
        found = torch.stack([curve(row) for row in theta])
        expected = torch.stack([exact(curve, row) for row in theta])
    lit = expected > 1e-6 * expected.max()
    return float((2.5 * torch.log10(found[lit] / expected[lit])).abs().max())


@pytest.mark.parametrize(
    "components", [CYLINDER, many_boxes().replace("foil", "white")], ids=["cylinder", "boxes"]
)
@pytest.mark.parametrize("effect", ["finite_sun", "earthshine"])
def test_lobes_tabulated_over_the_exponent_are_the_sums_of_all_pairs(tmp_path, components, effect):
    """From n = 1 to 1e6 without diffuse light, which would hide errors of the lobe."""
    scene = still(components, LOBE)
    directions = unit(np.random.default_rng(3).normal(size=(2, 20, 3)))
    recording = seen_from(scene, tmp_path, *directions, position=[7000.0, 0.0, 0.0])
    curve = LightCurve(scene, replace(recording, kind="flux"), effects=[effect])
    assert curve.evaluation.tabulated == ("white",)
    theta = curve.theta().detach().repeat(25, 1)
    theta[:, curve.names.index("white.n")] = torch.logspace(0, 6, 25, dtype=theta.dtype)
    theta[:, curve.names.index("white.r_diff")] = 0.0
    assert worst_mag(curve, theta) < curve.evaluation.error_mag <= 2e-3


def test_a_tabulated_lobe_holds_rows_whose_sources_have_very_different_extents():
    """Rows are tabulated a few at a time, some of them all dark; a source as wide as a degree ends the smooth part of its rows long before the
    Sun's disc does, and the table of all rows is still one."""
    rows = 180
    draw = np.random.default_rng(4)
    tensors = {
        "log_half": -np.abs(draw.normal(size=(6, rows))) * 1e-5,  # the glint of each row is near
        "normal": draw.uniform(0.1, 1.0, size=(6, rows)) * (np.arange(rows) < 110),  # and then no light
        "grazing": draw.uniform(0.0, 0.1, size=(6, rows)) * (np.arange(rows) < 110),
        "diffuse": np.zeros(rows),
        "spread": np.broadcast_to(np.where(np.arange(rows) < 60, 1e-3, 1e-5), (6, rows)).copy(),
    }
    table = {name: torch.as_tensor(value) for name, value in tensors.items()}
    condensed = AshikhminShirley.condense(table)
    for n in (1.0, 30.0, 3e3, 1e5, 1e6):
        values = {
            name: torch.tensor(value, dtype=torch.float64)
            for name, value in {"n": n, "r_spec": 0.4, "r_diff": 0.0}.items()
        }
        tabulated = AshikhminShirley.parts(condensed, values)[0]
        wide = np.minimum(n, 1 / tensors["spread"])  # no lobe is narrower than its source
        light = (0.4 * tensors["normal"] + tensors["grazing"]) * (1 + wide)
        summed = (light * np.exp(wide * tensors["log_half"])).sum(0)
        bright = summed > 1e-6 * summed.max()
        assert float(tabulated[110:].max()) < 1e-250
        assert np.abs(2.5 * np.log10(tabulated.numpy()[bright] / summed[bright])).max() < 2e-3, n


def test_light_between_exposure_times_is_that_of_the_time():
    curve = model(CASES["stepped"]())
    assert curve.evaluation.way == "stepped"
    quantity = curve.effects[0].quantities[0]
    theta = curve.theta().detach().repeat(15, 1)
    theta[:, curve.names.index("exposure_smearing.s")] = torch.linspace(
        0, quantity.high, 15, dtype=theta.dtype
    )
    assert worst_mag(curve, theta) < curve.evaluation.error_mag <= 2e-3


def test_light_between_clock_offsets_is_that_of_the_offset(tmp_path):
    """With the shadow of the Earth, whose entry an hour's error would move by many rows."""
    scene, recording = clocked(tmp_path)
    curve = flux(scene, recording, ["time_offset", "earth_shadow"])
    assert curve.evaluation.way == "clocked"
    step = curve.evaluator.step
    theta = curve.theta().detach().repeat(4, 1)
    theta[:, curve.names.index("time_offset.s")] = step * torch.tensor(
        [-3.4, -0.5, 0.7, 2.5], dtype=theta.dtype
    )
    assert worst_mag(curve, theta) < curve.evaluation.error_mag <= 2e-3
    assert any(f"{4 * step:.3g} s" in text for text in curve.warnings)


def test_a_model_of_other_fixed_numbers_borrows_no_tables():
    """A sibling lends tables where the geometry is the same, and only there."""
    from torchlc.lightcurve.assembly import assemble

    scene, recording, _ = turning(*WING)
    recording = replace(recording, kind="flux")
    base = assemble(scene, recording, ["panel_offset"], pinned={"panel_offset.deg": 0.0})
    moved = assemble(scene, recording, ["panel_offset"], base=base, pinned={"panel_offset.deg": 5.0})
    first = LightCurve(scene, recording, assembly=base)
    second = LightCurve(scene, recording, assembly=moved, sibling=first)
    alone = LightCurve(scene, recording, assembly=moved)
    with torch.no_grad():
        first()
        torch.testing.assert_close(second(), alone(), rtol=1e-13, atol=0)
        assert float((second() / first() - 1).abs().max()) > 1e-3
