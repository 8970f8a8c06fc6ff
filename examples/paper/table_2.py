"""Table 2: areas of the two box-wings, and the edges of Object 1's box that give its three areas."""

from __future__ import annotations

import torch
from publish import Made, publish
from setting import BOX_OBJECT_1, GAP_OBJECT_1, NIGHT, object_1, object_2

import torchlc


def make() -> Made:
    numbers: dict[str, object] = {}
    for number, scene in ((1, object_1()), (2, object_2())):
        start, hours = NIGHT[number]
        rows = torchlc.simulate(scene, start=start, hours=hours, cadence=3600.0).recording
        model = torchlc.LightCurve(scene, rows)
        with torch.no_grad():
            view = model.view(model.values())
        numbers[f"object_{number}"] = {
            f"{patch.component} {face}_m2": float(area)
            for patch in view.patches
            for face, area in zip(patch.faces, patch.area, strict=True)
        }
    numbers["object_1_edges_m"] = dict(zip("xyz", BOX_OBJECT_1, strict=True))
    numbers["object_1_gap_m"] = GAP_OBJECT_1
    return numbers, None


if __name__ == "__main__":
    publish(__file__, make)
