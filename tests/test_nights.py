"""A body that was disturbed between nights: a turn of its own for each, one pole and one set of materials for all."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from astropy.table import Table
from scipy.spatial.transform import Rotation

import torchlc
from tests.paper_orbits import ORBIT_3, recording, tle_scene
from tests.rotating_bodies import Circle, box, steady, unit_of
from tests.rotating_bodies import recording as recorded
from tests.rotating_bodies import scene as scene_of
from torchlc.api import usable
from torchlc.cli import run
from torchlc.diagnosis.coordinates import spin_phase
from torchlc.errors import InputError
from torchlc.geometry.orbit import make_track
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import fit_map
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Free, Scene

DAY = 86400.0
BEGINS = (0.0, 1.2 * DAY, 3.1 * DAY)
PERIODS, PHASES = (47.0, 47.9, 46.2), (0.10, 0.72, 0.31)
POLE, MATERIALS = (205.0, 38.0), (30.0, 0.25, 0.3)
BODY = box(1.2, 1.9, 2.6)
START = "2023-03-01T12:00:00"
EPOCHS = tuple(str(np.datetime64(START) + np.timedelta64(int(begin), "s")) for begin in BEGINS)
NIGHTS = tuple(epoch[:16] for epoch in EPOCHS)
"""Without stations a night has the name of its first minute."""


def turned(seconds: np.ndarray, begins: tuple[float, ...] = BEGINS) -> np.ndarray:
    """Body from inertial: each night its own period, and phase at its own beginning."""
    night = np.searchsorted(np.array(begins[1:]) - 0.1 * DAY, seconds)
    every = np.array([
        steady(seconds - begin, unit_of(*POLE), period, phase)
        for begin, period, phase in zip(begins, PERIODS, PHASES, strict=True)
    ])  # fmt: skip
    return every[night, np.arange(len(seconds))]


def divided(values: tuple[float, ...], bounds: str = "") -> str:
    table = ", ".join(f'"{night}" = {value!r}' for night, value in zip(NIGHTS, values, strict=True))
    return f'{{ value = {values[0]!r}, per = "night", values = {{ {table} }}{bounds} }}'


def attitude_of(phase: str, period: str, pole: str) -> str:
    epochs = ", ".join(f'"{one}"' for one in EPOCHS)
    lines = ["[attitude]", 'mode = "spin-pole"', f"pole = {pole}", f"period = {period}", f"phase = {phase}"]
    return "\n".join([*lines, f"epoch = [{epochs}]", "[[components]]"])


def with_attitude(attitude: str, text: str) -> str:
    return re.sub(r"\[attitude\].*?\[\[components\]\]", lambda _: attitude, text, flags=re.S)


def degrees_of(phases: tuple[float, ...]) -> tuple[float, ...]:
    """Phases, deg, of `spin-pole`, which counts from where the pole's own colatitude grows, a quarter turn before."""
    return tuple(360.0 * phase + 90.0 for phase in phases)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A scene that starts off the truth, and three nights of 9 minutes by numpy alone, errors of 0.03 mag."""
    folder = tmp_path_factory.mktemp("nights")
    rng = np.random.default_rng(5)
    ways = (unit_of(25.0, 20.0), unit_of(300.0, -30.0), unit_of(335.0, 45.0))
    passes = [
        (
            begin,
            np.arange(0.0, 540.0, 5.0) + rng.uniform(0.0, 2.0, 108),
            Circle(way, unit_of(30.0, 60.0), 1.5e-3, 1500.0),
        )
        for begin, way in zip(BEGINS, ways, strict=True)
    ]
    (folder / "rows.ecsv").write_text(
        recorded(BODY, turned, passes, materials=MATERIALS, noise=0.03, rng=rng, epoch=START)
    )
    attitude = attitude_of(
        divided(tuple(phase + 5 for phase in degrees_of(PHASES)), ", low = -180, high = 540"),
        divided(tuple(period * 1.0004 / 3600 for period in PERIODS), ", low = 0.0125, high = 0.0136"),
        '[{ value = 208, low = 20, high = 380 }, { value = 35, prior = "isotropic" }]',
    )
    text = with_attitude(attitude, scene_of(BODY, (47.0, 40.0, 60.0))).replace(
        "value = 50.0", f"value = {MATERIALS[0]}"
    )
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml", folder / "rows.ecsv"


@pytest.mark.long
def test_each_night_gets_its_own_turn_and_all_one_pole(files: tuple[Path, Path]) -> None:
    """Rates and phases within 4 standard deviations (seven numbers: 1 case in 2000), which are below 0.02 s and 4 deg, where
    periods differ by 0.9 s; chi-square is that of the noise. A single period for all leaves ten times as much."""
    scene = torchlc.load(files[0])
    rows = usable(scene, files[1])
    assert rows.night_ids == NIGHTS
    model = LightCurve(scene, rows)
    likelihood = Likelihood(model)
    best = fit_map(likelihood)
    found = dict(zip(model.names, best.theta.tolist(), strict=True))
    chi2 = float(likelihood.chi2(best.theta))
    assert chi2 < len(rows) + 4 * np.sqrt(2 * len(rows))
    covariance = torch.linalg.inv(torch.func.hessian(lambda one: 0.5 * likelihood.chi2(one))(best.theta))
    sd = dict(zip(model.names, torch.diagonal(covariance).sqrt().tolist(), strict=True))
    for night, period, phase in zip(NIGHTS, PERIODS, degrees_of(PHASES), strict=True):
        name = f"attitude.period[{night}]"
        assert 3600 * sd[name] < 0.02 and abs(found[name] - period / 3600) < 4 * sd[name]
        name = f"attitude.phase[{night}]"
        off = (found[name] - phase + 90) % 180 - 90  # the box looks the same after half a turn
        assert sd[name] < 4 and abs(off) < 4 * sd[name]
    apart = np.degrees(
        np.arccos(unit_of(found["attitude.pole_lon"], found["attitude.pole_lat"]) @ unit_of(*POLE))
    )
    assert apart < 3.0
    shared = scene.model_copy(
        update={
            "attitude": scene.attitude.model_copy(
                update={"period": Free(value=47.0 / 3600, low=0.0125, high=0.0136)}
            )
        }
    )
    common = Likelihood(LightCurve(shared, rows))
    assert float(common.chi2(fit_map(common).theta)) > 10 * chi2


def test_slopes_by_the_numbers_of_nights_are_finite_differences(files: tuple[Path, Path]) -> None:
    """Central differences of 1e-6 of the bounds' width leave 1e-5 of the largest slope of a number."""
    model = LightCurve(torchlc.load(files[0]), usable(torchlc.load(files[0]), files[1]))
    start = model.parameter_set.start()
    slopes = torch.func.jacfwd(model)(start)
    backwards = torch.func.jacrev(model)(start)
    for k, name in enumerate(model.names):
        step = torch.zeros_like(start)
        step[k] = 1e-9 if "period" in name else 1e-4
        expected = (model(start + step) - model(start - step)) / (2 * step[k])
        scale = float(expected.abs().max())
        np.testing.assert_allclose(slopes[:, k].detach(), expected.detach(), atol=1e-4 * scale, rtol=1e-4)
        np.testing.assert_allclose(backwards[:, k].detach(), slopes[:, k].detach(), atol=1e-9 * scale)
        night = next((one for one in NIGHTS if f"[{one}]" in name), None)
        if night is not None:  # a night's number moves that night alone
            others = torch.from_numpy(model.recording.night != NIGHTS.index(night))
            assert float(slopes[others, k].abs().max()) == 0.0 < scale
    batch = torch.stack([start, start + 1e-3 * (start.abs() > 1)])
    np.testing.assert_allclose(
        model(batch).detach(), torch.stack([model(one) for one in batch]).detach(), atol=1e-10
    )


