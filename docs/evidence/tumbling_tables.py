"""Tables of the page on real tumbling bodies, from the numbers that examples/rotation/real_tracks.py wrote."""

from __future__ import annotations

from typing import Any

from stored import read, table

COMMAND = "`python examples/rotation/real_tracks.py docs/evidence`"
PUBLISHED = {
    "10025, 2016": (11.85, 11.815, 1),
    "10025, 2022": (12.3938, 12.3555, 1),
    "10025, 2024": (12.5290, 12.4091, 1),
    "1863, 2016": (1.4973, None, 2),
    "1863, 2025": (1.6301, None, 2),
    "40209": (4.4075, None, 1),
}
"""Of each track: the published period, that between its glints where somebody measured it, s, and how often it comes in a turn."""
SHOWN = 4


def _read() -> dict[str, Any]:
    return read("evidence/tumbling.json")


def _turns(mode: dict[str, Any]) -> str:
    return ", ".join(f"{one['period_s']:.4g}" for one in mode["nights"]) or f"{mode['period_s']:.5g}"


def searches() -> str:
    """Each search: what it found, and what that leaves."""
    rows = []
    for name, found in _read().items():
        modes = [mode for mode in found["modes"] if mode["probability"] > 0.01]
        best = modes[0]
        said = found["verdict"].partition(":")[0] if found["verdict"].startswith("cannot tell") else "told"
        rows.append(
            (
                name,
                " + ".join(map(str, found["rows"])),
                f"{found['searched_s'][0]:g} to {found['searched_s'][1]:g}",
                said if "how often" not in found["verdict"] else "counts not told",
                "; ".join(_turns(mode) for mode in modes[:SHOWN]),
                "; ".join(
                    f"{mode['pole_icrs'][0]:.0f} {mode['pole_icrs'][1]:+.0f} ± {mode['pole_sd_deg']:.0f}"
                    for mode in modes[:SHOWN]
                ),
                f"{best['rms_mag']:.2f}",
                f"{found['noise']:.2f}",
                f"{best['rms_mag'] / found['noise']:.2f}",
                f"{found['cpu_seconds']:.0f}",
            )
        )
    head = (
        "search", "rows", "turns looked at, s", "answer", "turn of its modes, s", "pole RA Dec, deg", "rms left, mag",
        "noise, mag", "over it", "CPU s",
    )  # fmt: skip
    return table([head, *rows])


def periods() -> str:
    """What each track's modes say of the period as it is published."""
    known = _read()
    rows = []
    for name, (published, glints, times) in PUBLISHED.items():
        if name not in known:
            continue
        modes = [mode for mode in known[name]["modes"] if mode["probability"] > 0.01]
        light = [mode["passes"][0]["synodic_s"] for mode in modes if mode["passes"]]
        rows.append(
            (
                name,
                f"{published:g}",
                "" if glints is None else f"{glints:g}",
                _span([mode["period_s"] for mode in modes]),
                _span([one / times for one in light if one is not None]),
            )
        )
    head = (
        "track",
        "published, s",
        "between glints, s",
        "turn of the modes, s",
        "light against the bisector, s",
    )
    return table([head, *rows])


def _span(values: list[float]) -> str:
    if not values:
        return ""
    low, high = min(values), max(values)
    return f"{low:.5g}" if high - low < 5e-4 * low else f"{low:.5g} to {high:.5g}"


def unseen() -> str:
    """Passes predicted by the others."""
    rows = [
        (
            name,
            one["night"],
            f"{one['predicted']:.2f}",
            f"{one['fitted']:.2f}",
            f"{one['predicted'] / one['fitted']:.2f}",
        )
        for name, found in _read().items()
        for one in found["unseen"]
    ]
    return table([("search", "pass left out", "predicted, mag rms", "fitted, mag rms", "times"), *rows])


def tumbling_bodies() -> list[tuple[str, ...]]:
    """Rows of the overview: one for each body."""
    known = _read()

    def told(name: str) -> str:
        best = known[name]["modes"][0]
        return f"turn in {_turns(best)} s, {best['rms_mag'] / known[name]['noise']:.2f} times the noise"

    said = (
        ("Atlas Centaur stage, three passes", "10025, three passes, four paints", "turns of 11.82, 12.36 and 12.41 s by its glints",
         "turns yes; one pole serves all three; an unseen pass is not predicted to its noise"),
        ("Transtage, two passes", "1863, two passes", "periods of light of 1.497 and 1.630 s", "turns yes, twice these; pole not known otherwise"),
        ("Centaur of Atlas V, 98 rows", "40209", "a period of light of 4.41 s", "silent on the pole: it lists what fits"),
        ("FLTSATCOM 2, two slow flashes", "FLTSATCOM 2", "none documented", "silent"),
    )  # fmt: skip
    return [
        (
            f"[{body}](tumbling.md)",
            cause,
            told(name),
            f"{known[name]['modes'][0]['probability']:.2f}",
            right,
            COMMAND,
        )
        for body, name, cause, right in said
        if name in known
    ]


def tumbling_tables() -> dict[str, str]:
    return {"tumbling_searches": searches(), "tumbling_periods": periods(), "tumbling_unseen": unseen()}
