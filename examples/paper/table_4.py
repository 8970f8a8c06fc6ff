"""Table 4: the known materials, the width of their lobes, and how probable each is for what was inverted."""

from __future__ import annotations

import math

from inversion import inverted
from publish import Made, publish

from torchlc.materials.known import load_library

LISTED = ("Kapton", "Lambert-plate", "GaAs", "Al")


def make() -> Made:
    library = load_library()
    numbers: dict[str, object] = {
        name: {**library[name].values, "lobe_deg": math.degrees(1 / math.sqrt(library[name].values["n"] + 1))}
        for name in LISTED
    }
    numbers["probability"] = {
        f"object_{number} {part}": {one["name"]: one["probability"] for one in found}
        for number in (1, 2)
        for part, found in inverted(number).materials().items()
    }
    return numbers, None


if __name__ == "__main__":
    publish(__file__, make)
