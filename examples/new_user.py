"""Somebody new: a table of magnitudes and two lines of elements, to a verdict.

    python examples/new_user.py [DIRECTORY]

The table and the elements are the demo's, as a spreadsheet and a catalogue would give them. What is typed at a terminal is
what this script hands to the command line: init, simulate, diagnose.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from astropy.table import Table

import torchlc
from torchlc.cli import run

DEMO = Path(torchlc.__file__).parent / "demo"
STATION = "weihai,37.536,122.05,110"


def torchlc_command(*arguments: object) -> None:
    print("$ torchlc", *arguments)
    if run(list(map(str, arguments))) != 0:
        raise SystemExit(1)


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()) / "new_user"
    out.mkdir(parents=True, exist_ok=True)
    scene = torchlc.load(DEMO / "scene.toml")
    assert scene.orbit.tle is not None
    (out / "elements.txt").write_text("MY SATELLITE\n" + "\n".join(scene.orbit.tle) + "\n")
    table = Table.read(DEMO / "recording.ecsv")[["time", "mag", "mag_err", "exptime"]]
    table[::2].write(out / "night.csv", format="ascii.csv", overwrite=True)

    mine = out / "my.toml"
    torchlc_command("init", mine, "--tle", out / "elements.txt", "--preset", "box-wing", "--exact", "--force",
                    "--station", STATION)  # fmt: skip
    sizes = {"[2, 2, 2.5]": "[2.01, 1.712, 2.189]", "[2, 6]": "[1.72, 6.60]", "4.5, 0]": "5.75, 0]"}
    text = mine.read_text()
    for nominal, measured in sizes.items():  # as an editor would
        text = text.replace(nominal, measured)
    mine.write_text(text)
    torchlc_command("simulate", mine, out / "night.csv", "-o", out / "look")
    torchlc_command("diagnose", mine, out / "night.csv", "-o", out / "diagnosis", "--quick",
                    "--effects", "second_material,zero_point_drift,panel_offset")  # fmt: skip
    print(f"open {out / 'diagnosis' / 'report.html'}")


if __name__ == "__main__":
    main()
