"""The verbs on a small scene: what they return, write and refuse."""

from __future__ import annotations

import json
import math
from datetime import datetime, timedelta, timezone
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
import torch
from astropy.table import Table
from astropy.time import Time

import torchlc
from tests.small_case import write_case
from torchlc.digits import number_of, stated
from torchlc.errors import InputError
from torchlc.inference.period import find_period
from torchlc.results.fit_result import FitResult

TRUTH = {"panel.n": 200.0, "panel.r_spec": 0.05, "panel.r_diff": 0.05}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_case(tmp_path_factory.mktemp("case"))


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="module")
def result(case: tuple[Path, Path], out: Path) -> FitResult:
    return torchlc.fit(*case, steps=400, seed=1, out=out)


def test_simulated_curve_has_every_column_and_shares_that_sum_to_one(case: tuple[Path, Path]):
    curve = torchlc.simulate(case[0], case[1])
    table = curve.to_table()
    assert table.colnames[:9] == [
        "time", "station", "mag", "flux", "range_km", "phase_angle_deg", "elevation_deg", "airmass", "eclipse_fraction",
    ]  # fmt: skip
    total = table["share body"] + table["share panel"]
    np.testing.assert_allclose(total, 1.0, atol=1e-9)
    recorded = torchlc.load(*case)[1]
    delta = recorded.observed - curve.mag
    assert abs(delta.mean()) < 4 * 0.02 / math.sqrt(len(delta))
    assert 0.014 < delta.std() < 0.027, "the noise asked for, 0.02 mag"
    np.testing.assert_allclose(-2.5 * np.log10(curve.flux) - 26.7, curve.mag, atol=1e-9)


def test_eclipse_fraction_is_that_of_the_geometry_whatever_the_model(tmp_path: Path):
    """A geostationary satellite two weeks from the equinox is in umbra around local midnight, and lit at
    dusk.
    """
    scene, _ = write_case(tmp_path)
    curve = torchlc.simulate(scene, start="2020-10-10T10:00:00", hours=12, cadence=300)
    eclipse = curve.columns["eclipse_fraction"]
    assert eclipse is not None
    assert eclipse[0] == 0 and eclipse.max() == 1
    assert ((eclipse >= 0) & (eclipse <= 1)).all()
    dark_hours = (eclipse > 0.5).sum() * 300 / 3600
    assert 0.3 < dark_hours < 1.2, "72 min at most for a geostationary orbit"
    assert np.isfinite(curve.mag[eclipse > 0.5]).all(), "the scene's model has no Earth shadow"


def test_rows_without_light_are_blank_and_null(tmp_path: Path):
    scene, _ = write_case(tmp_path)
    scene.write_text(scene.read_text().replace('["self_shadowing"]', '["earth_shadow"]'))
    curve = torchlc.simulate(scene, start="2020-10-10T10:00:00", hours=12, cadence=300)
    dark = ~np.isfinite(curve.mag)
    assert dark.any() and (curve.flux[dark] == 0).all()
    table = Table.read(curve.write(tmp_path / "curve.ecsv"), format="ascii.ecsv")
    assert table["mag"].mask[dark].all() and table["share body"].mask[dark].all()
    assert curve.to_json()["rows_without_light"] == dark.sum()
    assert json.dumps(curve.to_json(), allow_nan=False)


def test_a_simulated_curve_is_a_recording(case: tuple[Path, Path], tmp_path: Path):
    path = torchlc.simulate(*case).write(tmp_path / "curve.ecsv")
    recording = torchlc.load(case[0], path)[1]
    assert recording.error is None and len(recording) == 49
    np.testing.assert_allclose(torchlc.simulate(case[0], path).mag, recording.observed, atol=1e-6)


def test_vectors_survive_simulation(tmp_path: Path):
    from tests.good_input import VECTOR_RECORDING, VECTOR_SCENE

    (tmp_path / "scene.toml").write_text(VECTOR_SCENE)
    (tmp_path / "obs.csv").write_text(VECTOR_RECORDING)
    first = torchlc.simulate(tmp_path / "scene.toml", tmp_path / "obs.csv")
    again = torchlc.simulate(tmp_path / "scene.toml", first.write(tmp_path / "curve.ecsv"))
    lit = np.isfinite(first.mag)
    assert lit.any()
    np.testing.assert_allclose(again.mag, first.mag[lit], atol=1e-9)


