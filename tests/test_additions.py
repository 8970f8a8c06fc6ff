"""An addition is one class: an effect, a law of reflection, a shape, a noise model, a reader and a figure, defined here and
nowhere else, go from TOML and a file through simulate, fit, sample, diagnose and report to the listings and the pages; a
network inside of them learns."""

from __future__ import annotations

import copy
import importlib.util
import json
import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

import torchlc
from tests.effects.passes import rows
from tests.paper_orbits import ORBIT_1
from torchlc.brdf import MODELS, Brdf
from torchlc.brdf.base import lambert, per_epoch
from torchlc.cli import completion
from torchlc.diagnosis.alternatives import under_other_laws
from torchlc.effects import Effect, registry
from torchlc.files.numbers import Size
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.naming import Replaced
from torchlc.noise.kind import NoiseKind
from torchlc.parameters import LOBE_REFLECTANCE, REFLECTANCE, Quantity
from torchlc.readers.format import FORMATS, Format
from torchlc.readers.formats import formats
from torchlc.readers.table import Header
from torchlc.report.figures import ReportFigure
from torchlc.report.figures.contract import FIGURES
from torchlc.report.listing import effects_listing
from torchlc.scene import Scene
from torchlc.shapes import SHAPES, Component, Facets, Hull, Part
from torchlc.shapes.part import like
from torchlc.stages.effect import EFFECTS


class ThinCloud(Effect):
    """A cloud dims everything, as a Gaussian dip in time.

    Neglects its colour.
    """

    name = "thin_cloud"
    stage = "detector"
    quantities = (
        Quantity(
            "mag",
            "mag",
            0.0,
            3.0,
            "dimming in the middle",
            off=0.0,
            typical=0.2,
            prior="halfnormal",
            sigma=0.3,
        ),
        Quantity("hour", "h", 0.0, 6.0, "its middle", typical=3.0),
    )

    def detector(self, brightness, p, context):
        hours = context.seconds.to(brightness.flux) / 3600
        dimming = p["mag"] * torch.exp(-0.5 * ((hours - p["hour"]) / 0.4) ** 2)
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * dimming))


