"""The pictures of the README, from the demo: ``.venv/bin/python docs/images/make_images.py``.

demo.png: the recording under two models, as the scene has it and with the effect that the diagnosis names.
report.png: the head of the page that ``torchlc demo`` leaves, as Chromium shows it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from astropy.time import Time

import torchlc
from torchlc.api import demo
from torchlc.figures import DATA, FIGURE_STYLE, MODEL

HERE = Path(__file__).parent
DEMO = Path(torchlc.__file__).parent / "demo"
STEPS = 600
BEFORE = "#2374c6"


def demo_figure() -> None:
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    (named,) = torchlc.diagnose(scene, recording, quick=True).named
    effects = [*(scene.model.effects or []), f"{named}[panel]"]
    fuller = scene.model_copy(update={"model": scene.model.model_copy(update={"effects": effects})})
    results = [torchlc.fit(one, recording, steps=STEPS) for one in (scene, fuller)]
    hours = (recording.time - Time("2020-10-17")).to_value("hour")
    with plt.rc_context({**FIGURE_STYLE, "figure.facecolor": "white"}):
        figure, (upper, lower) = plt.subplots(
            2, 1, figsize=(8.2, 4.8), sharex=True, height_ratios=(2.2, 1), layout="constrained"
        )
        dots = {"fmt": "o", "ms": 2.4, "lw": 0, "elinewidth": 0.6}
        upper.errorbar(hours, recording.observed, recording.error, color=DATA, label="recording", **dots)
        labels = ("as the scene has it", f"with {named}")
        for label, result, colour in zip(labels, results, (BEFORE, MODEL), strict=True):
            rms = float(np.sqrt(np.mean(result.delta**2)))
            text = f"{label}: rms {rms:.3f} mag"
            upper.plot(hours, result.prediction, color=colour, lw=1.5, label=text, zorder=3)
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
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        print("report.png: no Chromium here", file=sys.stderr)
        return
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=4000"]
    with tempfile.TemporaryDirectory() as out:
        demo(out)
        page, picture = Path(out) / "report.html", HERE / "report.png"
        size = ["--window-size=1100,1500", f"--screenshot={picture}"]
        subprocess.run([browser, *flags, *size, page.as_uri()], check=True, capture_output=True)


if __name__ == "__main__":
    demo_figure()
    report_picture()
