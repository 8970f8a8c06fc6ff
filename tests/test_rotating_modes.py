"""The modes of bodies that turn by themselves: rate of the period, tilt, torque-free rotation, in a scene."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from tests.paper_orbits import ORBIT_3, SHARED, recording, tle_scene
from torchlc.api import usable
from torchlc.errors import InputError
from torchlc.geometry.orbit import make_track
from torchlc.geometry.rotation.attitude import Attitude, turns
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene

START = "2020-10-10T12:00:00"
TURN = 'pole = [20, -40]\nperiod = 0.02\nphase = 10\nepoch = "2020-10-10T11:00:00"\n'
SPIN, FREE = f'mode = "spin-pole"\n{TURN}', f'mode = "rigid-body"\n{TURN}'
PRACTICE = SHARED / "practice"


def posed(attitude, values=None, seconds=None):
    seconds = np.arange(0.0, 3600.0, 100.0) if seconds is None else seconds
    rows, scene = recording(START, seconds), tle_scene(ORBIT_3, attitude)
    return Attitude(scene, rows).rotation(make_track(scene, rows).at(0.0, 0.0, 0.0), values or {})


def scalar(x):
    return torch.tensor(x, dtype=torch.float64)


@pytest.mark.parametrize("rate_ms_day", [0.0, 1e-9, 2.2, -5.0, 4e4])
def test_turns_are_the_integral_of_one_over_the_period(rate_ms_day):
    """Twenty days at 15.8 s, by quadrature to 1e-10; at the largest rate the period grows by 800 s."""
    rate = rate_ms_day * 1e-3 / 86400
    for elapsed in (-20.0, 300.0, 1.7e6):
        expected, _ = quad(lambda t: 1 / (15.8 + rate * t), 0, elapsed, epsabs=0, epsrel=1e-12)
        found = turns(scalar(elapsed), scalar(15.8), scalar(rate))
        assert float(found) == pytest.approx(expected, rel=1e-11)


def test_slopes_of_turns_join_at_no_rate():
    """d turns / d rate is -t^2 / (2 P^2) where the rate is 0."""
    slope = torch.func.grad(lambda rate: turns(scalar(900.0), scalar(10.0), rate))(scalar(0.0))
    assert float(slope) == pytest.approx(-(900.0**2) / 200, rel=1e-12)


def test_tilt_turns_the_body_in_the_rotating_frame():
    tilt = np.array([3.0, -8.0, 5.0])
    expected = posed(SPIN).numpy() @ Rotation.from_rotvec(tilt, degrees=True).as_matrix()
    np.testing.assert_allclose(posed(f"{SPIN}tilt = {tilt.tolist()}"), expected, atol=1e-12)


@pytest.mark.parametrize("inertia", [[0.4, 0.8], [0.8, 0.4], [0.9, 0.9]])
def test_without_nutation_a_rigid_body_spins_uniformly(inertia):
    also = "period_rate = 40\ntilt = [1, 2, 3]\n"
    found = posed(f"{FREE}{also}nutation = 0\ninertia = {inertia}\npolhode_phase = 77")
    np.testing.assert_allclose(found, posed(f"{SPIN}{also}"), atol=1e-9)


def test_values_per_curve_are_those_of_each():
    free = f"{FREE}nutation = 30\ninertia = [0.5, 0.8]\npolhode_phase = 60"
    rows = len(np.arange(0.0, 3600.0, 100.0))
    half = torch.arange(rows) < rows // 2
    for name, first, second in (("nutation", 20.0, 45.0), ("inertia_y", 0.7, 0.9), ("phase", 5.0, 300.0)):
        name = f"attitude.{name}"
        both = posed(free, {name: torch.where(half, scalar(first), scalar(second))})
        one, two = (posed(free, {name: scalar([x])}) for x in (first, second))
        np.testing.assert_allclose(both, torch.where(half[:, None, None], one, two), atol=1e-12)


@pytest.mark.parametrize("nutation", [25.0, 65.0])
def test_slopes_by_every_number_are_finite_differences(nutation):
    """Also in a batch; steps of 1e-5 leave 1e-6 of truncation over the four turns of the rows."""
    near = FREE.replace("T11:00:00", "T11:59:50")
    free = f"{near}nutation = {nutation}\ninertia = [0.5, 0.8]\npolhode_phase = 60\nperiod_rate = 3\ntilt = [1, 2, 3]"
    rows, scene = recording(START, np.arange(0.0, 300.0, 100.0)), tle_scene(ORBIT_3, free)
    turned, state = Attitude(scene, rows), make_track(scene, rows).at(0.0, 0.0, 0.0)
    names, start = list(turned.numbers), scalar(list(turned.numbers.values()))
    assert len(names) == 12

    def outcome(theta):
        return turned.rotation(state, dict(zip(names, theta[..., None].unbind(-2), strict=True)))

    slopes = torch.func.jacfwd(outcome)(start)
    for k in range(len(start)):
        step = torch.zeros_like(start)
        step[k] = 1e-8 if names[k] == "attitude.period" else 1e-5
        expected = (outcome(start + step) - outcome(start - step)) / (2 * step[k])
        np.testing.assert_allclose(slopes[..., k], expected, rtol=1e-5, atol=1e-5)
    batch = start * torch.linspace(0.99, 1.0, 3, dtype=torch.float64)[:, None]
    each = torch.stack([outcome(row) for row in batch])
    np.testing.assert_allclose(outcome(batch), each, atol=1e-9)
    np.testing.assert_allclose(torch.vmap(outcome)(batch), each, atol=1e-9)


@pytest.mark.parametrize(
    ("lines", "place", "found"),
    [
        ("nutation = 20\ninertia = [0.3, 0.5]", "inertia", "0.3 to 0.3 and 0.5 to 0.5"),
        ("nutation = 20\ninertia = [0.3, 1.4]", "inertia", "none exceeds the sum"),
        ("nutation = 20\ninertia = [{ value = 0.5, sigma = 0.1 }, 0.8]", "inertia", "no bounds"),
        ("nutation = 95\ninertia = [0.5, 0.8]", "nutation", "95"),
        ("nutation = 20", "inertia", "missing"),
        ("nutation = 20\ninertia = [0.5, 0.8]\nspin_rate = 1", "spin_rate", "does not belong"),
    ],
)
def test_states_that_no_body_has(lines, place, found):
    with pytest.raises(InputError) as error:
        posed(f"{FREE}{lines}")
    assert place in str(error.value) and found in str(error.value)


def test_a_period_that_reaches_nothing_is_refused():
    with pytest.raises(InputError, match=r"period_rate.*is 0 at a row"):
        posed(f"{SPIN}period_rate = -1e8")


def _as_answered(folder):
    """The practice scene with the answer's rotation and materials; a tumbling body's phase is left free."""
    answer = json.loads((folder / "answer.json").read_text())
    epoch, period = answer["epoch"], answer["period_s"] / 3600
    lines = [f"pole = {answer['pole']}", f"period = {period!r}", f'epoch = "{epoch}"']
    if answer.get("tilt"):
        lines.append(f"tilt = {[answer['tilt']['deg'] * x for x in answer['tilt']['axis']]}")
    if "nutation_deg" in answer:
        polhode = 360 * answer["t0_before_epoch_s"] / answer["periods_s"]["rotation"]
        lines += [
            f"inertia = {answer['inertia_ratios']}",
            f"polhode_phase = {polhode}",
            'mode = "rigid-body"',
        ]
        rates = np.array(answer["body_rates_rad_s_at_t0"]) * answer["inertia_xyz"]
        lines.append(f"nutation = {np.degrees(np.arctan2(rates[0], rates[2]))}")
        lines.append("phase = { value = 180, low = 0, high = 360 }")
    else:
        rate = answer["period_rate_ms_per_day"]
        lines += ['mode = "spin-pole"', f"phase = {answer['phase']}", f"period_rate = {rate}"]
    text = (folder / "scene.toml").read_text()
    text = re.sub(r"\[attitude\].*?\n\n", "\n".join(["[attitude]", *lines, "\n"]), text, flags=re.S)
    for name, numbers in answer["materials"].items():
        given = "\n".join(f"{key} = {float(value)}" for key, value in numbers.items())
        text = re.sub(rf"(\[materials\.{name}\]\n).*?\n\n", rf"\g<1>{given}\n\n", text, flags=re.S)
    return Scene.from_toml(text), answer


@pytest.mark.skipif(not PRACTICE.is_dir(), reason="the data beside the repository are absent")
@pytest.mark.parametrize("kind", ["spin", "drift", "tilt", "tumble"])
def test_the_light_is_that_of_another_program(kind):
    """Recordings of a program that integrates Euler's equations over 720 strips: at its own numbers chi-square is its
    chi-square. A phase, where it has another zero, is looked for; strips and rounded inputs are worth 0.5."""
    scene, answer = _as_answered(PRACTICE / f"rotation_{kind}")
    recording = usable(scene, PRACTICE / f"rotation_{kind}" / "recording.ecsv")
    model = LightCurve(scene, recording)

    def chi2(theta):
        """In magnitudes, as the program's own; the likelihood compares powers of flux, which adds up to 1 here."""
        with torch.no_grad():
            off = (torch.as_tensor(recording.observed) - model(theta)) / torch.as_tensor(recording.error)
        return off.square().sum(-1)

    theta = model.parameter_set.start()[None]
    if len(model.names):
        coarse = torch.arange(0.5, 360, 1.0, dtype=torch.float64)[:, None]
        best = coarse[chi2(coarse).argmin()]
        theta = best + torch.linspace(-1, 1, 401, dtype=torch.float64)[:, None]
    assert float(chi2(theta).min()) == pytest.approx(answer["floor_chi2"], abs=0.5)
