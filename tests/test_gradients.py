"""Every slope against central differences: by every free number of every shape, effect, law and attitude, in every way
in which light is worked out, for one theta and for many, backwards and under the transforms of torch.func.

A difference is Richardson's, of fourth order, with steps of 2e-5 of a number or of a tenth: its truncation is below
1e-9 where the light is smooth over 1e-3, as all lobes here are, and its rounding is 1e-16 / 2e-6 over a slope that is
1e-4 of the light at least. Light has kinks, where a facet turns from the Sun or the observer and where a shadow's edge
passes a corner; the rows and values below are such that no kink lies within a step. Slopes agree to 1e-5 of the
largest.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from tests.effects.cases import seen_from, still, unit
from tests.effects.passes import BODY, CELLS, MATERIALS, TUMBLING, WINGS, orbiting, rows
from tests.effects.test_every_effect import at, setting
from torchlc.brdf.base import MODELS
from torchlc.effects import effect_class, registry, unlisted
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.model import LightCurve
from torchlc.scene.parts import Attitude
from torchlc.shapes import SHAPES

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func's own
NEAR = 1e-5
STEP = 2e-5
ROWS = 10


def central(function, theta: torch.Tensor) -> torch.Tensor:
    """Jacobian (T, P) of function(theta) (T,) by Richardson's central differences, one theta at a time."""
    columns = []
    with torch.no_grad():
        for column in range(len(theta)):
            size = STEP * max(abs(float(theta[column])), 0.1)
            step = size * torch.eye(len(theta), dtype=theta.dtype)[column]
            wide = (function(theta + step) - function(theta - step)) / (2 * size)
            narrow = (function(theta + step / 2) - function(theta - step / 2)) / size
            columns.append((4 * narrow - wide) / 3)
    return torch.stack(columns, -1)


def agree(found: torch.Tensor, expected: torch.Tensor, names, terms: torch.Tensor | None = None) -> None:
    """Jacobians (..., T, P) column by column, relative to the largest slope of each, or to the ``terms`` of which the slopes
    are sums and which may cancel; a column of nothing is one of less than rounding."""
    largest = (expected if terms is None else terms).abs().amax(-2, keepdim=True).clamp(min=1e-9)
    worst = ((found - expected).abs() / largest).amax(tuple(range(found.ndim - 1)))
    assert torch.isfinite(found).all()
    assert float(worst.max()) < NEAR, dict(zip(names, worst.tolist(), strict=True))


def check(model: LightCurve, theta: torch.Tensor, function=None) -> None:
    """Slopes of a model's flux, or of a function of theta, at rows of theta (B, P): alone and together, by
    backward, by its own parameters, and under jacrev and vmap."""
    names, count = model.names, theta.shape[-1]
    assert count
    scale = float(model(theta[0]).detach().abs().max()) if function is None else 1.0

    def curve(x: torch.Tensor | None) -> torch.Tensor:
        return torch.atleast_1d(model(x) / scale) if function is None else function(x)

    expected = torch.stack([central(curve, row) for row in theta])
    for row, slopes in zip(theta, expected, strict=True):
        leaf = row.clone().requires_grad_()
        light = curve(leaf)
        found = [torch.autograd.grad(one, leaf, retain_graph=True)[0] for one in light]
        agree(torch.stack(found), slopes, names)
    agree(torch.func.jacrev(curve)(theta[0]), expected[0], names)

    leaf = theta.clone().requires_grad_()
    batch = curve(leaf)
    batch = batch.reshape(len(theta), -1)
    found = [torch.autograd.grad(one.sum(), leaf, retain_graph=True)[0] for one in batch.unbind(1)]
    agree(torch.stack(found, 1), expected, names)

    weight = torch.linspace(1.0, 2.0, batch.shape[1], dtype=theta.dtype)  # no row counts for nothing
    weight[1::2] *= -1
    pulled = torch.vmap(torch.func.grad(lambda x: (curve(x) * weight).sum()))(theta)
    terms = weight[:, None] * expected
    agree(pulled[:, None], terms.sum(1, keepdim=True), names, terms)

    if function is None:
        model.set_theta(theta[0])
        z = model.unconstrained().detach()
        model.zero_grad()
        (curve(None) * weight).sum().backward()
        found = torch.stack([one.grad for one in model.parameters()])
        by_z = central(lambda z: curve(model.parameter_set.to_natural(z)), z)
        owned = [list(model.state_dict()).index(f"free.{o}.{s}") for o, s in model._keys]
        agree(found[owned][None], (weight @ by_z)[None], names)


