"""From recordings to a rotation state: a body that the test lets spin, found from its light alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import torchlc
from tests.paper_orbits import HEIGHT, LATITUDE, LONGITUDE, ORBIT_3
from torchlc.cli import run
from torchlc.errors import InputError
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.inference.rotation.connect import connections
from torchlc.inference.rotation.facet_light import FacetLight
from torchlc.inference.rotation.modes import RotationMode, RotationSearch, verdict
from torchlc.inference.rotation.passes import RATE_A_DAY, Rows, rows_of
from torchlc.inference.rotation.pole_grid import directions, frame_of, search, spread
from torchlc.inference.rotation.refine import Local
from torchlc.inference.rotation.search import _changed
from torchlc.lightcurve.model import LightCurve
from torchlc.readers.joining import joined
from torchlc.results.rotation_result import RotationResult, _wider
from torchlc.scene import Free, Scene
from torchlc.tensors.non_negative import non_negative

PERIOD_S, POLE, PHASE = 61.7, (143.0, 36.0), 77.0
STARTS = ("2020-10-10T21:30:00", "2020-10-11T22:40:00")
ROWS, CADENCE = 90, 8.0


def text(attitude: str) -> str:
    return f"""
format = "torchlc-scene/1"
name = "dead"
[orbit]
tle = ["{ORBIT_3[0]}", "{ORBIT_3[1]}"]
[[stations]]
id = "weihai"
latitude = {LATITUDE}
longitude = {LONGITUDE}
height = {HEIGHT}
[attitude]
mode = "spin-pole"
epoch = "{STARTS[0]}"
{attitude}
[[components]]
name = "body"
shape = "box"
size = [1.2, 1.9, 2.6]
centre = [0, 0, 0]
material = "body"
[materials.body]
n = {{ value = 20.0, low = 1.0, high = 1000.0, prior = "loguniform" }}
r_spec = {{ value = 0.2, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.35, low = 0.0, high = 1.0 }}
[model]
effects = ["sun_distance"]
[model.parameters]
band_sun_magnitude = -26.7
"""


UNKNOWN = (
    "pole = [{ value = 0, low = -360, high = 360 }, { value = 0, prior = 'isotropic' }]\n"
    "period = { value = 0.0171, low = 0.0166, high = 0.0177 }\nphase = { value = 0, low = -360, high = 360 }"
)
TRUE = f"pole = [{POLE[0]}, {POLE[1]}]\nperiod = {PERIOD_S / 3600!r}\nphase = {PHASE}"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """The scene of who knows nothing, and the recordings of two passes a day apart with errors of 0.05 mag."""
    folder = tmp_path_factory.mktemp("rotation")
    (folder / "scene.toml").write_text(text(UNKNOWN))
    paths = []
    for number, start in enumerate(STARTS):
        curve = torchlc.simulate(
            Scene.from_toml(text(TRUE)), start=start, hours=ROWS * CADENCE / 3600, cadence=CADENCE, noise=0.05, seed=number
        )  # fmt: skip
        paths.append(folder / f"pass{number}.ecsv")
        curve.write(paths[-1])
    return folder / "scene.toml", paths


@pytest.mark.long
def test_a_spin_is_found_from_two_passes(files: tuple[Path, list[Path]], tmp_path: Path) -> None:
    """The pole within 3 deg among the modes within 10 in chi-square, the period to 1e-3; a written scene is read again. The
    run goes on from one that was stopped after the grid of poles, which it does not work out again."""
    scene, paths = files

    def stop(stage: str, _share: float) -> None:
        if stage == "least squares":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        torchlc.rotation(scene, *paths, out=tmp_path / "out", progress=stop)
    assert [path.name for path in (tmp_path / "out").iterdir() if path.suffix != ".json"] != []
    stages: list[tuple[str, float]] = []
    result = torchlc.rotation(
        scene, *paths, out=tmp_path / "out", progress=lambda stage, share: stages.append((stage, share))
    )
    assert ("poles", 0.0) in stages and not any(stage == "poles" and share for stage, share in stages)
    assert not (tmp_path / "out" / "search.pt").exists()
    lon, lat = np.radians(POLE)
    true = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    found = json.loads((tmp_path / "out" / "rotation.json").read_text())
    assert found["schema"] == "torchlc-rotation/1" and found["passes"] == 2
    near = [one for one in found["modes"] if one["chi2"] < found["modes"][0]["chi2"] + 10]
    ways = np.radians([one["pole_icrs"] for one in near])
    poles = np.stack([np.cos(ways[:, 1]) * np.cos(ways[:, 0]), np.cos(ways[:, 1]) * np.sin(ways[:, 0]), np.sin(ways[:, 1])], 1)  # fmt: skip
    apart = np.degrees(np.arccos(np.clip(poles @ true, -1, 1)))
    assert apart.min() < 3.0
    best = near[int(apart.argmin())]
    assert best["period_s"] == pytest.approx(PERIOD_S, rel=1e-3)
    assert found["modes"][0]["chi2"] < found["dof"] + 5 * np.sqrt(2 * found["dof"])
    assert sum(one["probability"] for one in found["modes"]) == pytest.approx(1.0)
    written = torchlc.load(tmp_path / "out" / "scene.toml")
    assert written.attitude.numbers()["period"].value == pytest.approx(
        found["modes"][0]["period_s"] / 3600, rel=1e-12
    )
    assert len(result.to_table()) == len(found["modes"])
    # several counts of turns fit: the leading poles also with a phase for each night, of which no count is taken for granted
    loose = found["phase_per_pass"][0]
    assert found["modes"][0]["counts_possible"] > 1 and loose["per_night"] == ["phase"]
    assert loose["turns_between_passes"] == [] and loose["period_s"] == pytest.approx(PERIOD_S, rel=2e-3)
    assert any("phase per pass" in line for line in result.lines())
    assert not any("e+" in line for line in result.lines())  # no number of these needs an exponent
    apart = torchlc.load(tmp_path / "out" / "scene_per_pass.toml")
    nights = apart.attitude.phase.values
    assert list(nights) == [one["night"] for one in loose["nights"]]
    assert [one % 360 for one in nights.values()] == pytest.approx(
        [one["phase_deg"] for one in loose["nights"]]
    )


def test_errors_are_words(files: tuple[Path, list[Path]], capsys: pytest.CaptureFixture[str]) -> None:
    scene, paths = files
    with pytest.raises(InputError, match="no recording"):
        torchlc.rotation(scene)
    assert run(["rotation", str(scene), str(paths[0]), "--shortest", "90", "--longest", "30"]) == 2
    assert "a range of periods" in capsys.readouterr().err


@pytest.mark.long
def test_modes_of_rows_without_errors_compare_by_their_scatter(
    files: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    """One night without its column of errors. Of N normal rows of unknown scatter the likelihood, integrated over the scatter, goes
    as S^(-N/2), S the sum of squares (Gelman et al., Bayesian Data Analysis, 3.2): modes are apart by 2 N ln of the ratio of rms,
    to the 1e-3 that a floor of the scatter leaves, and this says their probabilities."""
    from astropy.table import Table

    scene, paths = files
    table = Table.read(paths[0], format="ascii.ecsv")
    table.remove_column("mag_err")
    table.write(tmp_path / "bare.ecsv", format="ascii.ecsv")
    found = torchlc.rotation(scene, tmp_path / "bare.ecsv").to_json()
    modes = found["modes"]
    assert len(modes) > 1
    rms = np.array([one["rms_mag"] for one in modes])
    expected = 2 * found["rows"] * np.log(rms / rms[0])
    above = np.array([one["above_best"] for one in modes])
    np.testing.assert_allclose(above, expected, atol=1e-3 * found["rows"])
    chances = np.exp(-expected / 2) / np.exp(-expected / 2).sum()
    np.testing.assert_allclose([one["probability"] for one in modes], chances, atol=0.03)


def passes_at(middle: list[float]) -> Rows:
    empty = torch.zeros(0, dtype=torch.float64)
    span = torch.full((len(middle),), 50.0, dtype=torch.float64)
    return Rows(
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        torch.tensor(middle, dtype=torch.float64),
        span,
        False,
    )


def solution(frequencies: list[float], turns: torch.Tensor, frequency_sd: float) -> Local:
    """What a search without counts would know of passes: their phases modulo 1 and their frequencies."""
    sd = torch.tensor([frequency_sd] * len(turns) + [1e-3] * len(turns), dtype=torch.float64)
    empty = torch.zeros(0, dtype=torch.float64)
    return Local(
        torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), torch.tensor(frequencies, dtype=torch.float64),
        turns % 1.0, torch.zeros(3), empty, empty, 0.0, torch.diag(sd**2),
    )  # fmt: skip


def test_a_count_of_turns_joins_passes_as_arithmetic_says() -> None:
    """Passes at 0, 1000.3 and 5003.7 s of a body of 10.01 s: the phases follow from division; the count is found although
    the frequency is off by 2e-5, and without symmetry no other count is nearer."""
    rows = passes_at([0.0, 1000.3, 5003.7])
    turns = 0.2 + rows.middle / 10.01
    found = connections(
        rows, solution([1 / 10.01 + 2e-5] * 3, turns, 2e-5), 1, changing=False, bounds=(0.05, 0.2)
    )
    whole = torch.floor(turns).long()
    best = found.found[0]
    reference = best.counts[0]
    assert found.complete
    assert [one - reference for one in best.counts] == (whole - whole[0]).tolist()
    assert best.frequency == pytest.approx(1 / 10.01, rel=1e-6)


def test_frequencies_of_passes_say_how_the_period_changes() -> None:
    """A body of 15.8 s that slows by 2.2 ms a day, three passes over a week: phases and frequencies by the logarithm that the
    law P + p t integrates to. The true counts are among those that are possible and have its rate to 1 %; that of the
    best is within 3 of the standard deviation that frequencies of 5e-6/s leave, 5e-6 sqrt(2) / 7 d P^2."""
    day, period, slowing = 86400.0, 15.8, 2.2e-3 / 86400.0
    rows = passes_at([0.0, 4.03 * day, 7.0 * day])
    turns = torch.log1p(slowing * rows.middle / period) / slowing
    frequencies = (1 / (period + slowing * rows.middle)).tolist()
    found = connections(rows, solution(frequencies, turns, 5e-6), 1, changing=True, bounds=(0.05, 0.08))
    whole = torch.floor(turns).long()
    true = [
        one for one in found.found
        if [k - one.counts[0] for k in one.counts] == (whole - whole[0]).tolist()
    ]  # fmt: skip
    assert len(true) == 1 and found.complete
    rates = np.array([one.rate for one in found.found])
    assert true[0].rate == pytest.approx(2.2, rel=0.01)
    assert abs(rates[0] - 2.2) < 3 * 5e-6 * np.sqrt(2) / (7 * day) * period**2 * day * 1e3


def test_a_fast_change_is_followed_beyond_its_second_order() -> None:
    """A turn of 5 s that grows by 5 ms a day, four passes over ten days: the third order alone is 0.7 turns at the ends, and phases are
    good to 1e-3. By the logarithm that the law P + p t integrates to."""
    day, period, slowing = 86400.0, 5.0, 5e-3 / 86400.0
    starts = [0.0, 0.02 * day, 4.9 * day, 10.0 * day]
    rows = passes_at(starts)
    turns = torch.log1p(slowing * rows.middle / period) / slowing
    frequencies = 1 / (period + slowing * rows.middle)
    known = replace(solution(frequencies.tolist(), turns, 1e-8), own_error=0.0)
    found = connections(rows, known, 1, changing=True, bounds=(0.15, 0.25))
    best, whole = found.found[0], torch.floor(turns).long()
    assert [one - best.counts[0] for one in best.counts] == (whole - whole[0]).tolist()
    # the prior alone is off: a thousandth of the period a day
    assert best.distance == pytest.approx((1e-3 / RATE_A_DAY) ** 2, rel=0.02)
    assert best.rate == pytest.approx(5.0, rel=1e-5)
    for seconds in (-2.0 * day, 3.0 * day, 11.0 * day):
        phase, frequency = best.at(seconds)
        assert frequency == pytest.approx(1 / (period + slowing * seconds), rel=1e-8)
        since = np.log1p(slowing * seconds / period) / slowing - float(turns[0])
        assert phase - best.at(float(rows.middle[0]))[0] == pytest.approx(since, abs=1e-3)


def test_least_squares_without_negative_numbers_is_scipys() -> None:
    from scipy.optimize import nnls

    """Light of twelve paints much alike, of which most come out at zero, many at once. To 1e-8, since RIDGE moves the normal equations,
    whose smallest eigenvalue here is above 1e-3 of the largest square, by 1e-10."""
    rng = np.random.default_rng(3)
    for count in (3, 8, 12):
        columns, target = rng.random((40, 30, count)) ** 3, rng.random((40, 30))
        products = torch.from_numpy(np.einsum("bti,btj->bij", columns, columns))
        ours = non_negative(products, torch.from_numpy(np.einsum("bti,bt->bi", columns, target)))
        theirs = np.stack([nnls(one, aim)[0] for one, aim in zip(columns, target, strict=True)])
        np.testing.assert_allclose(ours, theirs, atol=1e-8)
        assert (theirs == 0).any()
    dark = non_negative(torch.zeros(2, 3, 3, dtype=torch.float64), torch.zeros(2, 3, dtype=torch.float64))
    assert bool((dark == 0).all())


def test_poles_are_even_and_their_frames_right_handed() -> None:
    poles = directions(500)
    assert float(poles.mean(0).norm()) < 5e-3
    nearest = (poles @ poles.T - 2 * torch.eye(500, dtype=torch.float64)).amax(-1)
    # hexagons of 1/500 of the sphere would be 9.76 deg apart, and nothing can be farther from all others
    apart = np.degrees(np.arccos(nearest.numpy()))
    assert apart.min() > 7.5 and apart.max() < 9.8
    frames = frame_of(poles)
    torch.testing.assert_close(torch.linalg.det(frames), torch.ones(500, dtype=torch.float64))
    torch.testing.assert_close(frames[:, 2], poles)


def test_a_lobe_that_is_dark_at_a_phase_leaves_no_misfit_below_zero() -> None:
    """A narrow lobe of a plate shines at a few phases only; at all others the sums by FFT hold rounding alone. A sum of
    squares can't be below zero, and no reflectances leave more than none at all, which is the light's own square."""
    rng = np.random.default_rng(5)
    seconds = torch.arange(60, dtype=torch.float64)
    way = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64).expand(60, 3)
    rows = Rows(
        torch.arange(60), seconds, way, way, torch.from_numpy(rng.lognormal(0.0, 1.0, 60)),
        torch.full((60,), 0.1, dtype=torch.float64), torch.zeros(60, dtype=torch.long),
        seconds.mean()[None], torch.tensor([59.0], dtype=torch.float64), False,
    )  # fmt: skip
    azimuth = torch.arange(4, dtype=torch.float64) * (np.pi / 2)
    normal = torch.stack([torch.cos(azimuth), torch.sin(azimuth), 0 * azimuth], -1)
    body = FacetLight(
        normal, torch.eye(4, dtype=torch.float64), ("a", "b", "c", "d"), (True,) * 4, (False,) * 4
    )
    weight = 1 / spread(rows.flux, rows.error)
    none = float((rows.flux * weight).square().sum())
    grid = torch.linspace(0.001, 0.02, 20, dtype=torch.float64)
    misfits = [one.misfit for one in search(rows, body, directions(40), grid)]
    assert min(misfits) >= 0 and max(misfits) <= none * (1 + 1e-9)


def test_a_free_rotation_is_not_told_from_a_pass_that_holds_no_second_cycle() -> None:
    """A thin disc (moments 1/2, 1/2, 1), its axis 20 deg from the angular momentum L. In units of L over the largest moment L goes
    about the axis at cos 20 deg and the axis about L at 2 (Landau and Lifshitz, Mechanics, 33); an axis in the plane of the disc
    goes about L at the difference. If that takes 30 s, L goes about the body in 33.9 s: a pass of 62 s does not hold two of
    these, one of 200 s does."""
    numbers = {
        "pole_lon": 0.0, "pole_lat": 0.0, "period": 30.0 / 3600, "phase": 0.0, "nutation": 20.0, "polhode_phase": 0.0,
        "inertia_x": 0.4999, "inertia_y": 0.5001,
    }  # fmt: skip
    mode = RotationMode(numbers, {}, 95.0, (), 1.0, None, torch.zeros(0), Scene.from_toml(text(TRUE)))
    assert mode.rates is not None
    axis = np.cos(np.radians(20))
    # moments that differ by 2e-4, so that the axes have an order, change it by less than 1 %
    assert 1 / float(mode.rates.polhode) == pytest.approx(30 * (2 - axis) / axis, rel=0.01)
    decided, words = verdict([mode], 100, 1, 62.0)
    assert not decided and words.startswith("cannot tell")
    assert verdict([mode], 100, 1, 200.0)[0]
    # at 8 deg the periods are 30 and 30.6 s: 200 s later they are an eighth of a turn out of step, and other paint may shine so too
    near = replace(mode, numbers={**numbers, "nutation": 8.0})
    decided, words = verdict([near], 100, 1, 200.0)
    assert not decided and "out of step" in words
    assert verdict([near], 100, 1, 600.0)[0]
    assert verdict([near], 100, 2, 200.0, all_s=86400.0)[0], "two passes whose turns between are counted"


def test_a_fit_does_not_lose_what_its_scene_knows(files: tuple[Path, list[Path]]) -> None:
    """A day apart the passes tell the period to 1e-5 of its bounds: what a search has written as a scene's values is as good as it was
    after the fit, though Adam's steps leave it."""
    free = (
        f"pole = [{{ value = {POLE[0]}, low = -360, high = 360 }}, {{ value = {POLE[1]}, prior = 'isotropic' }}]\n"
        f"period = {{ value = {PERIOD_S / 3600!r}, low = 0.0166, high = 0.0177 }}\n"
        f"phase = {{ value = {PHASE}, low = -360, high = 360 }}"
    )
    scene = Scene.from_toml(text(free))
    rows = joined([torchlc.load(files[0], path)[1] for path in files[1]])
    likelihood = Likelihood(LightCurve(scene, rows))
    with torch.no_grad():
        known = float(likelihood.chi2(likelihood.model.parameter_set.start()))
    assert known < len(rows) + 5 * np.sqrt(2 * len(rows))
    assert fit_map(likelihood, starts=3, adam_steps=30).chi2 < known


