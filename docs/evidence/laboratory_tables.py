"""What is said of the laboratory's body."""

from __future__ import annotations

from typing import Any

from stored import DIAGNOSES, magnitudes, named, probability, read, table

BODY, THERE = "hac_body03", ("self_shadowing", "near_field", "radiance_power", "start_phase")
"""The laboratory's body, and the effects that its rendering is known to have."""
NOT_THERE = ("finite_sun", "background", "radiance_threshold")
"""Effects that would be named for a penumbra, uniform ambient light and a threshold, none of which the laboratory's rendering has."""


def laboratory(diagnoses: dict[str, Any]) -> list[tuple[str, ...]]:
    """A row for the laboratory's body, once its diagnosis is stored."""
    if BODY not in diagnoses:
        return []
    found = diagnoses[BODY]
    wrong = [f"`{name}`" for name in found["named"] if name in NOT_THERE]
    missed = [f"`{name}`" for name in THERE if name not in found["named"]]
    beside = [f"`{name}`" for name in found["named"] if name not in {*THERE, *NOT_THERE}]
    right = f"{', '.join(missed)} not named" if missed else "yes"
    return [
        (
            "[A laboratory's body](laboratory.md), 21 curves",
            "shadows, a camera that is near, a detector that is not linear in radiance, one curve that begins late",
            named(found),
            probability(found),
            f"{right}; "
            + (f"{', '.join(beside)} is not documented; " if beside else "")
            + (
                f"{', '.join(wrong)} is not there"
                if wrong
                else "no penumbra, ambient light or threshold is named"
            ),
            DIAGNOSES.format(BODY),
        )
    ]


def body() -> dict[str, str]:
    """What docs/evidence/laboratory.md says in numbers."""
    one = read("real_data/verdicts.json").get(BODY)
    if one is None:
        names = (
            "named",
            "probability",
            "rms_before",
            "rms_after",
            "unseen_before",
            "unseen_after",
            "seconds",
            "untried",
        )
        return {f"laboratory_{name}": "not stored" for name in (*names, "parameters", "effects")}
    gain = one["improvement"]
    return {
        "laboratory_named": named(one),
        "laboratory_probability": probability(one),
        "laboratory_rms_before": f"{gain['rms_before']:.3f}",
        "laboratory_rms_after": f"{gain['rms_after']:.3f}",
        "laboratory_unseen_before": magnitudes(gain["heldout_rms_before"]),
        "laboratory_unseen_after": magnitudes(gain["heldout_rms_after"]),
        "laboratory_parameters": table(
            [
                ("number", "value", "standard deviation"),
                *(
                    (f"`{entry}` {name}", f"{row['median']:.3g}", f"{row['sd']:.2g}")
                    for entry, values in (one["parameters"] | one["farthest"]).items()
                    for name, row in values.items()
                ),
            ]
        ),
        "laboratory_effects": table(
            [
                ("effect", "probability"),
                *((f"`{name}`", f"{p:.3f}") for name, p in one["effects"].items() if p > 5e-4),
            ]
        ),
        "laboratory_seconds": f"{one['cpu_seconds']:.0f}",
        "laboratory_untried": ", ".join(f"`{name}`" for name in one["untried"]) or "none",
    }
