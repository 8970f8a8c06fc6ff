"""Light of turning boxes and cylinders by numpy and scipy alone: Euler's equations integrated, flat facets summed.

Nothing of torchlc makes it: facets convex and without shadows, the law of Ashikhmin and Shirley (2000, J. Graphics Tools 5, 25)
with equal exponents, Sun and observer on circles. A recording has vectors from the object to the Sun and to the observer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

SUN_KM, LIGHT_KM_S, SUN_MAG = 149_597_870.7, 299_792.458, -26.7


@dataclass(frozen=True)
class Body:
    """Normals (F, 3) and areas (F,), m2; the table of the scene that says the same."""

    normal: np.ndarray
    area: np.ndarray
    toml: str


def box(x: float, y: float, z: float) -> Body:
    normal = np.concatenate([np.eye(3), -np.eye(3)])
    return Body(normal, np.tile([y * z, x * z, x * y], 2), f'shape = "box"\nsize = [{x}, {y}, {z}]')


def cylinder(radius: float, length: float, strips: int = 720) -> Body:
    """Along body x, its side in strips."""
    angle = 2 * np.pi * (np.arange(strips) + 0.5) / strips
    side = np.stack([np.zeros(strips), np.cos(angle), np.sin(angle)], 1)
    areas = np.full(strips, 2 * np.pi * radius * length / strips)
    return Body(
        np.concatenate([side, [[1, 0, 0], [-1, 0, 0]]]),
        np.concatenate([areas, np.full(2, math.pi * radius**2)]),
        f'shape = "cylinder"\nradius = {radius}\nlength = {length}\naxis = [1.0, 0.0, 0.0]',
    )


def light(
    body: Body, sun: np.ndarray, observer: np.ndarray, n: float, r_spec: float, r_diff: float
) -> np.ndarray:
    """Flux (T,), Sun's irradiance 1, at 1 m, for unit vectors (T, 3) in the body."""
    half = sun + observer
    half /= np.linalg.norm(half, axis=1)[:, None]
    cos_half = (half * sun).sum(1)[:, None]
    cos_i, cos_r, cos_n = (np.clip(one @ body.normal.T, 0, None) for one in (sun, observer, half))
    seen = (cos_i > 0) & (cos_r > 0)
    fresnel = r_spec + (1 - r_spec) * (1 - cos_half) ** 5
    lobe = (
        (n + 1) / (8 * np.pi) * cos_n**n * fresnel / (cos_half * np.maximum(np.maximum(cos_i, cos_r), 1e-12))
    )
    diffuse = (
        28 * r_diff / (23 * np.pi) * (1 - r_spec) * (1 - (1 - cos_i / 2) ** 5) * (1 - (1 - cos_r / 2) ** 5)
    )
    return ((lobe + diffuse) * cos_i * cos_r * seen) @ body.area


def unit_of(longitude_deg: float, latitude_deg: float) -> np.ndarray:
    lon, lat = np.radians([longitude_deg, latitude_deg])
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def pole_frame(pole: np.ndarray) -> np.ndarray:
    """Rows x, y, z of a frame with z along the pole."""
    x = np.cross([0.0, 0.0, 1.0], pole)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(pole, x), pole])


def steady(
    seconds: np.ndarray, pole: np.ndarray, period: float, phase: float, rate: float = 0.0
) -> np.ndarray:
    """Body from inertial (T, 3, 3) of a turn about body z; the period grows by ``rate`` s/s."""
    turns = np.log1p(rate * seconds / period) / rate if rate else seconds / period
    angle = 2 * np.pi * (turns + phase)
    about = Rotation.from_euler("z", -angle[:, None]).as_matrix()  # inertial frame into the turned one
    return about @ pole_frame(pole)


def tumbling(
    seconds: np.ndarray, pole: np.ndarray, moments: np.ndarray, rate: float, nutation: float, phase: float
) -> np.ndarray:
    """Body from inertial (T, 3, 3) of a free rotation by Euler's equations; ``rate`` is L over the largest moment, rad/s; at 0 s L is
    in the plane of the axes of the largest and the smallest moment, ``nutation`` rad from the former."""
    order = np.argsort(moments)
    along = np.zeros(3)
    along[order[2]], along[order[0]] = np.cos(nutation), np.sin(nutation)
    momentum = rate * moments.max()
    start, _ = Rotation.align_vectors(np.array([[0.0, 0.0, 1.0]]), along[None])
    start = Rotation.from_euler("z", 2 * np.pi * phase) * start

    def slope(_time: float, state: np.ndarray) -> np.ndarray:
        omega = state[:3]
        x, y, z, w = state[3:]
        turn = (
            0.5
            * np.array(
                [
                    [w, -z, y],
                    [z, w, -x],
                    [-y, x, w],
                    [-x, -y, -z],
                ]
            )
            @ omega
        )
        return np.concatenate([-np.cross(omega, moments * omega) / moments, turn])

    first = np.concatenate([momentum * along / moments, start.as_quat()])
    span = (0.0, float(seconds.max()) + 1.0)
    result = solve_ivp(slope, span, first, method="DOP853", rtol=1e-9, atol=1e-11, t_eval=seconds)
    to_frame = Rotation.from_quat(result.y[3:].T).as_matrix()  # frame along L from body
    return np.swapaxes(to_frame, -1, -2) @ pole_frame(pole)