def test_a_synodic_turn_is_the_bisectors_way_round_the_body(files: tuple[Path, list[Path]]) -> None:
    """The body is turned row by row by scipy, and the turns of the bisector of Sun and observer about it are counted: forwards and
    backwards, where it is as much longer as it is shorter here."""
    recording = torchlc.load(files[0], files[1][0])[1]
    scene = Scene.from_toml(text(TRUE))
    rows = rows_of(LightCurve(scene, recording))
    bisector = (rows.to_sun + rows.to_observer).numpy()
    lon, lat = np.radians(POLE)
    pole = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    turns = []
    for sense in (1, -1):
        angle = 2 * np.pi * rows.seconds.numpy() / PERIOD_S
        upright, _ = Rotation.align_vectors([[0, 0, 1.0]], [sense * pole])
        seen = Rotation.from_rotvec(-angle[:, None] * [0, 0, 1.0]).apply(upright.apply(bisector))
        rate = np.polyfit(rows.seconds.numpy(), np.unwrap(np.arctan2(seen[:, 1], seen[:, 0])), 1)[0]
        way = np.degrees([np.arctan2(*(sense * pole)[1::-1]), np.arcsin(sense * pole[2])])
        numbers = {"pole_lon": way[0], "pole_lat": way[1], "period": PERIOD_S / 3600, "phase": 0.0}
        mode = RotationMode(
            numbers, {}, 1.0, (), 1.0, None, torch.zeros(0), scene, periods=((PERIOD_S, 0.1),)
        )
        search = RotationSearch(
            [mode], len(bisector), 1, 1, 1, (1.0, 2.0), angle, angle, (bisector, angle), True, True, "", recording
        )  # fmt: skip
        turns.append(RotationResult(search).told(mode)["passes"][0]["synodic_s"])
        assert turns[-1] == pytest.approx(2 * np.pi / abs(rate), rel=1e-5)
    assert abs(turns[0] - turns[1]) > 1e-3, "the bisector moves"


