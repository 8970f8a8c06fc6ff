"""Lit and seen shares and projected areas of every component along a track, as tensors that can be differentiated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.geometry.orbit.sunlight import sunlit_fraction
from torchlc.inference.identifiability import bare_model
from torchlc.lightcurve.model import LightCurve
from torchlc.occlusion.areas import projected_areas, shown_fractions
from torchlc.readers import Recording
from torchlc.results.simulated_curve import DEFAULT_AIR_KM
from torchlc.scene import Scene
from torchlc.suggest import did_you_mean
from torchlc.tensors.vectors import unit

VELOCITY = "velocity"


@dataclass(frozen=True)
class Visibility:
    """Of C components at T rows. Areas are m2, towards the direction that each is named after, and count what other
    components hide of a component, and what it hides of itself.

    ``lit``, ``seen``, ``lit_and_seen`` (C, T): share of the component's whole surface, both sides of a plate, that
    the Sun lights, that the observer sees, and that is both at once. ``area_to_sun``, ``area_to_observer`` (C, T): projected
    area towards the Sun and the observer. ``area_towards``: the same (C, T) for every further direction, "velocity"
    among them where the velocity is known. None of these knows of the Earth's shadow: ``sunlight`` (T,) is the share of
    the Sun's light that is left beside an Earth with 20 km of opaque air, None where the geocentre is unknown.
    ``rotation`` (T, 3, 3) takes body axes to GCRS, and ``to_sun``, ``to_observer`` (T, 3) are unit vectors in the body
    frame. ``seconds`` (T,) count from the first row.
    """

    components: tuple[str, ...]
    seconds: Tensor
    lit: Tensor
    seen: Tensor
    lit_and_seen: Tensor
    area_to_sun: Tensor
    area_to_observer: Tensor
    area_towards: Mapping[str, Tensor]
    sunlight: Tensor | None
    rotation: Tensor
    to_sun: Tensor
    to_observer: Tensor

    def __repr__(self) -> str:
        lines = [
            f"Visibility: {number_of(len(self.components), 'component')} at {number_of(len(self.seconds), 'row')}"
        ]
        width = max(map(len, self.components))
        for name, share, area in zip(self.components, self.lit_and_seen, self.area_to_sun, strict=True):
            mean, square = float(share.detach().mean()), float(area.detach().mean())
            lines.append(
                f"  {name:{width}}  {mean:.1%} lit and seen, {square:.4g} m2 towards the Sun, on average"
            )
        return "\n".join(lines)


def component_visibility(
    scene: Scene,
    recording: Recording,
    values: Mapping[str, Tensor] | None = None,
    towards: Mapping[str, Tensor] | None = None,
) -> Visibility:
    """What every component shows at the rows of a recording.

    ``values`` replaces numbers of the scene and of its effects by full name ("panel.size_u", "attitude.spin_phase"), each
    a tensor (); gradients reach them. ``towards`` names further directions, (3,) or (T, 3) of any length in GCRS.
    """
    model = bare_model(LightCurve(scene, recording))
    known = model.values(model.parameter_set.start())
    given = dict(values or {})
    for name in given:
        if name not in known:
            raise InputError(
                scene.source, "values", f"{name!r} is no number of this scene", f"one of {', '.join(known)}",
                did_you_mean(name, known),
            )  # fmt: skip
    view = model.view(
        {**known, **{name: torch.as_tensor(v, dtype=torch.float64) for name, v in given.items()}}
    )
    rotation, to_sun, to_observer = (one[0] for one in (view.rotation, view.to_sun, view.to_observer))
    rows = len(model.assembly.context.seconds)
    poses = [None if pose is None else pose[0].expand(rows, 3, 3) for pose in view.poses]
    directions = {} if view.state.velocity is None else {VELOCITY: view.state.velocity[0]}
    for name, direction in (towards or {}).items():
        vector = torch.as_tensor(direction, dtype=torch.float64)
        if vector.shape not in ((3,), (rows, 3)):
            expected = f"(3,) or ({rows}, 3): a vector in GCRS, or one a row"
            raise InputError(None, f"towards[{name!r}]", f"shape {tuple(vector.shape)}", expected)
        directions[name] = vector.expand(rows, 3)

    def area(direction: Tensor) -> Tensor:
        return projected_areas(model.assembly.shape, view.facets, poses, direction)

    into_body = {name: torch.einsum("tji,tj->ti", rotation, unit(one)) for name, one in directions.items()}
    sunlight = None
    if view.state.position is not None:
        air = view.state.sun.new_tensor(DEFAULT_AIR_KM)
        sunlight = sunlit_fraction(view.state.position[0], view.state.sun[0], air)
    lit, seen, both = shown_fractions(model.assembly.shape, view.facets, poses, to_sun, to_observer)
    return Visibility(
        components=tuple(part.name for part in model.assembly.shape.parts),
        seconds=model.assembly.context.seconds,
        lit=lit,
        seen=seen,
        lit_and_seen=both,
        area_to_sun=area(to_sun),
        area_to_observer=area(to_observer),
        area_towards={name: area(one) for name, one in into_body.items()},
        sunlight=sunlight,
        rotation=rotation,
        to_sun=to_sun,
        to_observer=to_observer,
    )
