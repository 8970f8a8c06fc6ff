"""An addition is one class: an effect, a law of reflection, a shape, a noise model, a reader and a figure, defined in
``tests/additions.py`` and nowhere else, go from TOML and a file through simulate, fit, sample, diagnose and report to the
listings and the pages."""

from __future__ import annotations

import importlib.util
import json
import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchlc
from tests.additions import (
    ADDITIONS,
    ConstantGlow,
    Hexagon,
    NightLog,
    Spread,
    ThinCloud,
    UnevenErrors,
    known,
    scene_with,
)
from tests.effects.passes import rows
from torchlc.brdf import MODELS, Brdf
from torchlc.cli import completion
from torchlc.diagnosis.alternatives import under_other_laws
from torchlc.effects import Effect
from torchlc.lightcurve.model import LightCurve
from torchlc.naming import Replaced
from torchlc.readers.format import FORMATS, Format
from torchlc.readers.formats import formats
from torchlc.report.figures.contract import FIGURES, ReportFigure
from torchlc.report.listing import effects_listing
from torchlc.scene import Scene
from torchlc.shapes import SHAPES, Component, Part
from torchlc.stages.effect import EFFECTS


@pytest.fixture(scope="module", autouse=True)
def additions():
    with known(ADDITIONS):
        yield


ROOT = Path(__file__).parent.parent
TRUE_CLOUD = '"thin_cloud.mag" = 0.5\n"thin_cloud.hour" = 3.1'


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


CELL = """
from dataclasses import replace
from torchlc.effects import Effect
from torchlc.parameters import Quantity

class Veil(Effect):
    \"\"\"A veil dims everything.

    Neglects its colour.
    \"\"\"

    name = "veil"
    stage = "detector"
    quantities = (Quantity("mag", "mag", 0.0, 1.0, "dimming", off=0.0, typical=0.2),)

    def detector(self, brightness, p, context):
        return replace(brightness, flux=brightness.flux * 10 ** (-0.4 * FACTOR * p["mag"]))
"""


