"""Every curve that simulate writes is a recording that fit, diagnose and period take; no light is no light."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from astropy.table import Table

import torchlc
from tests.effects.cases import PLATE, material, seen_from, still, tilted
from tests.effects.passes import CELLS, LOW_PASS, MATERIALS, TUMBLING, orbiting, rows
from tests.paper_orbits import LOW
from torchlc.cli import run
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve

MIRROR = """
    [[components]]
    name = "mirror"
    shape = "plate"
    size = [1.0, 1.0]
    centre = [0, 0, 0]
    u = [1, 0, 0]
    v = [0, 1, 0]
    material = "foil"
"""
MATT = "[materials.foil]\nn = 30.0\nr_spec = 0.1\nr_diff = { value = 0.3, low = 0.0, high = 1.0 }\n"
POLISHED = "[materials.foil]\nn = 1000.0\nr_spec = { value = 0.9, low = 0.0, high = 1.0 }\nr_diff = 0.0\n"
FREE_MATERIALS = MATERIALS.replace("0.35", "{ value = 0.35, low = 0.0, high = 1.0 }") + CELLS


def possible(scene) -> list[str]:
    """Every effect that a pass can carry, but for one that lights what is dark here."""
    context = LightCurve(scene, rows(scene, LOW_PASS, 0.16, 6.0), effects=[]).assembly.context
    physics = {name: cls for name, cls in registry().items() if cls.stage != "noise" and name != "appendage"}
    return [name for name, cls in physics.items() if cls().missing(context) is None]


def shown(attitude, components, materials, effects, **options):
    scene = orbiting(attitude, components, materials, **options)
    return scene.model_copy(update={"model": scene.model.model_copy(update={"effects": effects})})


SCENES = {
    "eclipse": shown(TUMBLING, tle=LOW, components=MIRROR, materials=MATT, effects=["earth_shadow", "finite_sun"]),
    "nothing but a far lobe": shown(
        'mode = "inertial"\nspin_axis = [1, 0, 0]\nspin_rate = 20.0',
        MIRROR, POLISHED, ["finite_sun", "earth_shadow"], tle=LOW,
    ),
    "its back half the time": shown(
        'mode = "inertial"\nspin_axis = [1, 0, 0]\nspin_rate = 60.0',
        MIRROR, MATT, ["self_shadowing", "finite_sun"], tle=LOW,
    ),
    "every effect": shown(
        TUMBLING, tle=LOW, components=orbiting.__defaults__[1], materials=FREE_MATERIALS,
        effects=possible(orbiting(TUMBLING, materials=FREE_MATERIALS, tle=LOW)),
    ),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("noise", [None, 0.02])
@pytest.mark.parametrize("suffix", ["ecsv", "csv"])
def test_what_simulate_writes_is_read(tmp_path, capsys, name, noise, suffix):
    """All of a pass and what comes after, in the shadow; rows without light are blank, and are dropped and counted."""
    scene = SCENES[name]
    curve = torchlc.simulate(scene, start=LOW_PASS, hours=0.16, cadence=6.0, noise=noise, seed=1)
    file = curve.write(tmp_path / "curve.ecsv")
    if suffix == "csv":
        table = Table.read(file)
        file = tmp_path / "curve.csv"
        table.write(file, format="ascii.csv")
    dark = ~np.isfinite(curve.mag)
    assert dark.any()
    assert (~dark).sum() >= 5
    assert np.abs(curve.mag[~dark]).max() < 65  # 1e-36 of sunlight
    assert (curve.flux[dark] == 0).all()
    shares = np.stack(list(curve.shares.values()))
    assert np.isnan(shares[:, dark]).all()
    # a component's light may be negative only in the last digits
    np.testing.assert_allclose(shares[:, ~dark].sum(0), 1.0, rtol=1e-9)
    # what is free is one number: the verbs are to be kept short, the model is not
    fitted = scene.model_copy(
        update={
            "model": scene.model.model_copy(
                update={
                    "effects": ["earth_shadow"],
                    "parameters": {**scene.model.parameters, "earth_shadow.h0": 20.0},
                }
            )
        }
    )
    recording = torchlc.load(fitted, file)[1]
    assert recording.dropped == {"non-finite": int(dark.sum())}
    assert len(recording) == int((~dark).sum())
    result = torchlc.fit(fitted, recording, steps=20, walkers=8)
    assert np.isfinite(result.delta).all()
    found = torchlc.diagnose(fitted, recording, quick=True, effects=["background"])
    assert found.verdict in ("adequate", "missing_physics", "noise_model", "unexplained")
    assert run(["period", str(file), "--quiet"]) == 0
    assert "Traceback" not in capsys.readouterr().err


def test_light_of_a_lobe_far_from_its_glint_is_none(tmp_path):
    """A mirror with n = 1e6 seen 40 deg from its glint sends cos^(1e6)(20 deg) = 1e-27,000 of its peak, and one with n = 1e4
    1e-270: neither is a brightness, whether the Sun is a point or a disc; the gradient stays a number."""
    to_sun, to_observer = tilted(np.array([20.0, 20.0, 20.0])), tilted(np.array([20.0, 60.0, 110.0]), 180.0)
    for effects in ([], ["finite_sun"]):
        for n in (1e4, 1e6):
            scene = still(PLATE, material("white", n, 0.9, 0.0))
            model = LightCurve(scene, seen_from(scene, tmp_path, to_sun, to_observer), effects=effects)
            bright = model.brightness(shares=True)
            assert bright.flux[0] > 1e-9
            assert (bright.flux[1:] == 0).all()
            assert (bright.shares[:, 1:] == 0).all()
    free = still(
        PLATE, "[materials.white]\nn = { value = 1e4, low = 1.0, high = 1e6 }\nr_spec = 0.9\nr_diff = 0.0\n"
    )
    model = LightCurve(free, seen_from(free, tmp_path, to_sun, to_observer), effects=["finite_sun"])
    slope = torch.func.jacrev(lambda theta: model.brightness(theta).flux)(model.theta())
    assert torch.isfinite(slope).all()