def flux(scene: torchlc.Scene, recording, effects=()) -> LightCurve:
    """A model of relative flux, so that a dark row is a number."""
    return LightCurve(scene, dataclasses.replace(recording, kind="flux"), effects=list(effects))


def near(model: LightCurve, share: float = 0.01) -> torch.Tensor:
    """theta (2, P): the start, and another beside it."""
    theta = model.theta().detach()
    return torch.stack([theta, theta * (1 + share)])


def free(value: float, low: float, high: float) -> str:
    return f"{{ value = {value}, low = {low}, high = {high} }}"


# ------------------------------------------------------------------ shapes

SIZES = {
    "box": "size = [{}, {}, {}]",
    "plate": "size = [{}, {}]\nu = [1, 0, 0]\nv = [0, 1, 0]",
    "cylinder": "radius = {}\nlength = {}",
    "cone": "radius = {}\nradius_top = {}\nlength = {}",
    "dish": "radius = {}\ndepth = {}",
    "sphere": "radius = {}",
    "nozzle": "radius = {}\nradius_top = {}\nlength = {}",
}
BROAD = f"""
    [materials.white]
    n = {free(20.0, 1.0, 100.0)}
    r_spec = {free(0.3, 0.0, 1.0)}
    r_diff = {free(0.3, 0.0, 1.0)}
"""
TRACKING = 'tracks = { target = "sun", axis = [0, 1, 0] }\n'


def shaped(kind: str, more: str = "", material: str = BROAD) -> torchlc.Scene:
    """One part of a kind, all its sizes free, that tumbles."""
    text = SIZES[kind]
    sizes = [free(1.0 + 0.37 * k, 0.1, 9.0) for k in range(text.count("{}"))]
    part = f'[[components]]\nname = "part"\nshape = "{kind}"\n{text.format(*sizes)}\ncentre = [0.2, 0.1, 0]\n'
    return orbiting(TUMBLING, f'{part}rotation = [20, 30, 40]\nmaterial = "white"\n{more}', material)


def tumbling(scene: torchlc.Scene, count: int = ROWS):
    """Rows 437 s apart, no whole number of turns."""
    return rows(scene, hours=(count - 0.5) * 437 / 3600, cadence_s=437.0)


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("more", ["", TRACKING], ids=["fixed", "tracking"])
def test_by_every_size_of_every_shape(kind, more):
    scene = shaped(kind, more)
    model = flux(scene, tumbling(scene))
    assert sum(name.startswith("part.") for name in model.names) == SIZES[kind].count("{}")
    check(model, near(model))


def test_the_shapes_here_are_all_that_have_sizes():
    assert {name for name in SHAPES if name not in SHAPES.outside()} == {*SIZES, "mesh"}


def test_facets_that_lie_in_one_plane_by_chance_keep_their_own_slopes():
    """A frustum whose ends happen to be alike beside a cylinder; two one-sided plates, equal now, back to back."""
    cone = SIZES["cone"].format(free(0.8, 0.1, 9.0), free(0.8, 0.1, 9.0), 2.0)
    parts = (
        '[[components]]\nname = "barrel"\nshape = "cylinder"\nradius = 0.8\nlength = 2.0\ncentre = [4, 0, 0]\n'
        'material = "white"\n'
        f'[[components]]\nname = "cone"\nshape = "cone"\n{cone}\ncentre = [0, 0, 0]\nmaterial = "white"\n'
    )
    scene = orbiting(TUMBLING, parts, BROAD)
    model = flux(scene, tumbling(scene))
    check(model, near(model))
    plate = (
        '[[components]]\nname = "{0}"\nshape = "plate"\nsize = [{1}, 2.0]\ncentre = [{2}, 0, 0]\nu = [1, 0, 0]\n'
        'v = [0, {3}, 0]\nmaterial = "white"\nback_material = "black"\n'
    )
    parts = plate.format("up", free(1.0, 0.1, 9.0), 0, 1) + plate.format("down", 1.0, 5, -1)
    scene = orbiting(TUMBLING, parts, BROAD + '[materials.black]\nmodel = "lambert"\nalbedo = 0.0\n')
    model = flux(scene, tumbling(scene, 20))
    check(model, near(model))


