"""The geometric coordinates along which a residual may collapse."""

from __future__ import annotations

import torch
from torch import Tensor

from torchlc.geometry.orbit.track import angle_between
from torchlc.lightcurve.model import LightCurve
from torchlc.stages.light import View

TIME = "time"
"""The coordinate along which stretches of a recording are told anyway."""
TITLES = {
    TIME: ("time", "s"),
    "phase_angle_deg": ("the phase angle", "deg"),
    "flux": ("the brightness", ""),
    "inverse_flux": ("the faintness", ""),
    "sun_lon_body": ("the longitude of the Sun on the body", "deg"),
    "sun_lat_body": ("the latitude of the Sun on the body", "deg"),
    "obs_lon_body": ("the longitude of the observer on the body", "deg"),
    "obs_lat_body": ("the latitude of the observer on the body", "deg"),
    "airmass": ("the airmass", ""),
    "shadow_coordinate": (
        "the Sun's height above the Earth's limb as the object sees it",
        "radii of the Sun",
    ),
    "spin_phase": ("the phase of the spin", "turns"),
    "glint_angle_deg": ("the angle from a mirror-like reflection on {}", "deg"),
    "incidence_deg": ("the angle of incidence on {}", "deg"),
}
"""In words, with units, by the name up to a bracket; what a bracket holds is a component and its face."""
RELATIVE = ("flux", "inverse_flux")
"""Of which only the order of rows says something: numbers mean nothing to a person."""
FEWEST_DIGITS, MOST_DIGITS = 3, 8
"""Of the ends of a range: as many as tell them apart. On a geostationary satellite the latitude of an observer varies by 0.001 deg."""
MOST_FACES = 8
"""Faces of one component that get coordinates of their own; smooth shapes and meshes have too many to
name."""


def coordinates(model: LightCurve, theta: Tensor) -> dict[str, Tensor]:
    """Every coordinate of FORMATS by name, each (T,), at natural values theta; those the data do not know are
    left out."""
    with torch.no_grad():
        values = model.values(theta)
        view = model.view(values)
        if model.assembly.instants is not None:
            view = view.at(model.assembly.instants.middle)
        flux = model.brightness(theta).flux
    context = model.assembly.context
    middle = view.to_sun.shape[0] // 2
    to_sun = view.to_sun[middle]
    to_observer = view.to_observer.expand(view.to_sun.shape)[middle]
    by_name = {
        TIME: context.seconds,
        "phase_angle_deg": torch.rad2deg(angle_between(to_sun, to_observer)),
        "flux": flux,
        "inverse_flux": 1 / torch.where(flux > 0, flux, flux.max().clamp(min=1e-300)),
    }
    for name, direction in (("sun", to_sun), ("obs", to_observer)):
        by_name[f"{name}_lon_body"] = torch.rad2deg(torch.atan2(direction[:, 1], direction[:, 0]))
        by_name[f"{name}_lat_body"] = torch.rad2deg(torch.asin(direction[:, 2].clamp(-1, 1)))
    if context.airmass is not None:
        by_name["airmass"] = context.airmass
    if context.track.supports("position"):
        shadow = shadow_coordinate(view, middle)
        if bool((shadow < 20).any()):
            by_name["shadow_coordinate"] = shadow
    phase = spin_phase(model, values)
    if phase is not None:
        by_name["spin_phase"] = phase
    return by_name | face_angles(model, view, middle)


def in_words(name: str, low: float | None = None, high: float | None = None) -> str:
    """A coordinate as a person says it, with its range if that is given."""
    kind, _, place = name.partition("[")
    title, unit = TITLES.get(kind, (name.replace("_", " "), ""))
    title = title.format(place.rstrip("]").replace("/", ", face "))
    if low is None or high is None or kind in RELATIVE:
        return title
    pairs = [(f"{low:.{count}g}", f"{high:.{count}g}") for count in range(FEWEST_DIGITS, MOST_DIGITS + 1)]
    first, last = next((pair for pair in pairs if pair[0] != pair[1]), pairs[0])
    return f"{title}, between {first} and {last}{f' {unit}' if unit else ''}"


def face_angles(model: LightCurve, view: View, middle: int) -> dict[str, Tensor]:
    """Angle between normal and bisector of Sun and observer, and of incidence, degrees, for each face of the
    plain components."""
    angles = {}
    for number, part in enumerate(model.assembly.shape.parts):
        if len(part.faces) > MOST_FACES:
            continue
        pose = view.poses[number]
        to_sun, to_observer = view.to_sun[middle], view.to_observer.expand(view.to_sun.shape)[middle]
        if pose is not None:
            turn = pose.expand(*view.to_sun.shape, 3)[middle]
            to_sun = torch.einsum("tij,ti->tj", turn, to_sun)
            to_observer = torch.einsum("tij,ti->tj", turn, to_observer)
        for index, face in enumerate(part.faces):
            normal = view.facets[number].normal[index].expand_as(to_sun)
            lit = (normal * to_sun).sum(-1) > 0
            seen = (normal * to_observer).sum(-1) > 0
            if not bool((lit & seen).any()):
                continue
            angles[f"glint_angle_deg[{part.name}/{face}]"] = torch.rad2deg(
                angle_between(normal, to_sun + to_observer)
            )
            angles[f"incidence_deg[{part.name}/{face}]"] = torch.rad2deg(angle_between(normal, to_sun))
    return angles


def shadow_coordinate(view: View, middle: int) -> Tensor:
    """(c - b) / a of physics B2, (T,): -1 where the umbra begins, 1 where the penumbra ends; large in full
    sunlight."""
    assert view.state.position is not None  # asked only where the position is known
    position = view.state.position.expand(*view.to_sun.shape)[middle]
    sun = view.state.sun.expand(*view.to_sun.shape)[middle]
    separation = angle_between(sun, -position)
    limb = torch.asin((6378.137 / torch.linalg.vector_norm(position, dim=-1)).clamp(max=1.0))
    radius = 695_700.0 / torch.linalg.vector_norm(sun, dim=-1)
    return (separation - limb) / radius


def spin_phase(model: LightCurve, values: dict[str, Tensor]) -> Tensor | None:
    """Turns since the spin's epoch modulo 1, (T,); None for an object that does not spin."""
    seconds = model.assembly.context.seconds
    numbers = model.assembly.scene.attitude.numbers()
    if "period" in numbers:
        return torch.remainder(seconds / 3600 / model.assembly.rows(values, "attitude.period"), 1.0)
    if "spin_rate" in numbers:
        rate = model.assembly.rows(values, "attitude.spin_rate")
        return torch.remainder(seconds / 3600 * rate, 1.0) if bool((rate != 0).any()) else None
    return None