@dataclass(frozen=True)
class Circle:
    """An observer seen from the object: unit vectors on a small circle, and a range that changes."""

    middle: np.ndarray
    axis: np.ndarray
    rate: float
    range_km: float

    @classmethod
    def past(
        cls, longitude_deg: float, latitude_deg: float, degrees: float, seconds: float, km: float
    ) -> Circle:
        """An arc of so many degrees in so many seconds, whose middle is in that direction."""
        middle = unit_of(longitude_deg, latitude_deg)
        axis = np.cross(middle, [0.3, -0.2, 1.0])
        return cls(middle, axis / np.linalg.norm(axis), np.radians(degrees) / seconds, km)

    def at(self, seconds: np.ndarray) -> np.ndarray:
        """Vectors (T, 3), km."""
        way = Rotation.from_rotvec(self.rate * seconds[:, None] * self.axis).apply(self.middle)
        return way * (self.range_km * (1 + 0.05 * (self.rate * seconds) ** 2))[:, None]


def recording(
    body: Body,
    turned: object,
    passes: list[tuple[float, np.ndarray, Circle]],
    *,
    materials: tuple[float, float, float],
    noise: float,
    rng: np.random.Generator,
    epoch: str = "2023-03-01T00:00:00",
) -> str:
    """An ECSV file. ``turned``: seconds at the body to body from inertial; passes are their starts, seconds after these and the observer."""
    sun_way = unit_of(340.0, -8.0)
    drift = 2 * np.pi / (365.25 * 86400)
    times, suns, observers = [], [], []
    for start, after, circle in passes:
        moment = start + after
        times.append(moment)
        suns.append(SUN_KM * Rotation.from_rotvec(drift * moment[:, None] * [0.0, 0.4, 0.9]).apply(sun_way))
        observers.append(circle.at(after - after.mean()))
    time, sun, observer = np.concatenate(times), np.concatenate(suns), np.concatenate(observers)
    distance = np.linalg.norm(observer, axis=1)
    matrix = turned(time - distance / LIGHT_KM_S)  # type: ignore[operator]
    seen = [
        np.einsum("tij,tj->ti", matrix, one / np.linalg.norm(one, axis=1)[:, None]) for one in (sun, observer)
    ]
    flux = light(body, seen[0], seen[1], *materials) / (1e3 * distance) ** 2
    kept = flux > 0
    flux = flux * (SUN_KM / np.linalg.norm(sun, axis=1)) ** 2
    with np.errstate(divide="ignore"):
        mag = SUN_MAG - 2.5 * np.log10(flux)
    kept &= mag < np.nanmedian(mag[kept]) + 3.5  # what is much fainter a camera does not see
    mag = mag + noise * rng.normal(size=len(mag))
    stamps = np.datetime64(epoch) + np.round(time * 1e6).astype("timedelta64[us]")
    lines = ["# %ECSV 1.0", "# ---", "# datatype:"]
    names = [
        "time",
        "mag",
        "mag_err",
        "exptime",
        *(f"{who}_{axis}" for who in ("sun", "obs") for axis in "xyz"),
        "curve",
    ]
    for name in names:
        text = name in ("time", "curve")
        unit = (
            ", unit: km"
            if name[:3] in ("sun", "obs")
            else ", unit: mag"
            if "mag" in name
            else ", unit: s"
            if name == "exptime"
            else ""
        )
        lines.append(f"# - {{name: {name}{unit}, datatype: {'string' if text else 'float64'}}}")
    lines += ["# schema: astropy-2.0", " ".join(names)]
    number = np.concatenate([np.full(len(after), k + 1) for k, (_, after, _) in enumerate(passes)])
    for k in np.flatnonzero(kept):
        numbers = " ".join(f"{x:.4f}" for x in (*sun[k], *observer[k]))
        lines.append(f"{stamps[k]} {mag[k]:.4f} {noise:.4f} 0.01 {numbers} pass{number[k]}")
    return "\n".join(lines) + "\n"


def scene(body: Body, period_s: tuple[float, float, float], epoch: str = "2023-03-01T00:00:00") -> str:
    """The scene of who knows the shape and a range of periods: value, low and high, s."""
    value, low, high = (float(one) / 3600 for one in period_s)
    return f"""format = "torchlc-scene/1"
name = "unknown rotation"
[orbit]
vectors = "icrs"
[attitude]
mode = "spin-pole"
pole = [{{ value = 180.0, low = 0.0, high = 360.0 }}, {{ value = 0.0, prior = "isotropic" }}]
period = {{ value = {value!r}, low = {low!r}, high = {high!r} }}
phase = {{ value = 180.0, low = 0.0, high = 360.0 }}
epoch = "{epoch}"
[[components]]
name = "body"
{body.toml}
centre = [0.0, 0.0, 0.0]
material = "body"
[materials.body]
model = "ashikhmin-shirley"
n = {{ value = 50.0, low = 1.0, high = 5000.0, prior = "loguniform" }}
r_spec = {{ value = 0.2, low = 0.0, high = 1.0 }}
r_diff = {{ value = 0.3, low = 0.0, high = 1.0 }}
[model]
effects = ["sun_distance"]
[model.parameters]
zero_point = 0.0
band_sun_magnitude = {SUN_MAG}
"""


def write_turning(folder: Path) -> tuple[Path, Path]:
    """A scene and its recording: a box that turns in 30 s about a pole that the scene does not know, seen for two turns."""
    body = box(1.2, 1.9, 2.6)
    after = 2.5 * np.arange(24)
    seen = [(0.0, after, Circle.past(30.0, 20.0, 30.0, after[-1], 19000.0))]
    rows = recording(
        body, lambda seconds: steady(seconds, unit_of(143.0, 36.0), 30.0, 0.2), seen, materials=(20.0, 0.2, 0.35), noise=0.05,
        rng=np.random.default_rng(17),
    )  # fmt: skip
    (folder / "turning.ecsv").write_text(rows)
    (folder / "turning.toml").write_text(scene(body, (30.0, 20.0, 45.0)))
    return folder / "turning.toml", folder / "turning.ecsv"