@pytest.mark.parametrize("kind", ["effect", "law", "shape", "reader", "figure"])
def test_a_cell_that_runs_again_is_told_each_time_at_its_own_line(kind: str) -> None:
    """As a notebook runs a cell: compiled anew, with the warnings of the cell before forgotten."""
    registry, base, head = {
        "effect": (EFFECTS, Effect, "name = 'again'\n    stage = 'detector'"),
        "law": (MODELS, Brdf, "model = 'again'"),
        "shape": (SHAPES, Part, "kind = 'again'\n    keys = Component"),
        "reader": (FORMATS, Format, "name = 'again'"),
        "figure": (FIGURES, ReportFigure, "name = 'again'"),
    }[kind]
    cell = {"base": base, "Component": Component, "__name__": "__main__"}
    source = f"class Again(base):\n    {head}\n"
    with registry.restored(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for number in range(4):
            cell.pop("__warningregistry__", None)
            exec(compile(source, f"cell-{number}", "exec"), cell)
    assert [one.filename for one in caught] == ["cell-1", "cell-2", "cell-3"]
    assert all(issubclass(one.category, Replaced) for one in caught)


def test_a_figure_of_a_page_that_is_not_there_is_refused() -> None:
    with pytest.raises(TypeError, match="figure 'lost': page 'fits'; expected one of fit, diagnosis"):
        type("Lost", (ReportFigure,), {"name": "lost", "page": "fits"})


def test_a_class_of_a_notebook_is_known_at_once_and_what_its_cell_says_last_counts():
    """Run as a kernel does, in one namespace named ``__main__``: what is made before keeps to the class that it was made with."""
    night = {"start": "2020-10-17T14:00:00", "hours": 2.0, "cadence": 1200.0}
    notebook = {"__name__": "__main__"}
    with EFFECTS.restored():
        exec(CELL.replace("FACTOR", "1"), notebook)
        scene = scene_with('["veil"]', '"veil.mag" = 0.25')
        first = LightCurve(scene, rows(scene, cadence_s=1800.0))
        clear, veiled = (torchlc.simulate(one, **night).mag for one in (scene_with(), scene))
        np.testing.assert_allclose(veiled - clear, 0.25, atol=1e-12)
        before = first().detach()
        with pytest.warns(Replaced, match="veil"):
            exec(CELL.replace("FACTOR", "2"), notebook)
        np.testing.assert_allclose(torchlc.simulate(scene, **night).mag - clear, 0.5, atol=1e-12)
        torch.testing.assert_close(first().detach(), before, rtol=0, atol=0)
    assert "veil" not in EFFECTS


def test_an_effect_of_no_stage_is_refused_at_once():
    with pytest.raises(TypeError, match="effect 'astray': stage 'nowhere'; expected one of clock, "):
        type("Astray", (Effect,), {"name": "astray", "stage": "nowhere"})


def test_the_listings_are_json():
    json.dumps(effects_listing(), allow_nan=False)


def builder_of(page: str):
    """The documentation's own builder of a page, of this path below docs."""
    specification = importlib.util.spec_from_file_location(Path(page).stem, ROOT / "docs" / page)
    builder = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(builder)
    return builder


def test_the_page_of_laws_is_made_from_the_class():
    page = "\n".join(builder_of("physics/law_library.py").law(ConstantGlow))
    assert "## constant-glow" in page and "light that goes with the area alone" in page
    assert "| `glow` |  | 0 | 1 | flux of a unit area |" in page
    assert "`glow` + `r_diff` is at most 1." in page and "[phong-mirror](#phong-mirror)" in page


def test_the_tables_of_shapes_formats_and_figures_are_made_from_the_classes():
    """Rows of the documentation's own builder for classes that no file of it names, as their docstrings have them."""
    tables = builder_of("addition_tables.py").addition_tables()
    keys = "| `hexagon` | `radius`, `length` |  | `radius`, `length` |"
    described = 'Six sides, "top" and "bottom" (two facets each); u along Z on the sides, along X at the ends. A prism about Z: '
    assert f"{keys} {described}`radius` to its six edges. |" in tables["every_shape"].splitlines()
    log = '| night log | text | Lines "12.345 +- 0.010 at 2459140.1", as an observer may keep them. |'
    assert log in tables["every_format"].splitlines()
    figures = tables["every_figure"].splitlines()
    assert "| fit | `spread.png` | Residuals in order | Residuals in order of size. |" in figures


def test_the_tables_say_what_a_class_says_of_itself():
    """A class without a docstring has an empty cell, not the words of its base; what follows a first sentence is an entry
    below the table; keys with a default are those that a component may have."""
    builder = builder_of("addition_tables.py")
    with SHAPES.restored(), FORMATS.restored():
        bare = type("Bare", (Part,), {"kind": "bare", "keys": Component, "__module__": __name__})
        assert builder.shape_row(bare) == ("`bare`", "", "", "", "")
        words = "Rows of a diary. Its dates are UTC.\n\n:mod:`torchlc.readers.dates` reads ``|`` too."
        type("Diary", (NightLog,), {"name": "diary", "files": "`.txt`", "__doc__": words})
        assert "| diary | `.txt` | Rows of a diary. |" in builder.every_format().splitlines()
        details = builder.format_details().splitlines()
        assert r"- **diary.** Its dates are UTC. `dates` reads `\|` too." in details
    assert builder.shape_row(SHAPES["plate"])[:4] == (
        "`plate`",
        "`size`, `u`, `v`",
        "`back_material`",
        "`size`",
    )


def test_the_pages_of_effects_are_made_from_the_class():
    """What the documentation's own builder writes of an effect that no file of it names."""
    builder = builder_of("effects/effect_library.py")
    listing = {effect["name"]: effect for effect in effects_listing()}
    for cls in (ThinCloud, UnevenErrors):
        page = "\n".join(builder.section(listing[cls.name]))
        assert f"### {cls.name}" in page and cls.title.capitalize() in page
        for quantity in cls.quantities:
            assert f"| `{cls.name}.{quantity.name}` | {quantity.unit} |" in page
            assert quantity.meaning in page
