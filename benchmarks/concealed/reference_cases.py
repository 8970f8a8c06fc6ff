"""Cases by the brute-force reference of ``examples/reference``, composed as in ``examples/calibration``."""

from __future__ import annotations

import json
import sys
import zlib
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path[:0] = [str(EXAMPLES / one) for one in ("calibration", "reference")]

from cases import CONDUCTORS, SIZES, Composed, compose  # noqa: E402
from concealed import RECIPES, Rng, kinds  # noqa: E402
from gain import gain, sized  # noqa: E402
from make_injections import write_composed  # noqa: E402

GAIN = 15.0
"""Of each of several causes: the root of the chi-square that its absence costs."""
SEEN = 5.0
"""Least gain of each of several causes: where limits keep one below it, nobody could tell that it is there."""
SINGLE = ("panel_offset", "attitude_offset", "spin_rate_offset", "appendage", "second_material", "lobe_tail",
          "time_offset", "along_track_offset", "zero_point_drift", "zero_point_step", "background",
          "saturation", "panel_cant", "back_transmission", "color_term", "self_shadowing")  # fmt: skip
TOGETHER = {
    "wing": (
        "attitude_offset",
        "background",
        "zero_point_step",
        "saturation",
        "back_transmission",
        "color_term",
    ),
    "geo": ("panel_offset", "second_material", "background", "zero_point_drift", "saturation"),
    "box": ("spin_rate_offset", "appendage", "zero_point_step", "saturation", "background"),
    "leo": ("time_offset", "background", "zero_point_drift", "appendage", "saturation"),
}
"""By kind of object, what may be concealed together."""
NONE = ("geo", "geo_free", "meo", "box", "wing", "leo")


def make(kind: str, number: int, seed: int, folder: Path) -> str:
    """Case ``number`` of a class, made into ``folder``; returns a line about it."""
    name = f"reference-{kind}-{number}"
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    line = write_composed(name, folder, seed, rng, _composed(kind, number, rng))
    path = folder / "answer.json"
    answer = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(
        json.dumps({**answer, "class": kind, "generator": "reference"}, indent=1), encoding="utf-8"
    )
    return line


def _composed(kind: str, number: int, rng: Rng) -> Composed:
    catalogue = 70001 + number
    if kind == "none":
        return compose(f"control_{rng.choice(NONE)}", catalogue, rng)
    if kind == "one":
        return compose(f"{rng.choice(SINGLE)}-{rng.choice(list(SIZES))}", catalogue, rng)
    if kind in ("two", "three"):
        return _several(2 if kind == "two" else 3, catalogue, rng)
    if kind == "unlisted":
        return compose(f"outside-{rng.choice(['flash', 'cloud'])}", catalogue, rng)
    if kind == "other law":
        law, thing, effect = CONDUCTORS[int(rng.integers(len(CONDUCTORS)))]
        return compose(f"{law}-{thing}-{effect}-bare", catalogue, rng)
    return compose(f"wrong-box-{rng.choice(['wing', 'box'])}", catalogue, rng)


def _several(count: int, catalogue: int, rng: Rng) -> Composed:
    """So many causes, each of which is seen alone; objects are drawn until one shows so many."""
    while True:
        thing = str(rng.choice(list(TOGETHER)))
        setup, concealed = kinds(catalogue)[thing](rng), {}
        for effect in (str(one) for one in rng.permutation(TOGETHER[thing])):
            _, maker, first, limits = RECIPES[effect]
            make_one = maker(rng)
            with_it, one = make_one(sized(setup, make_one, first, limits, GAIN), setup)
            if gain(with_it, one) >= SEEN:
                setup, concealed = with_it, concealed | one
            if len(concealed) == count:
                return setup, concealed, {"verdict": "missing_physics"}