def test_noise_effects_of_the_scene_widen_what_is_not_quoted(tmp_path: Path):
    scene, _ = write_case(tmp_path)
    text = scene.read_text().replace('["self_shadowing"]', '["self_shadowing", "jitter"]')
    scene.write_text(text + '"jitter.mag" = 0.3\n')
    grid = {"start": "2020-10-17T15:00:00", "hours": 4.0, "cadence": 30.0}
    noisy, clean = (torchlc.simulate(scene, **grid, noise=noise, seed=2) for noise in (0.01, None))
    table = noisy.to_table()
    assert set(table["mag_err"]) == {0.01}
    assert np.std(noisy.mag - clean.mag) == pytest.approx(math.hypot(0.3, 0.01), rel=0.1)


@pytest.mark.long
def test_fit_finds_what_was_put_in(result: FitResult):
    for name, truth in TRUTH.items():
        row = result.parameters()[name]
        assert abs(row["median"] - truth) < 4 * row["sd"], name
        assert row["q05"] < row["median"] < row["q95"]
        assert row["informed"]
    assert abs(result.fit.chi2 - result.fit.dof) < 5 * math.sqrt(2 * result.fit.dof)
    assert result.rms_mag == pytest.approx(0.02, rel=0.3)  # three times 1 / sqrt(2 * 49 rows)


def test_fit_json_is_what_formats_says(result: FitResult, out: Path):
    content = json.loads((out / "fit.json").read_text())
    assert content["schema"] == "torchlc-fit/1"
    keys = "converged reason error_source dropped parameters gains modes chi2 dof rms_mag rms_relative acceptance"
    keys += " autocorrelation_time samples seconds components materials warnings"
    assert set(keys.split()) <= set(content)
    assert set(content["parameters"]) == {*TRUTH, "zero_point"}
    row = content["parameters"]["panel.n"]
    assert set(row) == {"map", "median", "sd", "q05", "q95", "rhat", "ess", "unit", "informed"}
    assert content["dof"] == 49 - 4
    assert content["error_source"] == "recording"
    assert sum(one["mean_share"] for one in content["components"].values()) == pytest.approx(1.0)
    assert sum(one["probability"] for one in content["materials"]["panel"]) == pytest.approx(1.0)
    assert content["samples"] == len(result.posterior.flat)
    assert content["provenance"]["inputs"]["scene"]["sha256"]


def test_chi2_is_that_of_the_rows_at_the_map(result: FitResult, case: tuple[Path, Path]):
    """Evaluated as a fixed scene: chi-square from the simulated curve and the recording, no code of the
    fit.
    """
    text = case[0].read_text()
    for name, entry in result.parameters().items():
        short = name.rpartition(".")[2]
        start = (
            text.index(f"{short} ", text.index("[materials.panel]"))
            if short != "zero_point"
            else text.index(short)
        )
        end = text.index("}", start) + 1
        text = text[:start] + f"{short} = {entry['map']!r}" + text[end:]
    fixed = case[0].parent / "fixed.toml"
    fixed.write_text(text)
    recording = torchlc.load(fixed, case[1])[1]
    model = torchlc.simulate(fixed, case[1]).mag
    chi2 = float((((recording.observed - model) / recording.error) ** 2).sum())
    assert chi2 == pytest.approx(result.fit.chi2, rel=1e-9)


def test_posterior_files_hold_the_draws(result: FitResult, out: Path):
    import arviz
    import emcee

    posterior = result.posterior
    assert posterior is not None
    data = arviz.from_netcdf(str(out / "posterior.nc"))
    np.testing.assert_array_equal(data["posterior"]["panel.n"].values, posterior.theta[..., 0].numpy())
    backend = emcee.backends.HDFBackend(str(out / "chain.h5"), read_only=True)
    chain = backend.get_chain(discard=posterior.burn, thin=posterior.thin)
    natural = result.model.parameter_set.from_straight(torch.as_tensor(chain))[0].transpose(0, 1)
    torch.testing.assert_close(natural, posterior.theta)
    names = {path.name for path in out.iterdir()}
    assert names == {
        "fit.json", "posterior.nc", "chain.h5", "report.html", "curve.png", "shares.png", "object.png", "corner.png", "traces.png",
        "torchlc-manifest.json",
    }  # fmt: skip


