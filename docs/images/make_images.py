"""The pictures of the README, from the demo: ``.venv/bin/python docs/images/make_images.py`` (Chromium for the second).

demo.png: the recording under two models, as the scene has it and with the effect that the diagnosis names.
report.png: the head of the page that ``torchlc diagnose`` leaves, or of the fit's, as a browser shows it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import torchlc
from torchlc.figures import DATA, FIGURE_STYLE, MODEL

HERE = Path(__file__).parent
DEMO = Path(torchlc.__file__).parent / "demo"
STEPS = 600
BEFORE = "#2374c6"


def demo_figure() -> None:
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    diagnosis = torchlc.diagnose(scene, recording, quick=True)
    (named,) = diagnosis.named
    fuller = scene.model_copy(
        update={
            "model": scene.model.model_copy(
                update={"effects": [*(scene.model.effects or []), f"{named}[panel]"]}
            )
        }
    )
    models = {
        "as the scene has it": (torchlc.fit(scene, recording, steps=STEPS), BEFORE),
        f"with {named}": (torchlc.fit(fuller, recording, steps=STEPS), MODEL),
    }
    hours = recording.seconds / 3600 + 14
    with plt.rc_context({**FIGURE_STYLE, "figure.facecolor": "white"}):
        figure, (upper, lower) = plt.subplots(
            2, 1, figsize=(8.2, 4.8), sharex=True, height_ratios=(2.2, 1), layout="constrained"
        )
        upper.errorbar(
            hours,
            recording.observed,
            recording.error,
            fmt="o",
            ms=2.4,
            lw=0,
            elinewidth=0.6,
            color=DATA,
            label="recording",
        )
        for label, (result, colour) in models.items():
            rms = float(np.sqrt(np.mean(result.delta**2)))
            upper.plot(
                hours, result.prediction, color=colour, lw=1.5, label=f"{label}: rms {rms:.3f} mag", zorder=3
            )
            lower.plot(hours, result.delta, "o", ms=2.4, color=colour)
        upper.invert_yaxis()
        upper.set_ylabel("magnitude")
        upper.legend(loc="upper right", fontsize=9)
        lower.axhline(0, color=DATA, lw=0.8)
        lower.set_ylabel("observed − model")
        lower.set_xlabel("hours, UT, 17 October 2020")
        lower.invert_yaxis()
        figure.savefig(HERE / "demo.png", dpi=130)


def report_picture() -> None:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        print("report.png: no Chromium here", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as out:
        scene, recording = DEMO / "scene.toml", DEMO / "recording.ecsv"
        torchlc.diagnose(scene, recording, quick=True, out=out)
        if not (Path(out) / "report.html").exists():
            torchlc.fit(scene, recording, steps=STEPS, out=out)
        subprocess.run(
            [
                program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1100,1500",
                "--virtual-time-budget=4000", f"--screenshot={HERE / 'report.png'}", (Path(out) / "report.html").as_uri(),
            ],
            check=True, capture_output=True,
        )  # fmt: skip


if __name__ == "__main__":
    demo_figure()
    report_picture()
