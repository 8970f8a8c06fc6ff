"""One addition of each kind, as a user would define it: an effect, a law of reflection, a shape, a noise model, a reader and a
figure; and a scene with them. They are known only within :func:`known`: other tests list what the package has."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch

from tests.paper_orbits import ORBIT_1
from torchlc.brdf import MODELS, Brdf
from torchlc.brdf.angles import lambert, per_epoch
from torchlc.effects import Effect, registry
from torchlc.files.numbers import Size
from torchlc.naming import Registry
from torchlc.noise.kind import NoiseKind
from torchlc.parameters import LOBE_REFLECTANCE, REFLECTANCE, Quantity
from torchlc.readers.format import FORMATS, Format
from torchlc.readers.table import Header
from torchlc.report.figures import ReportFigure
from torchlc.report.figures.contract import FIGURES
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
            for number, text in head.lines[1:]:
                mag, _, error, _, date = text.split()
                yield number, [date, mag, error]

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


def scene_with(effects="[]", parameters="", radius="1.0", r_diff="{ value = 0.4, low = 0.0, high = 1.0 }"):
    numbers = {"RADIUS": radius, "EFFECTS": effects, "PARAMETERS": parameters, "DIFFUSE": r_diff}
    text = TEXT
    for word, number in numbers.items():
        text = text.replace(word, number)
    return Scene.from_toml(text, known_effects=registry())


def taken_out(module: str) -> list[tuple[Registry, str, type]]:
    """The classes that a module has defined, by registry and name, which are no longer known then."""
    found = [
        (registry_, name, cls)
        for registry_ in (EFFECTS, MODELS, SHAPES, FORMATS, FIGURES)
        for name, cls in registry_.outside().items()
        if cls.__module__ == module
    ]
    for registry_, name, _ in found:
        registry_.pop(name)
    return found


@contextmanager
def known(classes):
    """Classes of :func:`taken_out` are known within."""
    for registry_, name, cls in classes:
        registry_.enter(name, cls)
    yield
    for registry_, name, _ in classes:
        registry_.pop(name)


ADDITIONS = taken_out(__name__)
