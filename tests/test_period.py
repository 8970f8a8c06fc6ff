"""Periods: of signals put in, of Eros, and what the candidates say about their aliases."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from torchlc.errors import InputError
from torchlc.inference.period import find_period
from torchlc.readers import Recording, load_recording

EROS = Path(__file__).parents[2] / "shared" / "data" / "eros" / "recording.ecsv"
JD = 2459000.5


def recording(
    folder: Path, hours: np.ndarray, mag: np.ndarray, error: float | None = 0.02, **columns: np.ndarray
) -> Recording:
    names = ["time", "mag", *(["mag_err"] if error else []), *columns]
    rows = zip(*columns.values(), strict=True) if columns else [()] * len(hours)
    lines = [",".join(names)]
    for hour, value, extra in zip(hours, mag, rows, strict=True):
        cells = [f"{JD + hour / 24:.9f}", f"{value:.5f}", *([str(error)] if error else []), *map(str, extra)]
        lines.append(",".join(cells))
    (folder / "obs.csv").write_text("\n".join(lines) + "\n")
    return load_recording(folder / "obs.csv")


@pytest.mark.parametrize("error", [0.02, None])
def test_a_sinusoid_is_found_within_its_formal_error(tmp_path: Path, error: float | None):
    generator = np.random.default_rng(1)
    hours = np.sort(generator.uniform(0, 6, 400))
    mag = 10 + 0.3 * np.sin(2 * np.pi * hours / 0.137) + 0.02 * generator.normal(size=400)
    found = find_period(seen := recording(tmp_path, hours, mag, error))
    best = found.candidates[0]
    assert found.to_table()["period_s"][0] == best.period_s and f"{best.period_s:.6g}" in found._repr_html_()
    (drawn,) = found.plot(seen).lines
    folded, phase = np.asarray(drawn.get_ydata()), np.asarray(drawn.get_xdata())
    assert np.std(folded[(phase > 0.4) & (phase < 0.45)]) < 0.1 < np.std(folded), "a curve, not a cloud"
    assert abs(best.period_s - 0.137 * 3600) < 4 * best.period_sd_s
    assert best.amplitude == pytest.approx(0.3, abs=0.006)
    assert best.false_alarm_probability < 1e-50
    # Montgomery & O'Donoghue (1999): sd of a frequency is sqrt(6/N) s / (pi T A)
    expected = math.sqrt(6 / 400) * 0.02 / (math.pi * 6 * 3600 * 0.3) * (0.137 * 3600) ** 2
    assert best.period_sd_s == pytest.approx(expected, rel=0.15)


def test_the_errors_of_found_periods_are_those_they_state(tmp_path: Path):
    """Of 40 noisy recordings the period's error over its stated sd has a spread of 1."""
    generator = np.random.default_rng(7)
    hours = np.linspace(0, 3, 150)
    pulls = []
    for _ in range(40):
        mag = 10 + 0.1 * np.sin(2 * np.pi * hours / 0.31 + 1.0) + 0.03 * generator.normal(size=150)
        best = find_period(recording(tmp_path, hours, mag, 0.03)).candidates[0]
        pulls.append((best.period_s - 0.31 * 3600) / best.period_sd_s)
    assert 0.75 < np.std(pulls) < 1.3


def test_noise_alone_has_no_low_false_alarm_probability(tmp_path: Path):
    generator = np.random.default_rng(3)
    hours = np.linspace(0, 5, 200)
    chances = [
        find_period(recording(tmp_path, hours, 10 + 0.1 * generator.normal(size=200), None)).candidates[0]
        for _ in range(20)
    ]
    assert sum(one.false_alarm_probability < 0.05 for one in chances) <= 4