def test_the_result_is_worth_reading(result: FitResult):
    text = repr(result)
    assert "49 rows" in text and "panel.n" in text and "±" in text
    assert "<td>panel.n</td>" in result._repr_html_()
    assert list(result.to_table()["name"]) == [*TRUTH, "zero_point"]
    assert "matplotlib" in type(result.plot_shares()).__module__
    import matplotlib.pyplot as plt

    plt.close("all")


def test_nothing_free_is_evaluated_and_not_sampled(case: tuple[Path, Path], tmp_path: Path):
    import re

    text = re.sub(r"\{ value = ([\d.e+]+),[^}]*\}", r"\1", case[0].read_text())
    (tmp_path / "scene.toml").write_text(text)
    result = torchlc.fit(tmp_path / "scene.toml", case[1], out=tmp_path / "out")
    content = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert content["parameters"] == {} and content["samples"] == 0 and content["acceptance"] is None
    assert content["dof"] == 49 and content["converged"]
    assert result.posterior is None and "Nothing was free" in (tmp_path / "out" / "report.html").read_text()
    assert not (tmp_path / "out" / "chain.h5").exists() and not (tmp_path / "out" / "posterior.nc").exists()


def test_errors_that_are_too_small_get_a_jitter_and_a_warning(case: tuple[Path, Path], tmp_path: Path):
    """Of a recording with 0.02 mag of noise that quotes 0.002, the jitter is 0.02 again."""
    table = Table.read(case[1], format="ascii.ecsv")
    table["mag_err"][:] = 0.002
    table.write(tmp_path / "obs.ecsv", format="ascii.ecsv")
    result = torchlc.fit(case[0], tmp_path / "obs.ecsv", steps=200)
    # 1 / sqrt(2 * 49 rows) is 10 %
    assert result.parameters()["jitter.mag"]["median"] == pytest.approx(0.02, rel=0.35)
    assert any("a jitter was added" in text for text in result.all_warnings)
    assert result.to_json()["chi2"] > 49 * 20, "chi-square stays at the quoted errors"


def test_noise_of_a_recording_without_errors_is_fitted(case: tuple[Path, Path], tmp_path: Path):
    table = Table.read(case[1], format="ascii.ecsv")
    table.remove_columns(["mag_err", "flux_err"])
    table.write(tmp_path / "obs.ecsv", format="ascii.ecsv")
    content = torchlc.fit(case[0], tmp_path / "obs.ecsv", steps=200).to_json()
    assert content["error_source"] == "fitted"
    row = content["parameters"]["noise[weihai]"]
    assert row["q05"] < 0.02 < row["q95"] and row["rhat"] is None
    # of a level from 49 rows, itself within 10 %, drawn 400 times
    assert row["sd"] == pytest.approx(row["median"] / math.sqrt(2 * 49), rel=0.15)


def test_rows_below_the_horizon_are_dropped_and_counted(case: tuple[Path, Path], tmp_path: Path):
    """Seen from the antipode of Weihai the satellite never rises; from a place at its horizon some rows are
    lost.
    """
    scene = tmp_path / "scene.toml"
    scene.write_text(case[0].read_text().replace("122.05", "-57.95").replace("37.536", "-37.536"))
    with pytest.raises(InputError, match="below the horizon"):
        torchlc.fit(scene, case[1])
    low = torchlc.simulate(case[0], start="2020-10-17T15:00:00", hours=4.0, cadence=300.0)
    elevation = low.columns["elevation_deg"]
    assert elevation is not None
    # the satellite is near 106 E: move the station west until its elevation passes 0 during the recording
    for longitude in np.arange(30.0, 25.0, -0.02):
        scene.write_text(case[0].read_text().replace("122.05", f"{longitude:.2f}").replace("37.536", "10.0"))
        elevation = torchlc.simulate(scene, case[1]).columns["elevation_deg"]
        assert elevation is not None
        below = int((elevation <= 0).sum())
        if 0 < below < 40:
            break
    else:
        pytest.skip("the orbit is too still")
    recording = torchlc.api.usable(torchlc.load(scene), case[1])
    assert recording.dropped == {"below the horizon": below} and len(recording) == 49 - below