class ConstantGlow(Brdf):
    """f_r = shine / (cos_i cos_r) of one, and Lambert's law: light that goes with the area alone, whatever the angles."""

    model = "constant-glow"
    quantities = (
        Quantity("glow", "", 0.0, 1.0, "flux of a unit area", role=LOBE_REFLECTANCE),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex = ("glow", "r_diff")
    rivals = {"phong-mirror": {"n": 20.0, "r_spec": 0.2}}  # noqa: RUF012

    @staticmethod
    def tabulate(angles, weight):
        return {"area": weight.sum(-2), "diffuse": (weight * lambert(angles)).sum(-2)}

    @staticmethod
    def parts(table, values):
        return per_epoch(values["glow"]) * table["area"], per_epoch(values["r_diff"]) * table["diffuse"]


class HexagonKeys(Component):
    """A prism about Z: ``radius`` to its six edges."""

    radius: Size
    length: Size


class Hexagon(Part):
    """Six sides, "top" and "bottom" (two facets each); u along Z on the sides, along X at the ends."""

    kind = "hexagon"
    keys = HexagonKeys

    def __init__(self, component, surroundings):
        super().__init__(component, surroundings)
        angle = np.radians(60.0 * np.arange(6))
        self._ring = np.stack([np.cos(angle), np.sin(angle)], -1)
        self.faces = (*(f"side {k}" for k in range(6)), "top", "top", "bottom", "bottom")
        self.materials = (component.material,) * 10
        loops = [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
        ends = [[0, 1, 2, 3], [3, 4, 5, 0]]
        self._loops = np.array(
            [*loops, *[[k + 6 for k in end] for end in ends], *[end[::-1] for end in ends]]
        )
        self.hull = Hull.of([*loops, list(range(6, 12)), list(range(5, -1, -1))])

    def _corners(self, values):
        radius, length = self.sizes(values, "radius", "length")
        flat = like(self._ring, radius) * radius
        half = (0.5 * length).expand(6, 1)
        return torch.cat([torch.cat([flat, -half], -1), torch.cat([flat, half], -1)])

    def at_rest(self, values):
        corners = self._corners(values)
        vertices = corners[torch.as_tensor(self._loops)]
        across = torch.linalg.cross(vertices[:, 2] - vertices[:, 0], vertices[:, 3] - vertices[:, 1])
        double = torch.linalg.vector_norm(across, dim=-1)
        u = like(np.array([[0.0, 0.0, 1.0]] * 6 + [[1.0, 0.0, 0.0]] * 4), corners)
        return Facets(vertices, across / double[:, None], u, 0.5 * double, vertices.mean(1))

    def hull_corners(self, facets):
        sides = facets.vertices[:6]
        return torch.cat([sides[:, 0], sides[:, 3]])


class UnevenErrors(NoiseKind):
    """Errors are wider at the beginning than at the end, linearly.

    Neglects why.
    """

    name = "uneven_errors"
    title = "errors that shrink with time"
    widens = True
    quantities = (
        Quantity(
            "mag", "mag", 0.0, 1.0, "at the first row", off=0.0, typical=0.03, prior="halfnormal", sigma=0.1
        ),
    )

    def noise(self, noise, p, context):
        return noise.wider(p["mag"] * (1 - context.seconds / context.seconds[-1]))


class NightLog(Format):
    """Lines "12.345 +- 0.010 at 2459140.1", as an observer may keep them."""

    name = "night log"

    @classmethod
    def recognises(cls, head):
        return head.first.startswith("Night log of")

    @classmethod
    def read(cls, head):
        def rows():
            for _, text in head.lines[1:]:
                mag, _, error, _, date = text.split()
                yield [date, mag, error]

        return Header(head.path, ("time", "mag", "mag_err"), ",", ecsv=False, rows=rows, format=cls.name)


class Spread(ReportFigure):
    """Residuals in order of size."""

    name = "spread"
    heading = "Residuals in order"

    def size(self, result):
        return (5.0, 2.0)

    def draw(self, result, figure):
        figure.subplots().plot(np.sort(np.asarray(result.delta)))

    def alt(self, result):
        return "Residuals of all rows, sorted."

    def caption(self, result):
        return "A straight middle says that most residuals are alike."


@pytest.fixture(scope="module", autouse=True)
def known():
    """The classes are known to this module's tests alone: others list what the package has."""
    for registry_, name, cls in MINE:
        registry_.enter(name, cls)
    yield
    for registry_, name, _ in MINE:
        registry_.pop(name)


ROOT = Path(__file__).parent.parent
first, second = ORBIT_1
TEXT = f"""
format = "torchlc-scene/1"
name = "additions"
[orbit]
tle = ["{first}", "{second}"]
[[stations]]
id = "weihai"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "inertial"
spin_axis = [0.3, 0.8, 0.5]
spin_rate = 0.9
[[components]]
name = "bus"
shape = "hexagon"
radius = RADIUS
length = 2.0
centre = [0, 0, 0]
material = "paint"
[materials.paint]
model = "constant-glow"
glow = {{ value = 0.05, low = 0.0, high = 1.0 }}
r_diff = DIFFUSE
[model]
effects = EFFECTS
[model.parameters]
band_sun_magnitude = -26.7
PARAMETERS
"""
TRUE_CLOUD = '"thin_cloud.mag" = 0.5\n"thin_cloud.hour" = 3.1'


def scene_with(effects="[]", parameters="", radius="1.0", r_diff="{ value = 0.4, low = 0.0, high = 1.0 }"):
    numbers = {"RADIUS": radius, "EFFECTS": effects, "PARAMETERS": parameters, "DIFFUSE": r_diff}
    text = TEXT
    for word, number in numbers.items():
        text = text.replace(word, number)
    return Scene.from_toml(text, known_effects=registry())


@pytest.fixture(scope="module")
def recording():
    """Six hours of the hexagon under a cloud, errors 0.01 mag."""
    cloudy = scene_with('["thin_cloud"]', TRUE_CLOUD)
    curve = torchlc.simulate(
        cloudy, start="2020-10-17T14:00:00", hours=6.0, cadence=300.0, noise=0.01, seed=4
    )
    return replace(curve.recording, observed=curve.mag, error=np.full(len(curve.mag), 0.01))


@pytest.fixture(scope="module")
def night_log(tmp_path_factory):
    """The same night with errors that are uneven beside the quoted 0.01 mag, as the reader's file."""
    noisy = scene_with('["thin_cloud", "uneven_errors"]', f'{TRUE_CLOUD}\n"uneven_errors.mag" = 0.05')
    curve = torchlc.simulate(noisy, start="2020-10-17T14:00:00", hours=6.0, cadence=300.0, noise=0.01, seed=5)
    time = curve.recording.time.utc
    rows = [f"{mag:.5f} +- 0.010 at {day:.8f}" for mag, day in zip(curve.mag, time.jd, strict=True)]
    path = tmp_path_factory.mktemp("log") / "night.log"
    path.write_text("\n".join(["Night log of station weihai", *rows]) + "\n")
    return path


def test_a_hexagon_is_six_rectangles_and_two_hexagons():
    """Areas by elementary geometry: side r, and 3 sqrt(3) / 2 r^2 at the ends."""
    part = SHAPES["hexagon"](scene_with().components[0], torchlc.shapes.Surroundings())
    facets = part.facets({"bus.radius": torch.tensor(1.5), "bus.length": torch.tensor(2.0)})
    expected = [3.0] * 6 + [3 * math.sqrt(3) / 4 * 1.5**2] * 4
    np.testing.assert_allclose(facets.area, expected, rtol=1e-6)  # single precision is asked for here
    assert ((facets.normal * facets.centroid).sum(-1) > 0).all()


def test_they_shine_as_elementary_geometry_says():
    """Of a body whose light goes with the area alone: the areas of the facets that are lit and seen."""
    scene = scene_with(r_diff="0.0")
    model = LightCurve(scene, rows(scene), effects=[])
    view = model.view(model.values())
    facets = view.facets[0]
    lit = (view.to_sun[0] @ facets.normal.T > 0) & (view.to_observer[0] @ facets.normal.T > 0)
    expected = 0.05 * (lit * facets.area).sum(-1) / view.range_m[0] ** 2
    torch.testing.assert_close(model.brightness().flux, expected, rtol=1e-12, atol=0)


@pytest.mark.long
def test_fit_and_report(night_log, tmp_path):
    """Reader, effect, law, noise and the figure in one fit: the truth within five standard deviations."""
    scene = scene_with('["thin_cloud", "uneven_errors"]', '"thin_cloud.hour" = 3.1')
    result = torchlc.fit(scene, night_log, steps=40, out=tmp_path / "fit")
    truth = {"paint.glow": 0.05, "paint.r_diff": 0.4, "thin_cloud.mag": 0.5, "uneven_errors.mag": 0.05}
    assert result.names == list(truth)
    for name, row in result.parameters().items():
        assert abs(row["median"] - truth[name]) < 5 * row["sd"], name
    page = (tmp_path / "fit" / "report.html").read_text()
    assert "Residuals in order" in page and "A straight middle" in page
    assert UnevenErrors.title in page
    assert "read as night log" in page
    assert (tmp_path / "fit" / "spread.png").is_file() or list((tmp_path / "fit").rglob("spread*"))


def test_a_free_size_has_a_slope():
    scene = scene_with(radius="{ value = 1.0, low = 0.5, high = 2.0 }")
    model = LightCurve(scene, rows(scene, cadence_s=1800.0), effects=[])
    theta = model.theta().detach()
    place = model.names.index("bus.radius")
    slope = torch.autograd.functional.jacobian(model, theta)[:, place]
    step = 1e-6
    up, down = theta.clone(), theta.clone()
    up[place] += step
    down[place] -= step
    with torch.no_grad():
        central = (model(up) - model(down)) / (2 * step)
    torch.testing.assert_close(slope, central, rtol=1e-5, atol=1e-7)


@pytest.mark.long
def test_diagnose_names_the_cloud(recording):
    found = torchlc.diagnose(
        scene_with(), recording, effects=["thin_cloud", "zero_point_drift", "zero_point_step"], quick=True
    )
    assert found.verdict == "missing_physics" and found.named == ("thin_cloud",)
    assert "A cloud dims everything" in found._repr_html_() or "thin_cloud" in repr(found)


def test_a_diagnosis_tries_the_laws_that_a_law_counts_among_its_rivals():
    others = under_other_laws(scene_with())
    assert set(others) == {"phong-mirror"}
    assert set(others["phong-mirror"].materials["paint"].parameters) == {"n", "r_spec", "r_diff"}


def test_every_list_knows_them():
    assert {"thin_cloud", "uneven_errors"} <= {effect["name"] for effect in effects_listing()}
    assert NightLog in formats()
    assert completion.effects("thin_c") == ["thin_cloud"]
    assert completion.laws("constant") == ["constant-glow"]
    with pytest.raises(
        torchlc.InputError, match=r"shape: 'hexagn'; expected one of .*hexagon.*Did you mean 'hexagon'"
    ):
        Scene.from_toml(scene_with().to_toml().replace('"hexagon"', '"hexagn"'))
    with pytest.raises(torchlc.InputError, match="constant-glow"):
        Scene.from_toml(scene_with().to_toml().replace('"constant-glow"', '"constant-glw"'))


def test_a_class_that_is_defined_again_replaces_the_first_with_a_word():
    for table, base, attribute, name in (
        (EFFECTS, ThinCloud, "name", "thin_cloud"),
        (MODELS, ConstantGlow, "model", "constant-glow"),
        (SHAPES, Hexagon, "kind", "hexagon"),
        (EFFECTS, UnevenErrors, "name", "uneven_errors"),
        (FORMATS, NightLog, "name", "night log"),
    ):
        with pytest.warns(Replaced, match=f"{name}' is now .*Again"):
            again = type("Again", (base,), {attribute: name, "__module__": __name__})
        assert table[name] is again
        with pytest.warns(Replaced):
            table.enter(name, base)
    with pytest.warns(Replaced, match="'fit/spread'"):
        type("Again", (Spread,), {"name": "spread"})
    with pytest.warns(Replaced):
        FIGURES.enter("fit/spread", Spread)


def test_an_effect_of_no_stage_is_refused_at_once():
    with pytest.raises(TypeError, match="effect 'astray': stage 'nowhere'; expected one of clock, "):
        type("Astray", (Effect,), {"name": "astray", "stage": "nowhere"})


# ------------------------------------------------------------------ what learns


class LearntGain(Effect):
    """A network of the hour that brightens or dims everything; for a test.

    Neglects nothing.
    """

    name = "learnt_gain"
    stage = "detector"

    def __init__(self, target=None):
        super().__init__(target)
        torch.manual_seed(3)
        self.net = nn.Sequential(nn.Linear(1, 8), nn.Tanh(), nn.Linear(8, 1))

    def detector(self, brightness, p, context):
        hours = context.seconds[:, None] / 3600 - 3.0
        return replace(brightness, flux=brightness.flux * torch.exp(self.net(hours)[:, 0]))


class LearntTilt(Effect):
    """A learnt turn of the body about Z; for a test of what tables would hold.

    Neglects nothing.
    """

    name = "learnt_tilt"
    stage = "attitude"

    def __init__(self, target=None):
        super().__init__(target)
        self.angle = nn.Parameter(torch.tensor(0.1, dtype=torch.float64))

    def attitude(self, rotation, state, p, context):
        sine, cosine, zero, one = (
            torch.sin(self.angle), torch.cos(self.angle), torch.zeros_like(self.angle), torch.ones_like(self.angle),
        )  # fmt: skip
        turn = torch.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one]).reshape(3, 3)
        return rotation @ turn


