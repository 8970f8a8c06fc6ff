"""An astronomer: a table as AstroImageJ exports it, to materials with errors and a figure.

    python examples/astronomer.py [DIRECTORY]

The table is simulated with the demo's scene. It has the columns of AstroImageJ, times in JD, and a row that was not measured
(99.999); torchlc reads it as it is.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import torchlc

DEMO = Path(torchlc.__file__).parent / "demo"
START_JD = 2459140.1041667
UNMEASURED = 7
HEADER = "\tLabel\tslice\tJD_UTC\tAIRMASS\tSource_AMag_T1\tSource_AMag_Err_T1\n"


def exported(path: Path) -> Path:
    """An AstroImageJ table of the demo's object: every eighth minute of four hours, 0.02 mag of noise."""
    curve = torchlc.simulate(DEMO / "scene.toml", start=START_JD, hours=4.0, cadence=480, noise=0.02, seed=3)
    airmass = curve.columns["airmass"]
    assert airmass is not None  # the demo has a station
    rows = []
    for number, (seconds, mag, thick) in enumerate(
        zip(curve.recording.seconds, curve.mag, airmass, strict=True), 1
    ):
        jd, told = START_JD + seconds / 86400, "99.999" if number == UNMEASURED else f"{mag:.4f}"
        rows.append(f"{number}\tframe_{number:03}.fits\t{number}\t{jd:.6f}\t{thick:.3f}\t{told}\t0.0200\n")
    path.write_text(HEADER + "".join(rows))
    return path


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()) / "astronomer"
    out.mkdir(parents=True, exist_ok=True)
    table = exported(out / "Measurements.tbl")
    scene, recording = torchlc.load(DEMO / "scene.toml", table)
    print(recording)
    result = torchlc.fit(scene, recording, out=out / "fit")  # until its chain has converged: about a minute
    print(result)
    print(f"figure: {out / 'fit' / 'curve.png'}")


if __name__ == "__main__":
    main()
