"""A part that the shape lacks: an antenna, a radiator, an adapter ring."""

from __future__ import annotations

import torch

from torchlc.brdf.ashikhmin_shirley import AshikhminShirley
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, REFLECTANCE, Quantity
from torchlc.stages.effect import Effect
from torchlc.stages.light import Patch
from torchlc.stages.showing import NIGHT, Shown


class Appendage(Effect):
    """A flat, two-sided plate of unknown area, normal and material, fixed to the body.

    Light tied to one direction of the body, worst where the rest is faint: 3 m2 of white paint is 1 mag on
    a box-wing of 14 mag. Neglected: what it hides or shadows, what hides or shadows it, and curvature,
    which a low n imitates.
    """

    name = "appendage"
    title = "a further flat part that the model lacks"
    shown = Shown(NIGHT, "phase_angle_deg", {"area": 1.5, "lon": 20.0, "lat": 70.0})
    stage = "surface"
    adds_area = True
    order = 1
    brdf = AshikhminShirley
    simplex = ("r_spec", "r_diff")
    coupled = True
    quantities = (
        Quantity(
            "area", "m2", 0.0, 10.0, "area of one side", off=0.0, typical=1.0, prior="halfnormal", sigma=2.0
        ),
        Quantity(
            "lon",
            "deg",
            -180.0,
            180.0,
            "longitude of the normal in the body frame, from +X to +Y",
            typical=0.0,
        ),
        Quantity(
            "lat",
            "deg",
            -90.0,
            90.0,
            "latitude of the normal in the body frame, towards +Z",
            typical=45.0,
            prior="isotropic",
        ),
        Quantity("n", "", 1.0, 1e6, "lobe exponent", typical=100.0, prior="loguniform", role=EXPONENT),
        Quantity(
            "r_spec",
            "",
            0.0,
            1.0,
            "mirror-like reflectance at normal incidence",
            typical=0.3,
            role=LOBE_REFLECTANCE,
        ),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", typical=0.3, role=REFLECTANCE),
    )

    def surface(self, patches, view, p, context):
        lon, lat = (torch.deg2rad(p[name][..., 0]) for name in ("lon", "lat"))
        lon, lat = torch.broadcast_tensors(lon, lat)  # in a batch, one may be free and the other fixed
        east = torch.stack([-torch.sin(lon), torch.cos(lon), torch.zeros_like(lon)], -1)
        up = torch.stack(
            [torch.cos(lat) * torch.cos(lon), torch.cos(lat) * torch.sin(lon), torch.sin(lat)], -1
        )
        plate = Patch(
            component=self.label, material=self.material_key, model=AshikhminShirley, faces=["front", "back"],
            normal=torch.stack([up, -up], -2), u=torch.stack([east, east], -2),
            area=p["area"].expand(*p["area"].shape[:-1], 2),
        )  # fmt: skip
        return (*patches, plate)