def test_passes_of_unlike_turns_years_apart_are_not_searched_for_a_free_rotation() -> None:
    """Euler's equations without torque have no time in them, so both frequencies are one in all passes. Turns of 11.82 and 12.36 s six
    years apart, known to 0.004 s, differ by 100 standard deviations; of passes a week apart such a difference would be another alias."""
    direction = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(4, 3)
    known = torch.tensor([0.004 / 12.0**2] * 2 + [0.01] * 2, dtype=torch.float64)

    def changed(days: float, turns: tuple[float, float]) -> bool:
        seconds = torch.tensor([0.0, 60.0, 86400 * days, 86400 * days + 80.0], dtype=torch.float64)
        one = torch.ones(4, dtype=torch.float64)
        rows = Rows(
            torch.arange(4), seconds, direction, direction, one, 0.1 * one, torch.tensor([0, 0, 1, 1]),
            torch.tensor([30.0, 86400 * days + 40.0], dtype=torch.float64), torch.tensor([60.0, 80.0], dtype=torch.float64), False,
        )  # fmt: skip
        frequencies = 1 / torch.tensor(turns, dtype=torch.float64)
        zero = torch.zeros(2, dtype=torch.float64)
        best = Local(direction[0], frequencies, zero, zero, zero, zero, 1.0, torch.diag(known.square()))
        return _changed(rows, best)

    assert changed(2365.0, (11.82, 12.36))
    assert not changed(2365.0, (12.36, 12.361))
    assert not changed(7.0, (11.82, 12.36))


@pytest.mark.parametrize(
    ("reach", "bounds"),
    [(0.001, (0.099, 0.102)), (0.01, (0.09, 0.11)), (0.2, (0.05, 0.3)), (0.0, (0.099, 0.102))],
)
def test_bounds_of_a_period_reach_over_all_counts_of_turns(reach, bounds) -> None:
    found = _wider(Free(value=0.1, low=0.099, high=0.102), reach)
    assert (found.low, found.high) == pytest.approx(bounds)
    assert _wider(0.1, reach) == 0.1
