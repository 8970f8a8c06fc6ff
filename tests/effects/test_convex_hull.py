"""The hull in the place of a body with hollows is a scene of the hull, as trimesh makes it."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
import trimesh

from tests.effects.cases import STILL, flux
from tests.effects.laboratory import WHITE, anywhere, turned
from tests.test_mesh_files import OUTLINES, obj, prism
from torchlc.effects import registry
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Scene

FOLDER = Path(mkdtemp())
MATERIALS = {"lambert": WHITE, "lobe": "[materials.white]\nn = 30.0\nr_spec = 0.3\nr_diff = 0.3\n"}


def of_mesh(name: str, text: str, material: str = WHITE) -> Scene:
    (FOLDER / f"{name}.obj").write_text(text)
    return Scene.from_toml(
        f'format = "torchlc-scene/1"\nname = "case"\n{STILL}[[components]]\nname = "body"\nshape = "mesh"\n'
        f'file = "{name}.obj"\nscale = 0.5\ncentre = [-0.7, -0.8, -0.3]\nrotation = [20, 0, 40]\nmaterial = "white"\n{material}'
        "[model]\neffects = []\n[model.parameters]\nband_sun_magnitude = -26.7\n",
        FOLDER, "case",
    )  # fmt: skip


SCENE = of_mesh("C", prism(OUTLINES["C"]))
RECORDING = turned(SCENE)


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("also", [[], ["self_shadowing"], ["near_field"]])
def test_equals_a_scene_of_the_hull(tmp_path, material, also):
    body = of_mesh("C", prism(OUTLINES["C"]), MATERIALS[material])
    mesh = trimesh.load(FOLDER / "C.obj", process=True).convex_hull
    hull = of_mesh("hull", obj(mesh.vertices, mesh.faces + 1), MATERIALS[material])
    recording, _, _ = anywhere(body, tmp_path)
    values = {"near_field__lamp": 0.2, "near_field__camera": 0.15} if "near_field" in also else {}
    found = flux(body, recording, ["convex_hull[body]", *also], **values)
    expected = flux(hull, recording, also, **values)
    # pieces of a near field are cut from other triangles of the same planes
    close = 2e-2 if also == ["near_field"] else 1e-9
    np.testing.assert_allclose(found, expected, rtol=close, atol=close * expected.max())
    assert np.abs(found - flux(body, recording, also, **values)).max() > 0.05 * found.max()


def test_a_convex_body_has_nothing_to_fill():
    for outline, text in (
        ("square", prism([(0, 0), (1, 0), (1, 1), (0, 1)])),
        ("dart", prism(OUTLINES["dart"])),
    ):
        scene = of_mesh(outline, text)
        context = LightCurve(scene, RECORDING, effects=[]).assembly.context
        reason = registry()["convex_hull"]("body").missing(context)
        assert (reason is None) == (outline == "dart")