def test_a_box_is_offered_its_whole_turn(tmp_path: Path):
    """Four like sides: the periodogram finds a quarter of the turn, and says so."""
    hours = np.linspace(0, 4, 600)
    mag = 10 + np.abs(np.sin(4 * np.pi * hours / 0.8))
    best = find_period(recording(tmp_path, hours, mag)).candidates[0]
    assert best.period_s == pytest.approx(720, rel=1e-3)
    offered = {alias.relation: alias.period_s for alias in best.aliases}
    assert offered["four times the period"] == pytest.approx(2880, rel=1e-3)
    assert offered["double the period"] == pytest.approx(1440, rel=1e-3)


def test_single_nights_leave_daily_aliases(tmp_path: Path):
    generator = np.random.default_rng(5)
    hours = np.concatenate([np.linspace(0, 3, 60) + 24 * night for night in range(4)])
    mag = 10 + 0.2 * np.sin(2 * np.pi * hours / 5.0) + 0.02 * generator.normal(size=240)
    found = find_period(recording(tmp_path, hours, mag), longest_s=12 * 3600)
    best = found.candidates[0]
    offered = {alias.relation: alias for alias in best.aliases}
    one_more = offered["one turn a day more"]
    assert 3600 / one_more.period_s == pytest.approx(3600 / best.period_s + 1 / 24, abs=0.004)
    everything = [best.period_s, *(alias.period_s for alias in best.aliases)]
    assert min(abs(period - 5 * 3600) for period in everything) < 60, (
        "the truth is the best or one of its aliases"
    )


def test_each_curve_has_its_own_mean(tmp_path: Path):
    hours = np.linspace(0, 6, 300)
    curve = (hours > 3).astype(int)
    mag = 10 + 2.0 * curve + 0.2 * np.sin(2 * np.pi * hours / 0.5)
    best = find_period(recording(tmp_path, hours, mag, curve=np.array(["a", "b"])[curve])).candidates[0]
    assert best.period_s == pytest.approx(1800, rel=1e-3)


def test_the_search_can_be_steered_and_says_what_it_left_out(tmp_path: Path):
    hours = np.linspace(0, 6, 300)
    found = find_period(
        recording(tmp_path, hours, 10 + np.sin(2 * np.pi * hours / 0.5)), shortest_s=600, longest_s=1200
    )
    assert found.searched_s == pytest.approx((600, 1200))
    assert all(590 < one.period_s < 1210 for one in found.candidates)
    content = found.to_json()
    assert content["schema"] == "torchlc-period/1" and content["rows"] == 300


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        (5, {}, "5 measured rows"),
        (100, {"shortest_s": 100.0, "longest_s": 50.0}, "shortest, longest"),
        (100, {"shortest_s": -1.0}, "shortest: -1 s"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    tmp_path: Path, rows: int, options: dict[str, float], message: str
):
    hours = np.linspace(0, 1, rows)
    with pytest.raises(InputError, match=message):
        find_period(recording(tmp_path, hours, 10 + hours), **options)


@pytest.mark.skipif(not EROS.exists(), reason="needs ../shared/data/eros")
def test_half_of_the_turn_of_eros_is_found(tmp_path: Path):
    """Of the curves of the winter of 1974 to 1975; the published sidereal period is 5.27026 h."""
    lines = EROS.read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    kept = [line for line in lines[start + 1 :] if 2442380 < float(line.split()[0]) < 2442500]
    assert len(kept) > 200
    (tmp_path / "eros.ecsv").write_text("\n".join([*lines[: start + 1], *kept]) + "\n")
    best = find_period(load_recording(tmp_path / "eros.ecsv")).candidates[0]
    assert best.period_s / 3600 == pytest.approx(5.27026 / 2, rel=2e-3)
    assert any(alias.relation == "double the period" for alias in best.aliases)


def test_a_body_with_two_like_sides_is_told(tmp_path: Path):
    """The light of a box, |cos| of its turn of 3,000 s: the period found is half of that, and the notes give the turn."""
    hours = np.sort(np.random.default_rng(1).uniform(0, 6, 400))
    light = 1 + 2 * np.abs(np.cos(2 * np.pi * hours * 3600 / 3000))
    found = find_period(recording(tmp_path, hours, 10 - 2.5 * np.log10(light)))
    assert found.candidates[0].period_s == pytest.approx(1500, rel=1e-3)
    (said,) = [text for text in found.to_json()["notes"] if "two like sides turns once" in text]
    number, unit = said.split("turns once in ")[1].split(",")[0].split()
    assert float(number) * {"min": 60, "s": 1}[unit] == pytest.approx(3000, rel=2e-3)
    assert said in repr(found)