def test_given_numbers_of_nights_are_simulated_as_another_program_has_them(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    """Fixed values a night: light that numpy made, to its error. The scene is written and read again as it was."""
    attitude = attitude_of(
        divided(degrees_of(PHASES)), divided(tuple(period / 3600 for period in PERIODS)), f"{list(POLE)}"
    )
    text = with_attitude(attitude, files[0].read_text())
    for key, value in zip(("n", "r_spec", "r_diff"), MATERIALS, strict=True):
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.M)
    (tmp_path / "true.toml").write_text(text)
    scene = torchlc.load(tmp_path / "true.toml")
    rows = usable(scene, files[1])
    model = LightCurve(scene, rows)
    assert model.names == []
    off = (torchlc.simulate(scene, rows).mag - rows.observed) / rows.error
    assert off @ off == pytest.approx(len(rows), abs=4 * np.sqrt(2 * len(rows)))
    out = tmp_path / "out"
    assert run(["simulate", str(tmp_path / "true.toml"), str(files[1]), "-o", str(out), "--quiet"]) == 0
    written = Table.read(out / "curve.ecsv")
    np.testing.assert_allclose(written["mag"], torchlc.simulate(scene, rows).mag, atol=1e-9)
    assert Scene.from_toml(scene.to_toml(), tmp_path) == scene
    phase = spin_phase(model, model.values(model.parameter_set.start()))
    assert phase is not None
    own = rows.seconds / np.array(PERIODS)[rows.night]
    np.testing.assert_allclose(np.exp(2j * np.pi * phase.numpy()), np.exp(2j * np.pi * own), atol=1e-6)


