"""Figure 10: how Objects 1 and 2 hold themselves: wings north and south, or across the plane of Sun and nadir."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.figure import Figure
from publish import Made, publish
from setting import NIGHT, object_1, object_2

import torchlc
from torchlc.figures.object_drawing import draw_object

TITLES = ("Object 1: Y along the orbit's normal", "Object 2: Y across Sun and nadir")


def make() -> Made:
    numbers = {}
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    for number, axes in enumerate(figure.subplots(1, 2), 1):
        scene = (object_1, object_2)[number - 1]()
        start, hours = NIGHT[number]
        recording = torchlc.simulate(scene, start=start, hours=hours, cadence=600.0).recording
        model = torchlc.LightCurve(scene, recording)
        with torch.no_grad():
            view = model.view(model.values())
        pose = view.poses[1]
        assert pose is not None  # a wing tracks the Sun
        front = torch.einsum("tij,j->ti", pose[0], view.facets[1].normal[0])
        incidence = np.degrees(torch.acos((front * view.to_sun[0]).sum(-1).clamp(-1, 1)).numpy())
        draw_object(model, view, len(recording) // 2, axes)
        axes.set_title(f"{TITLES[number - 1]}\n{axes.get_title()}", fontsize=9.5)
        numbers[f"object_{number}"] = {
            "sun_to_y_deg": float(np.degrees(torch.acos(view.to_sun[0, :, 1]).numpy()).mean()),
            "incidence_on_wing_deg": (float(incidence.min()), float(incidence.max())),
        }
    return numbers, figure


if __name__ == "__main__":
    publish(__file__, make)
