"""Table 1: element sets put back into their columns from what the paper prints, and held to its own checksums."""

from __future__ import annotations

import numpy as np
import torch
from publish import Made, publish
from setting import ORBITS, cube

import torchlc
from torchlc.scene.tle import checksum

PRINTED = {
    1: (
        "16,037 A|20,284.07341138|-0.00000354|00000-0|00000+0|0|9996",
        "1.7237|67.2351|0007471|0.1818|88.7233|1.00273124|15,969",
    ),
    2: (
        "19,097 A|20,284.25674796|-0.00000355|+00000-0|+00000-0|0|9990",
        "000.4814|094.5914|0028139|151.0334|350.7694|01.0027179300|2881",
    ),
    3: (
        "14,026 A|20,284.37504348|-0.00000027|+00000-0|+00000-0|0|9997",
        "056.2287|052.2835|0020597|291.4800|068.3069|02.005690530|46,909",
    ),
    4: (
        "18,109 A|20,284.07190081|+0.00000009|+00000-0|+00000-0|0|9995",
        "055.0110|174.1807|0009159|205.9132|258.7572|02.005692580|13,471",
    ),
}
"""As printed, without the catalogue number, which is "xxxxx"."""
CATALOGUE = {1: 41586, 2: 44910, 3: 39741, 4: 43873}
"""Public catalogue numbers of the printed designators."""


def lines(orbit: int, catalogue: int) -> tuple[str, str, tuple[int, int]]:
    """Both lines without their last column, and the two checksums as printed.

    Thousands commas go, zeros and points come back; what follows the eighth decimal of the mean motion
    belongs to the revolution, and the last digit of each line is its checksum.
    """
    first, second = (text.split("|") for text in PRINTED[orbit])
    designator, epoch, slope, second_slope, drag, kind, last = first
    year = designator.replace(",", "").replace(" ", "")
    sign = "-" if slope.startswith("-") else " "
    rate = sign + slope.lstrip("+-").removeprefix("0")
    rest = " ".join(f"{one.removeprefix('+'):>8}" for one in (second_slope, drag))
    line_1 = f"1 {catalogue:05d}U {year:<8} {epoch.replace(',', '')} {rate} {rest} {kind}{last[:-1]:>5}"
    inclination, node, eccentricity, perigee, anomaly, motion, tail = second
    whole, decimals = motion.split(".")
    revolution = decimals[8:] + tail.replace(",", "")
    angles = [f"{float(one):8.4f}" for one in (inclination, node, perigee, anomaly)]
    line_2 = (
        f"2 {catalogue:05d} {angles[0]} {angles[1]} {eccentricity} {angles[2]} {angles[3]} "
        f"{int(whole):2d}.{decimals[:8]}{int(revolution[:-1]):5d}"
    )
    return line_1, line_2, (int(last[-1]), int(revolution[-1]))


def make() -> Made:
    numbers: dict[str, object] = {}
    agreeing = 0
    for orbit in PRINTED:
        line_1, line_2, printed = lines(orbit, CATALOGUE[orbit])
        agree = [checksum(line) == digit for line, digit in zip((line_1, line_2), printed, strict=True)]
        agreeing += sum(agree)
        placeholder = [line + str(checksum(line)) for line in lines(orbit, orbit)[:2]]
        scene = cube(orbit)
        rows = torchlc.simulate(scene, start="2020-10-10T12:00:00", hours=8.0, cadence=300.0).recording
        model = torchlc.LightCurve(scene, rows)
        with torch.no_grad():
            position = model.view(model.values()).state.position
        assert position is not None  # elements give it
        radius = np.linalg.norm(position[0].numpy(), axis=-1)
        numbers[f"orbit_{orbit}"] = {
            "printed_checksums": list(printed),
            "checksums_agree": all(agree),
            "lines": placeholder,
            "as_used": placeholder == list(ORBITS[orbit]),
            "radius_km": (radius.min(), radius.max()),
            "period_h": 24.0 / float(line_2[52:63]),
        }
    return {"checksums_agreeing": agreeing, **numbers}, None


if __name__ == "__main__":
    publish(__file__, make)