def test_a_spin_about_a_body_axis_has_a_phase_a_night() -> None:
    """Against scipy: the attitude without spin, turned about the body axis by the night's phase and rate since its epoch."""
    seconds = np.concatenate([np.arange(0.0, 600.0, 60.0), 2 * DAY + np.arange(0.0, 600.0, 60.0)])
    night = (seconds > DAY).astype(np.int64)
    rows = recording("2020-10-10T12:00:00", seconds, night=night, night_ids=("a", "b"))
    table = '{ value = 0.0, per = "night", values = { a = %s, b = %s } }'
    spin = (
        'mode = "inertial"\nspin_axis = [0, 1, 0]\nspin_epoch = ["2020-10-10T12:01:00", "2020-10-12T12:02:00"]\n'
        f"spin_phase = {table % (10.0, 250.0)}\nspin_rate = {table % (3.0, -7.0)}\n"
    )

    def rotations(attitude: str) -> np.ndarray:
        model = LightCurve(tle_scene(ORBIT_3, attitude), rows)
        values = model.assembly.attitude_values(model.values(model.parameter_set.start()))
        state = make_track(model.assembly.scene, rows).at(0.0, 0.0, 0.0)
        return model.assembly.attitude.rotation(state, values).expand(len(seconds), 3, 3).numpy()

    elapsed = seconds - np.array([60.0, 2 * DAY + 120.0])[night]
    angle = np.array([10.0, 250.0])[night] + 360 * np.array([3.0, -7.0])[night] * elapsed / 3600
    expected = (
        rotations('mode = "inertial"') @ Rotation.from_euler("y", angle[:, None], degrees=True).as_matrix()
    )
    np.testing.assert_allclose(rotations(spin), expected, atol=1e-9)


