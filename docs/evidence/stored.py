"""Results that the examples stored for docs/evidence, and how its pages write them."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
DIAGNOSES = "`python examples/calibration/real_recordings.py docs/real_data --only {}`"


def read(path: str) -> Any:
    return json.loads((DOCS / path).read_text(encoding="utf-8"))


def named(found: dict[str, Any]) -> str:
    """Names of a diagnosis, or its verdict where it names nothing."""
    return ", ".join(f"`{name}`" for name in found["named"]) or found["verdict"].replace("_", " ")


def probability(found: dict[str, Any]) -> str:
    """That of the first name, where the diagnosis was stored with it."""
    said = found.get("probability")
    return "not stored" if said is None else f"{said:.2f}"


def magnitudes(value: float | None) -> str:
    return "not stored" if value is None else f"{value:.3f} mag"


def between(numbers: list[float]) -> str:
    """The least and the largest of some probabilities."""
    return f"{min(numbers):.2f} to {max(numbers):.2f}"


def median(rows: Any, key: str) -> str:
    return f"{statistics.median(row[key] for row in rows):.2f}"


def table(rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])
