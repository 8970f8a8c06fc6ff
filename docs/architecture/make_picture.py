"""The rooms of the package and the way of a recording through them: ``python docs/architecture/make_picture.py``."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import FancyBboxPatch

HERE = Path(__file__).parent
PACKAGE = HERE.parents[1] / "torchlc"
WAY = {
    "readers": "file to recording",
    "lightcurve": "scene to light",
    "inference": "light against recording",
    "diagnosis": "what is missing",
    "results": "numbers",
    "report": "pages",
}
"""Rooms that a recording passes, in this order, and what happens in each."""


def rooms() -> list[list[str]]:
    """The rooms of the page's table, floor by floor from the bottom."""
    text = (HERE / "index.md").read_text(encoding="utf-8")
    table = text.partition("## The rooms")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return [[name.rstrip("/") for name in re.findall(r"`([^`]+)`", cell)] for cell in cells]


def lines(room: str) -> int:
    """Lines of Python in a room."""
    folder = PACKAGE / room
    files = folder.rglob("*.py") if folder.is_dir() else [PACKAGE / f"{room}.py"]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)


def rounded(count: int) -> int:
    """To two figures, which stay true for a while."""
    return int(float(f"{count:.1e}"))


def draw(path: Path) -> None:
    floors = rooms()
    figure, axes = plt.subplots(figsize=(7.5, 9.0), layout="constrained")
    middle = {}
    for level, floor in enumerate(floors):
        widths = [math.sqrt(max(lines(room), 60)) / 20 for room in floor]
        left = -sum(widths) / 2 - 0.1 * (len(widths) - 1) / 2
        for room, width in zip(floor, widths, strict=True):
            colour = "#f2d9b8" if room in WAY else "#dfe7ef"
            box = FancyBboxPatch(
                (left, level), width, 0.62, boxstyle="round,pad=0.02", facecolor=colour, edgecolor="#5b6b7b"
            )
            axes.add_patch(box)
            middle[room] = (left + width / 2, level + 0.31)
            if len(floor) == 1:
                said = f"{room}: some {rounded(lines(room)):,} lines" + (
                    f"; {WAY[room]}" if room in WAY else ""
                )
                axes.text(3.0, level + 0.31, said, va="center", fontsize=9)
            left += width + 0.1
        if len(floor) > 1:
            axes.text(3.0, level + 0.31, ", ".join(floor), va="center", fontsize=9)
    way = [middle[room] for room in WAY]
    axes.plot(*zip(*way, strict=True), "o-", color="#b3541e", lw=2, ms=5, zorder=3)
    axes.set(xlim=(-2.9, 6.6), ylim=(-0.3, len(floors) + 0.2))
    axes.set_axis_off()
    drawn = {room: lines(room) for floor in floors for room in floor}
    figure.savefig(path, dpi=110, facecolor="white", metadata={"Description": json.dumps(drawn)})
    plt.close(figure)


if __name__ == "__main__":
    draw(HERE / "rooms.png")