def test_by_the_attitude_of_a_mesh(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.obj")
    attitude = (
        f'mode = "inertial"\nx_angle = 20.0\nspin_axis = [1, 2, 3]\nspin_rate = {free(1.0, 0.0, 2.0)}\n'
    )
    part = '[[components]]\nname = "ball"\nshape = "mesh"\nfile = "ball.obj"\ncentre = [0, 0, 0]\nmaterial = "foil"\n'
    path = tmp_path / "scene.toml"
    path.write_text(orbiting_text(attitude, part, MATERIALS))
    scene = torchlc.load(path)
    model = flux(scene, tumbling(scene))
    check(model, near(model))


def orbiting_text(attitude: str, components: str, materials: str) -> str:
    from tests.effects.passes import ORBIT_1, WEIHAI

    first, second = ORBIT_1
    return (
        f'format = "torchlc-scene/1"\nname = "pass"\n[orbit]\ntle = ["{first}", "{second}"]\n{WEIHAI}'
        f"[attitude]\n{attitude}\n{components}{materials}\n[model]\neffects = []\n"
    )


# ------------------------------------------------------------------ laws and attitudes

LAWS = [name for name, law in MODELS.items() if law.__module__.startswith("torchlc.")]


def middle(law: type, name: str) -> float:
    """A value well inside the bounds, on the scale of the quantity; what shares one unit of light adds up to 0.6."""
    quantity = law.quantity(name)
    if quantity.prior == "loguniform":
        low, high = quantity.low or 1.0, min(quantity.high, 1e3)
        return (low * high) ** 0.5
    share = 0.6 / len(law.simplex) if name in law.simplex else 0.4
    return quantity.low + share * (quantity.high - quantity.low)


@pytest.mark.parametrize("law", LAWS)
def test_by_every_number_of_every_law(law):
    """On a box whose rows are the same, geometry fixed, and on one of free size."""
    cls = MODELS[law]
    numbers = {q.name: free(middle(cls, q.name), max(q.low, 1e-6), q.high) for q in cls.quantities}
    material = f'[materials.white]\nmodel = "{law}"\n' + "".join(f"{k} = {v}\n" for k, v in numbers.items())
    box = '[[components]]\nname = "part"\nshape = "box"\nsize = [{}, 2, 3]\ncentre = [0, 0, 0]\nmaterial = "white"\n'
    for size in ("1.0", free(1.0, 0.1, 9.0)):
        scene = orbiting(TUMBLING, box.format(size), material)
        model = flux(scene, tumbling(scene))
        assert len(model.names) == len(numbers) + (size != "1.0")
        check(model, near(model))


SPIN = (
    f"spin_axis = [0.3, 0.8, 0.5]\nspin_rate = {free(6.0, 1.0, 9.0)}\nspin_phase = {free(20.0, 0.0, 90.0)}\n"
)
ATTITUDES = {
    "nadir": SPIN,
    "yaw-steering": SPIN,
    "sun": SPIN,
    "inertial": f"x_angle = {free(20.0, 0.0, 90.0)}\n{SPIN}",
    "spin-pole": f"pole = [{free(30.0, 0.0, 360.0)}, {free(40.0, -90.0, 90.0)}]\n"
    f"period = {free(2.0, 1.0, 3.0)}\nphase = {free(10.0, 0.0, 360.0)}\nepoch = 2459140.0\n",
    "rigid-body": f"pole = [{free(30.0, 0.0, 360.0)}, {free(40.0, -90.0, 90.0)}]\n"
    f"period = {free(2.0, 1.0, 3.0)}\nphase = {free(10.0, 0.0, 360.0)}\nepoch = 2459140.0\n"
    f"polhode_phase = {free(40.0, 0.0, 360.0)}\nnutation = {free(25.0, 1.0, 89.0)}\n"
    f"inertia = [{free(0.5, 0.45, 0.6)}, {free(0.8, 0.75, 0.9)}]\n",
}


def test_the_attitudes_here_are_all_that_have_numbers():
    assert set(Attitude.MODE_KEYS) == {*ATTITUDES, "quaternions"}


@pytest.mark.parametrize("mode", ATTITUDES)
def test_by_every_number_of_every_attitude(mode):
    scene = orbiting(f'mode = "{mode}"\n{ATTITUDES[mode]}', BODY + WINGS, MATERIALS + CELLS)
    model = flux(scene, tumbling(scene))
    assert len(model.names) == ATTITUDES[mode].count("value")
    check(model, near(model, 0.003))


# ------------------------------------------------------------------ effects

SIZED = BODY.replace("[2.0, ", f"[{free(2.0, 0.1, 9.0)}, ")


@pytest.mark.parametrize("name", [*registry(), *unlisted()])
def test_by_every_number_of_every_effect(name):
    """And of what the library does not hold: on the scene that shows it, at its typical values; noise by the likelihood."""
    scene, recording = setting(name)
    model = LightCurve(scene, recording, effects=[])
    level = float(model().median())
    wave = 1 + 0.1 * np.sin(np.arange(len(recording)))
    recording = dataclasses.replace(
        recording, observed=level * wave, error=np.full(len(wave), 0.05 * level), kind="flux"
    )
    cut = np.arange(len(recording)) % 2 == 0
    model = LightCurve(scene, recording.keep(cut, "every other"), effects=[name])
    if not model.names:
        pytest.skip(f"{name} has no number")
    theta = at(model, "typical")
    theta = torch.stack([theta, theta * 1.01])
    if effect_class(name).stage == "noise":
        likelihood = Likelihood(model)
        check(model, theta, lambda x: torch.atleast_1d(likelihood.log_likelihood(x))[..., None].squeeze(-1))
    else:
        check(model, theta)


@pytest.mark.parametrize(
    "effects",
    [
        ["appendage", "panel_offset", "attitude_offset"],
        ["self_shadowing", "attitude_offset", "panel_cant"],
        ["light_time", "along_track_offset", "time_offset", "opposition_surge[cells]", "background"],
        ["finite_sun", "second_material[foil]", "normal_dispersion[cells]", "color_term[body]"],
    ],
    ids="+".join,
)
def test_by_all_numbers_together_beside_a_free_size(effects):
    scene = orbiting(TUMBLING, SIZED + WINGS, MATERIALS + CELLS)
    model = flux(scene, tumbling(scene), effects)
    theta = at(model, "typical")
    check(model, torch.stack([theta, theta * 1.003]))


# ------------------------------------------------------------------ ways in which light is worked out


def many_boxes() -> str:
    rotation = np.random.default_rng(4).uniform(0, 90, (16, 3)).round(2)
    return "".join(
        BODY.replace('"body"', f'"body {k}"').replace("[0, 0, 0]", f"[{4 * k}, 0, 0]")
        + f"rotation = {turn.tolist()}\n"
        for k, turn in enumerate(rotation)
    )


FREE_FOIL = BROAD.replace("white", "foil")
WAYS = {
    "kept": lambda: flux(*timed(orbiting(TUMBLING, BODY, FREE_FOIL))),
    "kept, tabulated": lambda: flux(*timed(orbiting(TUMBLING, many_boxes(), FREE_FOIL))),
    "kept, shares": lambda: flux(*timed(orbiting(TUMBLING, many_boxes(), FREE_FOIL)), ["color_term[body 0]"]),
    "stepped, tabulated": lambda: flux(
        *timed(orbiting(TUMBLING, BODY + WINGS, FREE_FOIL + CELLS)), ["exposure_smearing"]
    ),
    "anew, on a grid": lambda: flux(
        *timed(orbiting(TUMBLING, BODY + WINGS, FREE_FOIL + CELLS)), ["panel_offset"]
    ),
    "anew, each": lambda: flux(*timed(orbiting(TUMBLING, SIZED + WINGS, FREE_FOIL + CELLS))),
    "anew, shadows": lambda: flux(
        *timed(orbiting(TUMBLING, SIZED + WINGS, FREE_FOIL + CELLS)), ["self_shadowing"]
    ),
}


def timed(scene: torchlc.Scene):
    return scene, tumbling(scene)


@pytest.mark.parametrize("way", WAYS)
def test_in_every_way(way):
    model = WAYS[way]()
    assert model.evaluation.way == way.partition(",")[0]
    assert bool(model.evaluation.tabulated) == ("tabulated" in way)
    theta = at(model, "typical")
    check(model, torch.stack([theta, theta * 1.003]))


def test_by_a_clock_offset_between_tables(tmp_path):
    """A Lambert ball of 1,280 facets and 800 rows: a million pairs, which a clock offset alone moves."""
    scene, recording = clocked(tmp_path)
    model = flux(scene, recording, ["time_offset", "earth_shadow"])
    assert model.evaluation.way == "clocked"
    theta = at(model, "typical")
    weight = torch.linspace(-1.0, 2.0, len(recording), dtype=theta.dtype)
    rows_apart = torch.arange(0, len(recording), 97)
    scale = float(model(theta).max())
    check(
        model,
        torch.stack([theta, theta * 1.01]),
        lambda x: (model(x) * weight / scale)[..., rows_apart],
    )


def clocked(folder: Path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(3).export(folder / "ball.obj")
    part = '[[components]]\nname = "ball"\nshape = "mesh"\nfile = "ball.obj"\ncentre = [0, 0, 0]\nmaterial = "rock"\n'
    path = folder / "scene.toml"
    material = f'[materials.rock]\nmodel = "lambert"\nalbedo = {free(0.3, 0.0, 1.0)}\n'
    path.write_text(orbiting_text('mode = "nadir"', part, material))
    scene = torchlc.load(path)
    return scene, rows(scene, hours=7.0, cadence_s=30.0)


def test_forward_mode_without_a_transform():
    """Dual numbers of torch.autograd, which ask for no gradient, see planes that turn."""
    model = flux(*timed(shaped("dish")))
    theta = model.theta().detach()
    along = torch.linspace(0.5, 1.5, len(theta), dtype=theta.dtype)
    with torch.autograd.forward_ad.dual_level():
        light = model(torch.autograd.forward_ad.make_dual(theta, along))
        found = torch.autograd.forward_ad.unpack_dual(light).tangent
    expected = central(model, theta) @ along
    torch.testing.assert_close(found, expected, rtol=NEAR, atol=NEAR * float(expected.abs().max()))


# ------------------------------------------------------------------ what has no slope says so


def test_shadows_that_move_in_jumps_are_told_once_and_only_where_they_move(tmp_path):
    """Rays and sample points give steps: their slope is 0, the true one is not."""
    dish = (
        '[[components]]\nname = "dish"\nshape = "dish"\nradius = 0.8\ndepth = 0.3\ncentre = [0, 0, 3]\n'
        'material = "foil"\n'
    )
    for body, told in ((BODY, 0), (SIZED, 1)):
        scene = orbiting(TUMBLING, body + dish, MATERIALS)
        said = [text for text in flux(scene, tumbling(scene), ["self_shadowing"]).warnings if "jumps" in text]
        assert len(said) == told
        assert all("dish" in text and "body.size_x" in text for text in said)
    scene = orbiting(TUMBLING, SIZED + WINGS, MATERIALS + CELLS)
    assert not any("jumps" in text for text in flux(scene, tumbling(scene), ["self_shadowing"]).warnings)
    scene = still(SIZED + WINGS, MATERIALS + CELLS)
    directions = unit(np.random.default_rng(2).normal(size=(2, 5, 3)))
    bouncing = flux(scene, seen_from(scene, tmp_path, *directions), ["interreflection"])
    assert sum("jumps" in text for text in bouncing.warnings) == 1


# ------------------------------------------------------------------ and they train


@pytest.mark.long
def test_the_training_script_of_the_tutorial_finds_the_depth_of_a_dish():
    """Adam as in docs/tutorials/training_script.md, from half the true depth, on light without errors."""
    truth = shaped("dish", material=MATERIALS.replace("foil", "white"))
    recording = tumbling(truth, 40)
    light = torchlc.simulate(truth, recording).mag
    lit = np.isfinite(light)
    recording = dataclasses.replace(recording, observed=light).keep(lit, "dark")
    model = LightCurve(truth, recording)
    seen, error = torch.as_tensor(recording.observed), torch.as_tensor(recording.error)
    depth = model.names.index("part.depth")
    right = float(model.theta().detach()[depth])
    start = model.theta().detach().clone()
    start[depth] *= 0.5
    model.set_theta(start)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    losses = []
    for _ in range(120):
        loss = (((model() - seen) / error) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 1e-3 * losses[0]
    assert float(model.theta().detach()[depth]) == pytest.approx(right, rel=0.02)
