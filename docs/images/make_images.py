"""The pictures of the README, from one run of the demo: ``.venv/bin/python docs/images/make_images.py``.

demo.png: the recording under two models, as the scene has it and with the effect that the diagnosis names.
report.png: the head of the page that the demo leaves, as Chromium shows it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
from astropy.time import Time

from torchlc.api import demo
from torchlc.diagnosis.result import Diagnosis
from torchlc.figures.style import BEFORE, DATA, MODEL, style

HERE = Path(__file__).parent


def demo_figure(diagnosis: Diagnosis) -> None:
    recording = diagnosis.baseline.refit.model.recording
    hours = (recording.time - Time("2020-10-17")).to_value("hour")
    with plt.rc_context({**style(), "figure.facecolor": "white"}):
        figure, (upper, lower) = plt.subplots(
            2, 1, figsize=(8.2, 4.8), sharex=True, height_ratios=(2.2, 1), layout="constrained"
        )
        dots = {"fmt": "o", "ms": 2.4, "lw": 0, "elinewidth": 0.6}
        upper.errorbar(hours, recording.observed, recording.error, color=DATA, label="recording", **dots)
        cases = (
            ("as the scene has it", BEFORE, diagnosis.baseline.refit),
            (f"with {' and '.join(diagnosis.named)}", MODEL, diagnosis.final.refit),
        )
        for label, colour, refit in cases:
            rms = float(refit.delta.square().mean().sqrt())
            model = recording.observed - refit.delta.numpy()
            upper.plot(hours, model, color=colour, lw=1.5, label=f"{label}: rms {rms:.3f} mag", zorder=3)
            lower.plot(hours, refit.delta, "o", ms=2.4, color=colour)
        upper.invert_yaxis()
        upper.set_ylabel("magnitude")
        upper.legend(loc="upper right", fontsize=9)
        lower.axhline(0, color=DATA, lw=0.8)
        lower.set_ylabel("observed − model")
        lower.set_xlabel("hours, UT, 17 October 2020")
        lower.invert_yaxis()
        figure.savefig(HERE / "demo.png", dpi=110)


def report_picture(page: Path) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        print("report.png: no Chromium here", file=sys.stderr)
        return
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=4000"]
    size = ["--window-size=1000,1250", f"--screenshot={HERE / 'report.png'}"]
    subprocess.run([browser, *flags, *size, page.as_uri()], check=True, capture_output=True)


def main(out: Path) -> None:
    diagnosis, result = demo(out)
    print(diagnosis, result.headline(), f"{result.seconds['total']:.0f} s", sep="\n")
    demo_figure(diagnosis)
    report_picture(out / "report.html")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(Path(sys.argv[1]) if sys.argv[1:] else Path(scratch))