@pytest.mark.parametrize("turns", [2.5, 3.5, 20.3])
@pytest.mark.parametrize("error", [0.02, None])
def test_a_trend_of_two_magnitudes_is_taken_off_and_told(tmp_path: Path, turns: float, error: float | None):
    """An amplitude of 0.2 on a trend of 2 mag over a night of 5 h, few turns and many: the trend's slope is
    uncertain by sqrt(12/N) s / T = 0.001 mag/h."""
    generator = np.random.default_rng(11)
    hours = np.sort(generator.uniform(0, 5, 300))
    period_h = 5 / turns
    mag = (
        10
        + 0.4 * hours
        + 0.2 * np.sin(2 * np.pi * hours / period_h + 0.5)
        + 0.02 * generator.normal(size=300)
    )
    found = find_period(recording(tmp_path, hours, mag, error))
    best = found.candidates[0]
    assert best.period_s == pytest.approx(period_h * 3600, abs=5 * best.period_sd_s)
    assert best.amplitude == pytest.approx(0.2, abs=0.02)
    (slope,) = found.trend_per_hour.values()
    assert slope == pytest.approx(0.4, abs=0.01)
    assert any("trend of +0.4" in text or "trend of +0.39" in text for text in found.notes())


@pytest.mark.parametrize(
    ("bands", "said"),
    [
        (["V"], r"taken off before: a trend of \S+ mag/h$"),
        (["V", "R"], r"taken off before: trends of \S+ mag/h \(V\), \S+ mag/h \(R\)$"),
        (list("BGRIVU"), r"taken off before: trends of (\S+ mag/h \(\w\)(, | and )){4}2 more$"),
    ],
)
def test_trends_are_told_by_the_names_that_a_person_gave(tmp_path: Path, bands: list[str], said: str):
    """A lone curve needs no name, and a station that the file does not name is not part of one."""
    generator = np.random.default_rng(3)
    hours = np.sort(generator.uniform(0, 5, 60 * len(bands)))
    mag = 10 + 0.4 * hours + 0.2 * np.sin(2 * np.pi * hours / 0.3) + 0.02 * generator.normal(size=len(hours))
    column = np.array([bands[k % len(bands)] for k in range(len(hours))])
    assert re.match(said, find_period(recording(tmp_path, hours, mag, band=column)).notes()[-1])


def test_a_trend_over_two_nights_with_gaps(tmp_path: Path):
    """Two nights of 4 h, a third of the rows lost in clouds, 1.5 mag between them: 17.3 min."""
    generator = np.random.default_rng(12)
    hours = np.concatenate([np.linspace(0, 4, 240), np.linspace(24, 28, 240)])
    hours = hours[np.sin(hours * 5.1) < 0.5]
    mag = (
        9
        + hours * 1.5 / 28
        + 0.15 * np.cos(2 * np.pi * hours * 60 / 17.3)
        + 0.03 * generator.normal(size=len(hours))
    )
    best = find_period(recording(tmp_path, hours, mag, 0.03)).candidates[0]
    counted = [
        alias for alias in best.aliases if "between runs" in alias.relation or "a day" in alias.relation
    ]
    near = [best.period_s, *(alias.period_s for alias in counted)]
    assert any(abs(one / 60 - 17.3) < 0.01 for one in near)
    assert best.period_s / 60 == pytest.approx(17.3, rel=0.015)