def test_a_night_without_a_value_is_told(files: tuple[Path, Path]) -> None:
    text = files[0].read_text().replace(f'"{NIGHTS[2]}" = ', '"2023-03-05T09:00" = ')
    scene = Scene.from_toml(text)
    warnings = LightCurve(scene, usable(scene, files[1])).assembly.warnings
    assert any(f"has no value for the night {NIGHTS[2]}" in one for one in warnings)
    assert any("values for no night of the recording: 2023-03-05T09:00" in one for one in warnings)


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        ('phase = { value = 1, values = { a = 2 }, low = 0, high = 9 }', "values without per"),
        ('phase = { value = 1, per = "night", values = { a = 20 }, low = 0, high = 9 }', "between low 0 and high 9"),
        ('period = { value = 1, per = "night", values = { a = -2 } }', "> 0"),
        ('phase = { value = 1, per = "night", values = { a = 2 }, low = 0 }', "one bound only"),
        ('phase = { value = 1, per = "night" }', "only a value"),
        ('phase = { value = 1, per = "night", values = { a = "x" } }', "a number"),
        ("epoch = []", "attitude.epoch"),
        ('epoch = ["2023-03-01"]', "attitude.epoch"),
    ],
)  # fmt: skip
def test_divided_numbers_that_cannot_be(lines: str, found: str) -> None:
    key = lines.split(" ")[0]
    given = {"pole": "[1, 2]", "period": "0.02", "phase": "0", "epoch": '"2023-03-01T00:00:00"'}
    given.pop(key)
    rest = "\n".join(f"{name} = {value}" for name, value in given.items())
    attitude = f'[attitude]\nmode = "spin-pole"\n{lines}\n{rest}\n[[components]]'
    with pytest.raises(InputError, match=re.escape(found)):
        Scene.from_toml(with_attitude(attitude, scene_of(BODY, (47.0, 40.0, 60.0))))


def test_two_epochs_in_a_night_are_refused(files: tuple[Path, Path]) -> None:
    first = f"{EPOCHS[0][:-5]}05:00"
    scene = Scene.from_toml(files[0].read_text().replace("epoch = [", f'epoch = ["{first}", '))
    with pytest.raises(InputError, match=f"two epochs for rows of the night {NIGHTS[0]}"):
        LightCurve(scene, usable(scene, files[1]))


@pytest.mark.long
def test_a_search_gives_each_night_its_own_turn_where_no_one_rate_holds(tmp_path: Path) -> None:
    """Three nights months apart, of one pole and unlike turns: the pole within 1 deg, each period within 4 standard deviations,
    which are below 0.1 s (9 minutes hold 11 turns), so that 0.9 s between nights are told. The scene that is written has them."""
    rng = np.random.default_rng(5)
    begins = (0.0, 90.3 * DAY, 201.7 * DAY)
    passes = [
        (begin, np.arange(0.0, 540.0, 5.0) + rng.uniform(0.0, 2.0, 108), Circle(way, unit_of(30.0, 60.0), 1.5e-3, 1500.0))
        for begin, way in zip(begins, (unit_of(25.0, 20.0), unit_of(40.0, -30.0), unit_of(190.0, 45.0)), strict=True)
    ]  # fmt: skip
    made = recorded(
        BODY,
        lambda seconds: turned(seconds, begins),
        passes,
        materials=MATERIALS,
        noise=0.03,
        rng=rng,
        epoch=START,
    )
    (tmp_path / "rows.ecsv").write_text(made)
    (tmp_path / "scene.toml").write_text(scene_of(BODY, (47.0, 45.0, 49.5), epoch=START))
    out = tmp_path / "out"
    result = torchlc.rotation(tmp_path / "scene.toml", tmp_path / "rows.ecsv", out=out)
    assert any("no one rotation holds over the nights" in one for one in result.warnings)
    found = json.loads((out / "rotation.json").read_text())
    assert not found["passes_connected"] and found["phase_per_pass"] == []
    assert "phase and period per pass" in result.lines()[1]
    best = found["modes"][0]
    assert best["per_night"] == ["phase", "period"] and best["chi2"] < found["dof"] + 4 * np.sqrt(
        2 * found["dof"]
    )
    apart = np.degrees(np.arccos(unit_of(*best["pole_icrs"]) @ unit_of(*POLE)))
    assert apart < 1.0
    for night, period in zip(best["nights"], PERIODS, strict=True):
        assert night["period_sd_s"] < 0.1
        assert night["period_s"] == pytest.approx(period, abs=4 * night["period_sd_s"])
    scene = torchlc.load(out / "scene.toml")
    model = LightCurve(scene, usable(scene, tmp_path / "rows.ecsv"))
    start = model.parameter_set.start()
    assert sum(name.startswith(("attitude.phase[", "attitude.period[")) for name in model.names) == 6
    assert float(Likelihood(model).chi2(start)) == pytest.approx(best["chi2"], abs=0.1)
