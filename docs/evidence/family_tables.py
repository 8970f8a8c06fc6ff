"""What is said of tracks of Mini-MegaTORTORA, alone and by families."""

from __future__ import annotations

from typing import Any

from stored import DOCS, between, median, named, probability, read, table

FAMILIES = "`python examples/calibration/mmt9_families.py docs/evidence`"
CLOCKS = {"time_offset", "wobble"}


def shared_families() -> list[tuple[str, ...]]:
    """A row for each family of tracks: what one model of all leaves of tracks that it has seen and of those that it has not, and what
    is named of the rest."""
    rows = []
    for name, found in stored_families().items():
        tracks = found["tracks"].values()
        asked = [one["remains"] for one in tracks if "remains" in one]
        near = sum(one["unseen_rms_about_own_offset"] < 1.5 * one["noise"] for one in tracks)
        said = [named(one) for one in asked]
        rows.append(
            (
                f"[{name}](mmt9.md), {len(tracks)} tracks in one fit",
                "none documented; sizes, attitude, materials free and shared",
                "; ".join(f"{one} ({said.count(one)})" for one in dict.fromkeys(said)) or "not stored",
                between([one["probability"] for one in asked]) if asked else "not stored",
                f"silent: {near} of {len(tracks)} tracks are predicted by the others to 1.5 times their noise, an offset of each apart; "
                f"left of a track in the fit {median(tracks, 'rms_about_own_offset')} mag, of one left out "
                f"{median(tracks, 'unseen_rms_about_own_offset')} mag, noise {median(tracks, 'noise')} mag (medians)",
                FAMILIES,
            )
        )
    return rows


def stored_families() -> dict[str, Any]:
    """Fits of families by name, those that were made."""
    file = "evidence/mmt9_families.json"
    return read(file) if (DOCS / file).exists() else {}


def families() -> str:
    """What the model that a family shares leaves, track by track."""
    keys = (
        "noise",
        "recorded",
        "rms_about_own_offset",
        "own_angles_rms_about_own_offset",
        "unseen_rms",
        "unseen_rms_about_own_offset",
    )
    rows = [
        (
            name,
            number,
            *(f"{one[key]:.3f}" for key in keys),
            f"{one['unseen_rms_about_own_offset'] / one['noise']:.1f}",
        )
        for name, found in stored_families().items()
        for number, one in found["tracks"].items()
    ]
    head = (
        "family",
        "track",
        "noise",
        "scatter recorded",
        "left, shared",
        "left, own angles",
        "left out",
        "left out, own offset",
        "over the noise",
    )
    return table([head, *rows])


def remaining() -> str:
    """What a diagnosis about its family's fit says of each track, beside that of the track alone."""
    alone = read("real_data/verdicts.json")
    rows = []
    for name, found in stored_families().items():
        for number, one in found["tracks"].items():
            if "remains" in one:
                told = one["remains"]
                gain = told["improvement"]
                rows.append(
                    (
                        name,
                        number,
                        named(alone[f"mmt9 {number}"]),
                        named(told),
                        probability(told),
                        f"{gain['rms_before']:.3f} to {gain['rms_after']:.3f}",
                        f"{told['cpu_seconds']:.0f}",
                    )
                )
    head = (
        "family",
        "track",
        "said of the track alone",
        "said about its family",
        "probability",
        "rms, mag",
        "CPU s",
    )
    return table([head, *rows])


def clocks() -> str:
    """How many tracks alone are blamed on clocks or wobbles, and how many of these about their families."""
    alone = read("real_data/verdicts.json")
    blamed = [
        one["remains"]
        for found in stored_families().values()
        for number, one in found["tracks"].items()
        if "remains" in one and CLOCKS & set(alone[f"mmt9 {number}"]["named"])
    ]
    return f"{len(blamed)}, about their families {sum(bool(CLOCKS & set(one['named'])) for one in blamed)}"


def freed() -> str:
    """What each family's fit found of what is shared."""
    names = (
        "attitude_offset.x",
        "attitude_offset.y",
        "attitude_offset.z",
        "panel_offset.deg",
        "object_scatter.mag",
        "jitter.mag",
    )
    rows = [
        (name, *(f"{found['parameters'][key]:.2f}" for key in names))
        for name, found in stored_families().items()
    ]
    head = (
        "family",
        "turn about X, deg",
        "Y",
        "Z",
        "arrays, deg",
        "spread of offsets, mag",
        "error beyond the noise, mag",
    )
    return table([head, *rows])


def tracks() -> str:
    """What a diagnosis says of each track alone."""
    found = read("real_data/verdicts.json")
    rows = []
    for name, one in found.items():
        if not name.startswith("mmt9"):
            continue
        gain = one["improvement"]
        pair = [
            (f"{gain[f'{kind}_before']:.3f}", f"{gain[f'{kind}_after']:.3f}")
            for kind in ("rms", "heldout_rms")
        ]
        rows.append(
            (
                one["object"].partition(",")[0],
                name.partition(" ")[2],
                named(one),
                probability(one),
                *(before if before == after else f"{before} to {after}" for before, after in pair),
            )
        )
    return table([("family", "track", "said", "probability", "rms, mag", "of unseen rows, mag"), *rows])