def test_a_spin_faster_than_the_sampling_is_among_the_aliases(tmp_path: Path):
    """Rows every 30 s and a period of 22 s: 1/22 - 1/30 is seen, the period of 82.5 s; 22 s stands among the others."""
    generator = np.random.default_rng(13)
    seconds = 30.0 * np.arange(500)
    mag = 10 + 0.3 * np.sin(2 * np.pi * seconds / 22) + 0.02 * generator.normal(size=500)
    found = find_period(recording(tmp_path, seconds / 3600, mag))
    best = found.candidates[0]
    assert best.period_s == pytest.approx(1 / (1 / 22 - 1 / 30), rel=1e-3)
    beyond = {alias.period_s: alias.relation for alias in best.aliases if "beyond Nyquist" in alias.relation}
    # k/30 +- 1/82.5 for k = 1, 2
    expected = [1 / (k / 30 + sign / 82.5) for k in (1, 2) for sign in (-1, 1)]
    assert sorted(beyond) == pytest.approx(sorted(expected), rel=1e-3)
    assert min(abs(one - 22) for one in beyond) < 0.02
    assert all("30 s apart" in relation for relation in beyond.values())
    assert any("60 s" in text and "22" in text for text in found.warnings)


def test_twice_the_step_between_rows_is_no_candidate(tmp_path: Path):
    """Rows every 8 s see a sinusoid of 16 s at two phases only, so that any amplitude fits: no candidate has one beyond the
    range of the rows."""
    generator = np.random.default_rng(17)
    seconds = 8.0 * np.arange(90)
    mag = 10 + 0.5 * np.sin(2 * np.pi * seconds / 30.8) + 0.05 * generator.normal(size=90)
    found = find_period(recording(tmp_path, seconds / 3600, mag, 0.05))
    assert found.candidates[0].period_s == pytest.approx(30.8, rel=5e-3)
    assert all(one.amplitude <= np.ptp(mag) for one in found.candidates)


def test_uneven_rows_have_no_such_aliases(tmp_path: Path):
    generator = np.random.default_rng(14)
    hours = np.sort(generator.uniform(0, 4, 500))
    mag = 10 + 0.3 * np.sin(2 * np.pi * hours / 0.2) + 0.02 * generator.normal(size=500)
    found = find_period(recording(tmp_path, hours, mag))
    assert not [alias for alias in found.candidates[0].aliases if "beyond" in alias.relation]
    assert not [text for text in found.warnings if "apart" in text]


def test_a_synodic_period_is_told_with_its_distance_from_the_sidereal_one(tmp_path: Path):
    """A body with two like sides turns about z in 10 min, the Sun about it by 60 deg in 5 h, the observer stands on
    the pole's side and turns with it: the bisector turns by 60 deg. Range doubles, which is 1.5 mag and no trend."""
    hours = np.linspace(0, 5, 700)
    sun_at = np.radians(60) * hours / 5
    flat = np.stack([np.cos(sun_at), np.sin(sun_at), 0 * sun_at], -1)
    reach = 36_000 * (1 + hours / 5)
    mag = 10 + 5 * np.log10(reach / 36_000) + 0.2 * np.cos(2 * (2 * np.pi * hours * 6 - sun_at))
    vectors = {f"sun_{axis}": 1.5e8 * flat[:, k] for k, axis in enumerate("xyz")}
    vectors |= {f"obs_{axis}": reach * flat[:, k] for k, axis in enumerate("xyz")}
    found = find_period(recording(tmp_path, hours, mag, 0.01, **vectors))
    best = found.candidates[0]
    sidereal_s, synodic_s = 300.0, 3600 / (2 * (6 - 1 / 30))
    assert best.period_s == pytest.approx(synodic_s, rel=1e-4)
    assert best.sidereal_within_s is not None
    # two like sides: twice the bound for a whole turn
    assert 2 * best.sidereal_within_s == pytest.approx(abs(synodic_s - sidereal_s), rel=0.01)
    assert best.sidereal_within_s == pytest.approx(synodic_s**2 / 3600 / 30, rel=1e-3)
    assert max(map(abs, found.trend_per_hour.values())) < 2e-3
    assert found.to_json()["measured"] == "synodic" and "synodic" in repr(found)
