"""What a shell offers after an option, looked up when it asks. Each takes what has been typed so far."""

from __future__ import annotations


def effects(incomplete: str) -> list[str]:
    """Names of the library, the last of a list with commas being completed."""
    from torchlc.effects import names

    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in names() if name.startswith(last)]


def shapes(incomplete: str) -> list[str]:
    """Presets of ``torchlc init``, without the blanks that a shell would have to quote."""
    from torchlc.cli.scaffold import PRESETS

    return [name for name in (key.replace(" ", "-") for key in PRESETS) if name.startswith(incomplete)]


def laws(incomplete: str) -> list[str]:
    """Models of reflection."""
    from torchlc.brdf import MODELS

    return [name for name in MODELS if name.startswith(incomplete)]


def kinds(incomplete: str) -> list[str]:
    """What a recording can hold."""
    return [name for name in ("mag", "flux") if name.startswith(incomplete)]