def test_what_is_only_a_scale_of_relative_flux_is_not_informed(tmp_path: Path):
    """A Lambert body's albedo, and all sizes together, scale the light alone; a lobe's exponent does not."""
    scene, _ = write_case(tmp_path)
    text = scene.read_text()
    start, end = text.index("[materials.panel]"), text.index("[model]")
    text = (
        text[:start]
        + '[materials.panel]\nmodel = "lambert"\nalbedo = { value = 0.3, low = 0.0, high = 1.0 }\n'
        + text[end:]
    )
    start, end = text.index("[materials.body]"), text.index("[materials.panel]")
    text = (
        text[:start]
        + '[materials.body]\nmodel = "lambert"\nalbedo = { value = 0.5, low = 0.0, high = 1.0 }\n'
        + text[end:]
    )
    scene.write_text(text)
    curve = torchlc.simulate(scene, start="2020-10-17T12:00:00", hours=8.0, cadence=600.0, noise=0.01)
    table = curve.to_table()
    table.remove_columns(["mag", "mag_err"])
    for name in ("flux", "flux_err"):
        table[name] = table[name] / np.median(curve.flux)
    table.write(tmp_path / "flux.ecsv", format="ascii.ecsv")
    result = torchlc.fit(scene, tmp_path / "flux.ecsv", steps=200)
    content = result.to_json()
    assert (
        not content["parameters"]["panel.albedo"]["informed"]
        and not content["parameters"]["body.albedo"]["informed"]
    )
    assert any("relative to one another" in text for text in content["warnings"])
    assert content["gains"]["weihai"] > 0
    # 0.01 mag of 49 rows: a standard deviation is 10 %
    assert content["rms_relative"] == pytest.approx(0.01 * math.log(10) / 2.5, rel=0.3)


def test_a_lobe_whose_glint_never_comes_near_is_not_informed(tmp_path: Path):
    """The body of Object 2: no glint within 20 deg of any facet, so its exponent keeps its prior, with the
    reason.
    """
    scene, _ = write_case(tmp_path)
    text = scene.read_text().replace(
        "n = 1000.0", 'n = { value = 1000.0, low = 300.0, high = 1e6, prior = "loguniform" }'
    )
    scene.write_text(text)
    curve = torchlc.simulate(scene, start="2020-10-17T19:30:00", hours=2.0, cadence=300.0, noise=0.02)
    result = torchlc.fit(scene, curve.write(tmp_path / "obs.ecsv"), steps=300)
    assert not result.parameters()["body.n"]["informed"]
    (warning,) = [text for text in result.all_warnings if text.startswith("body.n is set by its prior")]
    assert "no glint comes within" in warning and "deg of any body facet" in warning


def test_a_prior_that_the_data_contradict_is_told(case: tuple[Path, Path], tmp_path: Path):
    text = (
        case[0]
        .read_text()
        .replace(
            "r_spec = { value = 0.05, low = 0.0, high = 1.0 }",
            'r_spec = { value = 0.08, sigma = 0.002, prior = "normal", low = 0, high = 1 }',
        )
    )
    (tmp_path / "scene.toml").write_text(text)
    result = torchlc.fit(tmp_path / "scene.toml", case[1], steps=200)
    (warning,) = [
        text for text in result.all_warnings if "prior in tension" in text and "panel.r_spec" in text
    ]
    assert "sigma from its prior (0.08" in warning


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps: 0"),
        ({"walkers": 6}, "walkers: 6; expected at least 10 for 4 free parameters"),
        ({"resume": True}, "resume: no output"),
        ({"use": "counts"}, "use: .counts"),
    ],
)
def test_impossible_options_are_refused_before_anything_is_written(
    case: tuple[Path, Path], tmp_path: Path, options: dict[str, object], message: str
):
    out = None if "resume" in options else tmp_path / "out"
    with pytest.raises(InputError, match=message):
        torchlc.fit(*case, out=out, **options)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "not all of start"),
        ({"start": "2020-10-17T15:00", "hours": 1.0}, "not all of start"),
        ({"start": "yesterday", "hours": 1.0, "cadence": 60.0}, "start: "),
        ({"start": "2020-10-17T15:00", "hours": -1.0, "cadence": 60.0}, "hours, cadence"),
        ({"start": "2020-10-17T15:00", "hours": 1.0, "cadence": 60.0, "noise": -0.1}, "noise"),
        ({"start": "2020-10-17T15:00", "hours": 1e9, "cadence": 0.001}, "cadence"),
    ],
)
def test_impossible_grids_are_refused(case: tuple[Path, Path], arguments: dict[str, object], message: str):
    with pytest.raises(InputError, match=message):
        torchlc.simulate(case[0], **arguments)