class LearntGlow(ConstantGlow):
    """Lambert's law times a learnt function of the albedo; for a test."""

    model = "learnt-glow"

    def build(self):
        torch.manual_seed(5)
        self.net = nn.Linear(1, 1)

    def parts(self, table, values):
        albedo = torch.sigmoid(self.net(per_epoch(values["r_diff"])))
        return per_epoch(values["glow"]) * table["area"], albedo * table["diffuse"]


def of_law(law):
    text = scene_with().to_toml().replace('"constant-glow"', f'"{law}"')
    return Scene.from_toml(text)


@pytest.mark.parametrize("kind", ["effect", "law"])
def test_a_network_is_a_submodule(kind, tmp_path):
    scene = scene_with() if kind == "effect" else of_law("learnt-glow")
    effects = ["learnt_gain"] if kind == "effect" else []
    recording = rows(scene, cadence_s=1800.0)
    model = LightCurve(scene, recording, effects=effects)
    learnt = [name for name, _ in model.named_parameters() if ".net." in name]
    assert len(learnt) == (4 if kind == "effect" else 2)
    assert set(learnt) <= set(model.state_dict())
    assert model.names == ["paint.glow", "paint.r_diff"]
    assert all(parameter.dtype == torch.float64 for parameter in model.parameters())

    before = model().detach()
    target = before - 0.2
    optimiser = torch.optim.Adam(model.learners.parameters(), lr=0.05)
    losses = []
    for _ in range(40):
        optimiser.zero_grad()
        loss = ((model() - target) ** 2).mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]

    after = model().detach()
    copied, pickled = copy.deepcopy(model), pickle.loads(pickle.dumps(model))
    fresh = LightCurve(scene, recording, effects=effects)
    assert not torch.equal(fresh(), after)
    fresh.load_state_dict(model.state_dict())
    for other in (copied, pickled, fresh):
        torch.testing.assert_close(other().detach(), after, rtol=1e-14, atol=0)
        assert next(other.learners.parameters()) is not next(model.learners.parameters())
    named = dict(model.named_parameters())
    named[learnt[0]] = torch.zeros_like(named[learnt[0]])
    assert not torch.equal(torch.func.functional_call(model, named, ()).detach(), after)

    likelihood = Likelihood(model)
    assert torch.isfinite(likelihood.log_prob(model.theta().detach()))
    assert likelihood.log_prob(model.theta().detach()[None].repeat(3, 1)).shape == (3,)
    assert model.to(torch.float32).state_dict()[learnt[0]].dtype == torch.float32


