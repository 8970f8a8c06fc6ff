"""The report in a real browser: it renders, the slider moves the object, and a hostile name stays text."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from matplotlib.colors import to_hex
from matplotlib.text import Text

import torchlc
from tests.chromium import PROGRAM, Page
from tests.small_case import NAME, write_case
from torchlc.diagnosis.result import Diagnosis
from torchlc.figures.raster import Mesh, looking_along, render
from torchlc.figures.style import PALETTE
from torchlc.lightcurve.model import LightCurve
from torchlc.report.figures.contract import INKS, draw_all
from torchlc.results.fit_result import FitResult

browser = pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    folder = tmp_path_factory.mktemp("case")
    scene, recording = write_case(folder, name=NAME)
    hostile = "pa<img src=x onerror=alert(2)>nel"
    text = (
        scene.read_text()
        .replace('name = "panel"', f"name = '{hostile}'")
        .replace("sigma = 0.02", "sigma = 0.002")
    )
    scene.write_text(text)
    return torchlc.fit(scene, recording, steps=60)


@pytest.fixture(scope="module")
def page(result: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return torchlc.write_report(result, tmp_path_factory.mktemp("report") / "report.html")


class Reader(HTMLParser):
    """Tags with their attributes, in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_the_page_asks_nothing_of_any_network_and_holds_no_foreign_tag(page: Path):
    text = page.read_text()
    reader = Reader(text)
    assert "alert(1)</script>" not in text and "onerror=alert(2)>" not in text
    assert [tag for tag, _ in reader.tags].count("script") == 2, "the data and the viewer"
    for tag, attributes in reader.tags:
        for name in ("src", "href", "xlink:href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
    assert not re.search(r"url\(\s*['\"]?https?:", text) and "@import" not in text


def test_everything_drawn_has_words_for_those_who_do_not_see_it(page: Path):
    reader = Reader(page.read_text())
    pictures = [
        attributes
        for tag, attributes in reader.tags
        if tag == "canvas" or (tag == "svg" and "role" in attributes)
    ]
    assert len(pictures) == 6
    assert all(len(one.get("aria-label") or "") > 20 for one in pictures)
    controls = [a for tag, a in reader.tags if tag == "input"]
    assert all(one.get("aria-label") for one in controls)
    assert dict(reader.tags)["html"] == {"lang": "en"}


def test_the_first_paragraph_says_what_matters(result: FitResult, page: Path):
    from torchlc.report.fit_page import substances, words

    text = " ".join(words(result))
    assert "49 rows" in text and "chi-square is" in text
    assert "Not determined by these data: offset added to every magnitude (zero_point)" in text
    ((material, values),) = substances(result)
    assert (
        material == "panel"
        and values.startswith("lobe exponent (n) 20")
        and "diffuse reflectance (r_diff) 0.05" in values
    )
    shown = page.read_text()
    assert shown.index("49 rows to") < shown.index("What it is made of")
    assert result.provenance["inputs"]["recording"]["sha256"] in shown


def test_every_free_number_is_said_in_words_beside_its_name(tmp_path: Path):
    """Sizes, spin, effects and calibration as much as materials; the words are those of the field, not the name again."""
    from torchlc.report.page import titled_with_owner

    scene, recording = write_case(tmp_path, rows=9)
    text = re.sub(
        r"size = \[([\d.]+), ", r"size = [{ value = \1, sigma = 0.1, low = 0.1 }, ", scene.read_text()
    )
    text = text.replace(
        'mode = "nadir"',
        'mode = "nadir"\nspin_axis = [0, 0, 1]\nspin_rate = { value = 1.0, low = 0.5, high = 1.5 }',
    )
    scene.write_text(text.replace("effects = [", 'effects = ["attitude_offset", '))
    model = LightCurve(*torchlc.load(scene, recording))
    said = {free.name: titled_with_owner(free) for free in model.parameter_set.free}
    assert said["body.size_x"] == "length along its x axis, body (body.size_x)"
    assert said["attitude.spin_rate"] == "rate of the spin (attitude.spin_rate)"
    assert said["panel.r_diff"] == "diffuse reflectance, panel (panel.r_diff)"
    for name, words in said.items():
        assert words.endswith(f" ({name})"), words
        before = words.removesuffix(f" ({name})")
        assert before and "_" not in before and name not in before, words
    units = {free.name: free.unit for free in model.parameter_set.free}
    assert units["attitude.spin_rate"] == "rev/h" and units["body.size_x"] == "m"


def test_the_numbers_of_every_shape_and_every_attitude_have_words():
    from torchlc.scene.parts import SHAPES, Attitude

    given = {
        "pole",
        "period",
        "phase",
        "epoch",
        "nutation",
        "inertia",
        "tilt",
        "period_rate",
        "polhode_phase",
    }
    body = Attitude.model_validate(
        {
            "mode": "rigid-body",
            "pole": [10.0, 20.0],
            "period": 0.1,
            "phase": 3.0,
            "epoch": "2020-01-01T00:00:00",
            "nutation": 20.0,
            "inertia": [0.9, 0.8],
            "tilt": [1.0, 2.0, 3.0],
            "period_rate": 1.0,
            "polhode_phase": 4.0,
        }
    )
    assert given <= body.model_fields_set
    turned = Attitude(mode="inertial", x_angle=3.0)
    assert {*body.numbers(), *turned.numbers()} == set(Attitude.MEANINGS)
    for shape in SHAPES.values():
        for key in ("size_x", "size_u", "radius_top"):
            assert "_" not in shape.keys.meaning(key)


def test_fewer_rows_than_numbers_are_told_in_words(tmp_path: Path):
    """Two rows and six free numbers: no page, headline or stored fit speaks of -4 degrees of freedom."""
    scene, recording = write_case(tmp_path, rows=2)
    result = torchlc.fit(scene, recording, steps=20, walkers=20, out=tmp_path / "out")
    assert result.fit.dof < 0
    page = (tmp_path / "out" / "report.html").read_text()
    for told in (page, result.headline(), repr(torchlc.load_fit(tmp_path / "out"))):
        assert "with fewer measured rows than free numbers" in told
        assert not re.search(r"-\d+ degree", told)


def test_a_chain_too_short_to_judge_shows_no_nan(tmp_path: Path):
    """Three steps have no R-hat: the table says so in words."""
    result = torchlc.fit(*write_case(tmp_path, rows=9), steps=3)
    assert result.posterior is not None and not np.isfinite(result.posterior.rhat).all()
    text = torchlc.write_report(result, tmp_path / "report.html").read_text()
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", text)
    assert "not known" in cells and not {"nan", "inf"} & set(cells)


def test_the_first_paragraph_says_that_a_model_does_not_fit(tmp_path: Path):
    """Errors quoted ten times too small: what was added to them is not mistaken for a good fit."""
    from torchlc.report.fit_page import words

    scene, recording = write_case(tmp_path, noise=0.2)
    text = recording.read_text()
    recording.write_text(re.sub(r" 0\.2 ", " 0.02 ", text))
    result = torchlc.fit(scene, recording, steps=20)
    said = words(result)[0]
    assert said.startswith("The model does not fit: it is off by 0.") and "quotes errors of 0.02 mag" in said
    assert "follows" not in said and "torchlc diagnose" in said


@browser
def test_it_renders_and_the_slider_moves_the_object(page: Path):
    with Page(page) as tab:
        tab.settle()
        title = tab.run("document.querySelector('h1').textContent")
        assert title == NAME
        assert tab.run("window.alerted === undefined && document.querySelectorAll('img').length") == 0
        picture = "document.getElementById('object-canvas').toDataURL()"
        painted = "(() => { const c = document.getElementById('object-canvas'); const d = c.getContext('2d')"
        painted += ".getImageData(0, 0, c.width, c.height).data; let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 250;"
        painted += " return n / (c.width * c.height); })()"
        assert 0.01 < tab.run(painted) < 0.8
        before, told = tab.run(picture), tab.run("document.getElementById('object-text').textContent")
        slide = "(() => { const s = document.getElementById('object-time'); s.value = '3'; s.dispatchEvent(new Event('input')); })()"
        tab.run(slide)
        tab.settle()
        assert tab.run(picture) != before
        assert tab.run("document.getElementById('object-text').textContent") != told
        before = tab.run(picture)
        tab.run(
            "document.getElementById('object-canvas').dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))"
        )
        tab.settle()
        assert tab.run(picture) != before, "arrow keys turn it"
        before = tab.run(picture)
        tab.run("document.querySelector('[data-view=observer]').click()")
        tab.settle()
        assert tab.run(picture) != before
        assert (
            tab.run("document.querySelector('[data-view=observer]').getAttribute('aria-pressed')") == "true"
        )
        assert tab.problems == []


CONTRAST = """
(() => {
  const level = c => { const v = c / 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; };
  const rgb = text => text.match(/[\\d.]+/g).map(Number);
  const light = c => 0.2126 * level(c[0]) + 0.7152 * level(c[1]) + 0.0722 * level(c[2]);
  const ground = e => { for (; e; e = e.parentElement) { const c = rgb(getComputedStyle(e).backgroundColor);
    if (c.length < 4 || c[3] > 0) return c; } return [255, 255, 255]; };
  let worst = [99, ''];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || ['SCRIPT', 'STYLE', 'NOSCRIPT'].includes(element.tagName)) continue;
    if (element.closest('defs') || !element.getClientRects().length) continue;
    const style = getComputedStyle(element), svg = element.closest('svg');
    const [a, b] = [light(rgb(svg ? style.fill : style.color)), light(ground(element))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < worst[0]) worst = [ratio, element.outerHTML.slice(0, 120)];
  }
  return worst;
})()
"""


@browser
@pytest.mark.parametrize("dark", [False, True])
def test_contrast_is_that_of_wcag_aa_in_light_and_dark(page: Path, dark: bool):
    with Page(page, dark=dark) as tab:
        ratio, where = tab.run(CONTRAST)
        assert ratio >= 4.5, where
        paper = tab.run("getComputedStyle(document.body).backgroundColor")
        assert (paper == "rgb(20, 23, 27)") == dark


def test_letters_and_axes_of_every_figure_follow_the_dress_of_the_page(result: FitResult):
    """Letters are drawn as paths, which the test of contrast does not see: black ones would be lost on dark ground."""
    drawn = draw_all("fit", result)
    assert {"curve", "shares", "corner", "traces", "object"} <= {one.kind.name for one in drawn}
    for kind, figure, _ in drawn:
        letters = {to_hex(one.get_color()) for one in figure.findobj(Text) if one.get_text().strip()}
        edges = {to_hex(one.get_edgecolor()) for axes in figure.axes for one in axes.spines.values()}
        assert letters | edges <= {*INKS, *PALETTE}, kind.name


@browser
def test_it_fits_a_phone_and_prints(page: Path):
    with Page(page, width=360, height=740) as tab:
        tab.settle()
        wide = tab.run("document.documentElement.scrollWidth")
        assert wide == 360, "only figures and tables scroll sideways"
        assert tab.run("parseFloat(getComputedStyle(document.body).fontSize)") >= 16
        assert tab.pdf().startswith(b"%PDF")
        assert tab.problems == []


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """A drift, and 15 of 61 rows that are off by 1.5 mag."""
    scene, recording = write_case(tmp_path_factory.mktemp("diagnosed"), rows=61)
    table = Table.read(recording, format="ascii.ecsv")
    table["mag"] += 0.2 * np.arange(len(table)) * 4 / 60
    table["mag"][3::4] += 1.5 * (-1.0) ** np.arange(len(table["mag"][3::4]))
    table.write(recording, format="ascii.ecsv", overwrite=True)
    effects = ["zero_point_drift", "zero_point_step", "outliers"]
    return torchlc.diagnose(scene, recording, quick=True, effects=effects, seed=9)


def test_bad_rows_are_counted_in_words_and_listed_in_a_table(diagnosed: Diagnosis, tmp_path: Path):
    text = torchlc.write_report(diagnosed, tmp_path / "report.html").read_text()
    count = len(diagnosed.content["outliers"])
    assert count > 12
    assert f"{count} rows are probably bad: see the table of bad rows." in text
    table = text.partition('aria-label="Rows that are probably bad"')[2].partition("</table>")[0]
    assert table.count("<tr>") == 1 + 12 and f"{count - 12} more are in diagnosis.json" in text
    first = diagnosed.content["outliers"][0]["time"]
    assert f"<span>{first[:10]}</span> <span>{first[11:19]}</span>" in table


@browser
def test_tables_of_a_diagnosis_fit_a_phone(diagnosed: Diagnosis, tmp_path: Path):
    """Only those with sentences in their cells scroll, and keep the names in sight. No date, time or name breaks within."""
    page = torchlc.write_report(diagnosed, tmp_path / "report.html")
    with Page(page, width=390, height=844, dark=True) as tab:
        tab.settle()
        assert tab.run("document.documentElement.scrollWidth") == 390
        tables = "[...document.querySelectorAll('.wide:has(table)')]"
        plain = f"{tables}.filter(one => !one.querySelector('td.words'))"
        assert tab.run(f"{plain}.length") >= 2
        too_wide = f"{plain}.filter(one => one.scrollWidth > one.clientWidth)"
        assert tab.run(f"{too_wide}.map(one => one.ariaLabel).join()") == ""
        spans = "[...document.querySelectorAll('td.time span')]"
        assert tab.run(f"{spans}.length") > 20
        assert tab.run(f"{spans}.every(one => one.getClientRects().length === 1)")
        names = "[...document.querySelectorAll('td.name')]"
        assert tab.run(f"{names}.some(one => one.innerHTML.includes('zero_<wbr>point_<wbr>drift'))")
        moved = (
            f"{tables}.filter(one => one.querySelector('td.words')).every(one => {{ one.scrollLeft = 100;"
            " const name = one.querySelector('td.name').getBoundingClientRect().left;"
            " return one.scrollLeft > 50 && Math.abs(name - one.getBoundingClientRect().left) < 1; })"
        )
        assert tab.run(moved)
        assert tab.problems == []


def test_the_picture_of_a_plate_has_its_area_and_its_shadow():
    """A 2 m plate facing the camera fills (2 / span)^2 of the picture; one half as large before it shades a quarter."""

    def square(side: float, z: float) -> np.ndarray:
        a = side / 2
        corners = np.array([[-a, -a, z], [a, -a, z], [a, a, z], [-a, a, z]])
        return np.stack([corners[[0, 1, 2]], corners[[0, 2, 3]]])

    z = np.array([0.0, 0.0, 1.0])
    camera = looking_along(z, np.array([0.0, 1.0, 0.0]))
    alone = render(Mesh(square(2.0, 0.0), np.ones((2, 3))), camera, z, 300, 4.0)
    assert (alone[..., 3] > 0).mean() == pytest.approx(0.25, abs=0.005)
    assert alone[..., 0].max() == pytest.approx(1.0, abs=0.01), "full Sun on a white plate"
    colours = np.repeat([[1.0, 1, 1], [0.0, 0, 0]], 2, axis=0)
    both = Mesh(np.concatenate([square(2.0, 0.0), square(1.0, 3.0)]), colours)
    sun = np.array([0.0, 0.0, 1.0])
    aside = looking_along(np.array([0.9, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    image = render(both, aside, sun, 600, 8.0)
    white = (image[..., 3] > 0) & (image[..., 0] > 0.2)
    assert (image[..., 0][white] < 0.5).mean() == pytest.approx(0.25, abs=0.02)


def test_an_ever_coarser_mesh_keeps_its_extent():
    from torchlc.figures.viewer import simplified

    t = np.linspace(0, 2 * np.pi, 201)
    rings = np.stack([np.cos(t), np.sin(t)], -1)
    heights = np.linspace(-1, 1, 41)
    grid = np.concatenate([np.column_stack([rings, np.full(201, z)])[None] for z in heights])
    quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 3)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    fewer = simplified(triangles, 3000)
    assert 500 < len(fewer) <= 3000
    np.testing.assert_allclose(np.ptp(fewer.reshape(-1, 3), axis=0), [2, 2, 2], atol=0.15)