def test_values_are_stated_with_the_digits_their_uncertainty_bears():
    def row(median: float, sd: float, unit: str = "") -> dict[str, object]:
        return {"median": median, "sd": sd, "q05": median - 1.6 * sd, "q95": median + 1.6 * sd, "unit": unit}

    assert stated(row(90.1412, 0.5579)) == "90.14 ± 0.56"
    assert stated(row(0.0806942, 0.00080, "mag")) == "0.08069 ± 0.00080 mag"
    assert stated(row(1234.6, 57.2)) == "1235 ± 57"
    assert stated(row(42.3, 180_000.0)) == "42 ± 180000"
    assert stated({"median": 40.0, "sd": 90.0, "q05": 30.0, "q95": 400.0, "unit": ""}) == "40 (30 to 400)"


def test_numbers_stand_before_a_singular_or_a_plural():
    assert [number_of(count, "measured row") for count in (0, 1, 2)] == [
        "0 measured rows",
        "1 measured row",
        "2 measured rows",
    ]
    assert number_of(1, "pass") == "1 pass" and number_of(2, "pass") == "2 passes"
    assert number_of(0.96, "step") == "1 step" and number_of(math.nan, "step") == "nan steps"


def test_a_recording_of_one_row_is_told_in_the_singular(case: tuple[Path, Path]):
    curve = torchlc.simulate(case[0], start="2020-10-17T15:00", hours=0.01, cadence=3600.0, noise=0.02)
    assert ": 1 row, " in curve.headline()
    one = torchlc.load(case[0], curve.to_table())[1]
    assert "1 row of mag" in repr(one)
    with pytest.raises(InputError, match=r"^1 measured row; expected at least \d+ to find a period"):
        find_period(one)


@pytest.mark.parametrize(
    "start",
    [
        "2020-10-17",
        Time("2020-10-17", scale="utc"),
        Time("2020-10-17", scale="utc").tdb,
        datetime(2020, 10, 17),
        datetime(2020, 10, 17, 8, tzinfo=timezone(timedelta(hours=8))),
        np.datetime64("2020-10-17"),
        2459139.5,
    ],
)
def test_a_start_is_whatever_holds_an_instant(case: tuple[Path, Path], start):
    curve = torchlc.simulate(case[0], start=start, hours=60 * u.min, cadence=0.5 * u.h)
    assert abs((curve.recording.time[0] - Time("2020-10-17", scale="utc")).to_value(u.s)) < 1e-4
    assert curve.recording.seconds.tolist() == [0.0, 1800.0, 3600.0]


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"start": Time(["2020-10-17", "2020-10-18"])}, "start: 2 times; expected one time"),
        ({"start": [2020, 10, 17]}, "start: list; expected ISO UTC, a Julian date, a Time or a datetime"),
        ({"start": "2020-10-17", "hours": 3 * u.m}, "hours: 3.0 m; expected one quantity in h"),
    ],
)
def test_what_holds_no_instant_or_amount_is_refused(case: tuple[Path, Path], said: dict, message: str):
    with pytest.raises(InputError) as caught:
        torchlc.simulate(case[0], **({"hours": 1, "cadence": 600} | said))
    assert str(caught.value) == message


def test_what_is_no_scene_recording_or_result_is_refused_in_words(case: tuple[Path, Path], tmp_path: Path):
    with pytest.raises(InputError, match="scene: NoneType; expected a path or a Scene"):
        torchlc.load(None)
    with pytest.raises(InputError, match="columns: int; expected a text or a mapping"):
        torchlc.load(*case, columns=5)
    with pytest.raises(InputError, match="a Scene and a Recording, as torchlc"):
        torchlc.LightCurve(*case)
    with pytest.raises(InputError, match="result: Scene; expected what fit or diagnose returns"):
        torchlc.write_report(torchlc.load(case[0]), tmp_path / "page.html")
    with pytest.raises(InputError, match="effects: unknown effect 'foo'"):
        torchlc.diagnose(*case, effects="jitter,foo")