def test_models_of_one_assembly_and_hypotheses_beside_it_have_what_it_learnt():
    scene = scene_with()
    recording = rows(scene, cadence_s=1800.0)
    base = assemble(scene, recording, ["learnt_gain"])
    wider = assemble(scene, recording, ["learnt_gain", "thin_cloud"], base=base)
    one, other = LightCurve(scene, recording, assembly=base), LightCurve(scene, recording, assembly=wider)
    assert [id(p) for p in one.learners.parameters()] == [id(p) for p in other.learners.parameters()]
    law = of_law("learnt-glow")
    base = assemble(law, recording, [])
    wider = assemble(law, recording, ["thin_cloud"], base=base)
    assert base.models["paint"] is wider.models["paint"]


def test_what_is_learnt_on_the_way_of_the_light_is_in_no_kept_table():
    """The slope by the turn against a finite difference, and another turn at once another curve, with and without gradients
    and in a batch."""
    scene = scene_with()
    recording = rows(scene, cadence_s=1800.0)
    model = LightCurve(scene, recording, effects=["learnt_tilt"])
    angle = next(model.learners.parameters())
    (slope,) = torch.autograd.grad(model().sum(), angle)
    theta = model.theta().detach()

    def at(value):
        with torch.no_grad():
            angle.fill_(value)
            single, batch = model(theta), model(theta.repeat(2, 1))
        torch.testing.assert_close(batch, single.expand(2, -1), rtol=1e-12, atol=1e-12)
        return single

    step = 1e-6
    up, down = at(0.1 + step), at(0.1 - step)
    assert float(slope) == pytest.approx(float((up - down).sum() / (2 * step)), rel=1e-5)
    still = LightCurve(scene, recording, effects=[])
    torch.testing.assert_close(at(0.0), still(theta).detach(), rtol=1e-12, atol=1e-12)


def test_the_listings_are_json():
    json.dumps(effects_listing(), allow_nan=False)


def test_the_pages_of_effects_are_made_from_the_class():
    """What the documentation's own builder writes of an effect that no file of it names."""
    specification = importlib.util.spec_from_file_location("conf", ROOT / "docs" / "conf.py")
    builder = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(builder)
    listing = {effect["name"]: effect for effect in effects_listing()}
    for cls in (ThinCloud, UnevenErrors):
        page = "\n".join(builder.section(listing[cls.name]))
        assert f"### {cls.name}" in page and cls.title.capitalize() in page
        for quantity in cls.quantities:
            assert f"| `{cls.name}.{quantity.name}` | {quantity.unit} |" in page
            assert quantity.meaning in page


MINE = [
    (registry_, name, cls)
    for registry_ in (EFFECTS, MODELS, SHAPES, FORMATS, FIGURES)
    for name, cls in registry_.outside().items()
    if cls.__module__ == __name__
]
for registry_, name, _ in MINE:
    registry_.pop(name)
