"""Sentences of a diagnosis, from small contents of diagnosis.json: what they say, and what they leave out."""

from __future__ import annotations

import re
from typing import Any

import pytest

from torchlc.diagnosis.words import (
    MOST_PARTS,
    MOST_ROWS,
    added_values,
    bad_rows,
    candidate,
    chance,
    changes,
    headline,
    improvement,
    lines,
    odds,
    probability,
    shape,
    statistic,
    unexamined,
    values_in_words,
    words,
)

STEP = "zero_point_step (a zero point that jumps at one moment)"
DRIFT = "zero_point_drift (a zero point that drifts)"
SKY = "background (constant light that is not the object's)"


def row(median: float, sd: float, unit: str = "") -> dict[str, Any]:
    return {"median": median, "sd": sd, "q05": median - 1.64 * sd, "q95": median + 1.64 * sd, "unit": unit}


LATE = {"effect": "wobble", "reason": "there was no time"}


def content(**other: Any) -> dict[str, Any]:
    """Of a step that is named, with whatever is ``other``; probabilities are added to the usual ones."""
    usual = {
        "verdict": "missing_physics", "named": ["zero_point_step"], "families": [["zero_point_step"]],
        "doubt": "", "global_p": 0.004, "error_source": "recording", "outliers": [], "discrepancy": None,
        "unexamined": [], "candidates": [], "next_observation": "", "remaining": {"note": "nothing that the data show"},
        "improvement": {
            "chi2_before": 1060.8, "chi2_after": 110.4, "dof": 116, "rms_before": 0.18726, "rms_after": 0.0204,
            "heldout_rms_before": 0.19, "heldout_rms_after": 0.021,
        },
        "materials": {
            "before": {"foil.n": row(200.0, 40.0), "foil.r_spec": row(0.3, 0.1)},
            "after": {"foil.r_diff": row(0.2, 0.1), "foil.r_spec": row(0.25, 0.02), "foil.n": row(100.0, 4.0)},
        },
        "proof": {"gain_of_final_over": {"null": {"difference": 223.9, "error": 19.6}}},
        "where": None,
    }  # fmt: skip
    share = {
        "told": 0.97, "nothing_missing": 0.01, "noise": 0.02, "effects": {"zero_point_step": 0.97},
        "not_in_library": 0.0, "other_laws": {}, "not_examined": 0.0,
    }  # fmt: skip
    return usual | {"probabilities": share | other.pop("probabilities", {})} | other


# ------------------------------------------------------------------ numbers


def test_a_probability_is_the_nearest_per_cent_and_never_certain() -> None:
    """From 1 to 99 %: at the middle between these and certainty too."""
    for tenth in range(1001):
        p = tenth / 1000
        said = probability(p)
        if said == "below 1 %":
            assert p <= 0.005
        elif said == "over 99 %":
            assert p >= 0.995
        else:
            number = int(said.removesuffix(" %"))
            assert 1 <= number <= 99 and abs(number / 100 - p) <= 0.005 + 1e-12, said
    assert (probability(0.0), probability(1.0)) == ("below 1 %", "over 99 %")


@pytest.mark.parametrize(
    ("p", "said"), [(None, "unknown"), (0.0, "below 1e-12"), (2e-12, "2e-12"), (0.0412, "0.041"), (1.0, "1")]
)
def test_a_chance_has_two_digits(p: float | None, said: str) -> None:
    assert chance(p) == said


def test_values_of_few_parts_are_listed_and_of_many_summed_up() -> None:
    """Five curves at -4, 0, 0, 0 and 3: their mean square is 5. What is not divided stays a line of its own."""
    parts = dict(zip("abcde", (-4.0, 0.0, 0.0, 0.0, 3.0), strict=True))
    many = {f"deg[{name}]": row(value, 0.1, "deg") for name, value in parts.items()} | {
        "mag": row(0.25, 0.01, "mag")
    }
    assert values_in_words(many) == {
        "deg of 5": "root mean square 2.24 deg, from -4 to 3 deg", "mag": "0.250 ± 0.010 mag"
    }  # fmt: skip
    assert values_in_words(dict(reversed(many.items()))) == values_in_words(many)
    assert values_in_words(many | {"deg": row(1.0, 0.1, "deg")})["deg"] == "1.00 ± 0.10 deg"
    few = {name: many[name] for name in list(many)[:MOST_PARTS]}
    assert list(values_in_words(few)) == list(few)
    assert values_in_words(few)["deg[a]"] == "-4.00 ± 0.10 deg"
    two = many | {f"s[{name}]": row(2.0, 0.1) for name in parts}
    assert values_in_words(two)["s of 5"] == "root mean square 2, from 2 to 2"
    assert added_values({"time_offset@curve~10": few, "zero_point_step": {"mag": many["mag"]}}) == {
        **{f"time_offset.{name}": value for name, value in values_in_words(few).items()},
        "zero_point_step.mag": "0.250 ± 0.010 mag",
    }
    assert values_in_words({"mag": row(0.25, 0.0, "mag") | {"sd": None}}) == {"mag": "0.25 mag"}


def test_before_and_after_stand_side_by_side_where_both_are_known() -> None:
    """Without quoted errors chi-square is what the fit makes it, and says nothing."""
    whole = content()
    assert improvement(whole) == [
        ("chi-square", "1061", "110"),
        ("rms, mag", "0.1873", "0.0204"),
        ("rms of unseen rows, mag", "0.1900", "0.0210"),
    ]
    assert improvement(whole | {"error_source": "fitted"}) == improvement(whole)[1:]
    unseen = whole["improvement"] | {"heldout_rms_after": None}
    assert improvement(whole | {"improvement": unseen}) == improvement(whole)[:2]
    assert changes(whole["materials"]) == [
        ("foil.n", "200 ± 40", "100.0 ± 4.0"),
        ("foil.r_spec", "0.30 ± 0.10", "0.250 ± 0.020"),
    ]


# ------------------------------------------------------------------ the verdict


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({}, f"The model lacks {STEP} (probability 97 %)."),
        (
            {"families": [["zero_point_step", "zero_point_drift", "background"]]},
            f"The model lacks {STEP}, or {DRIFT} or {SKY}: these data cannot tell which (probability 97 %).",
        ),
        (
            {"families": [["zero_point_step"], ["zero_point_drift"], ["background"]]},
            f"The model lacks {STEP}, {DRIFT} and {SKY} (probability 97 %).",
        ),
        (
            {"verdict": "noise_model", "named": ["jitter"], "families": [["jitter"]]},
            "The misfit is noise, not physics: jitter (",
        ),
        ({"verdict": "adequate", "named": [], "families": []}, "Nothing is missing that these data could show ("),
        (
            {"verdict": "adequate", "named": [], "families": [], "doubt": "3 free numbers leave none to spare"},
            "These data cannot tell whether anything is missing: 3 free numbers leave none to spare.",
        ),
        (
            {"verdict": "unexplained", "named": [], "families": [], "doubt": "nearest in the library: x 9 %"},
            "Something is missing, and no effect of the library explains it (probability 97 %). Nearest in the library: x 9 %.",
        ),
        (
            {"verdict": "unexplained", "named": [], "families": [], "probabilities": {"not_examined": 0.06}},
            "Something is missing, and none of the effects that were examined explains it; it may be one of those",
        ),
    ],
)  # fmt: skip
def test_the_first_line_says_the_verdict_with_its_probability(other: dict[str, Any], said: str) -> None:
    """And the chance of what is seen where nothing is missing, unless nothing can be told."""
    line = headline(content(**other))
    assert line.startswith(said)
    ends = "The chance of structure like this where nothing is missing: 0.004."
    assert line.endswith(ends) is (not line.startswith("These data cannot tell"))


def test_of_the_odds_only_what_counts_is_listed() -> None:
    """Other laws are no part of what is not in the library; effects below half a per cent, and more than four, are left out."""
    effects = dict.fromkeys(
        ["zero_point_step", "zero_point_drift", "background", "saturation", "wobble"], 0.1
    )
    some = content(
        probabilities={
            "effects": effects, "nothing_missing": 0.2, "noise": 0.001, "not_in_library": 0.25,
            "other_laws": {"lambert": 0.2, "cook-torrance": 0.004}, "not_examined": 0.05,
        }
    )  # fmt: skip
    said = odds(some)
    assert said.startswith("Probabilities: nothing missing 20 %, noise alone below 1 %, ")
    assert f"{STEP} 10 %, {DRIFT} 10 %, {SKY} 10 %, saturation (" in said and "wobble" not in said
    assert "the law of reflection lambert instead 20 %" in said and "cook" not in said
    assert "something that is not in the library 5 %" in said
    assert said.endswith(", an effect that was not examined 5 %.")
    some["unexamined"] = [{"effect": "saturation", "reason": "there was no time"}]
    assert re.search(r"saturation \([^)]*\), which was not examined, 10 %", odds(some))
    some["unexamined"] = [{"effect": "zero_point_drift[roof]", "reason": "there was no time"}]
    some["candidates"] = [{"effect": "zero_point_drift", "target": "hill", "delta_log_evidence": 3.0}]
    assert f"{DRIFT} 10 %" in odds(some)  # for another of its targets there was
    few = content(
        probabilities={"effects": {"zero_point_step": 0.97, "background": 0.004}, "not_examined": 0.004}
    )
    assert "background" not in odds(few) and "not examined" not in odds(few)


# ------------------------------------------------------------------ what was left out, and what is left


def test_what_was_not_examined_is_told_by_its_reason() -> None:
    reasons = {"wobble": "there was no time", "lambert": "there was no time", "background": "40 s of light"}
    first, second = unexamined(reasons)
    assert first.startswith("not examined, for there was no time: wobble (") and first.endswith(
        ", the law lambert"
    )
    assert second == f"not examined, for 40 s of light: {SKY}"
    many = {f"background@{number}": "there was no time" for number in range(MOST_ROWS + 3)}
    (sentence,) = unexamined(many)
    assert sentence.count("background@") == MOST_ROWS
    assert sentence.endswith(" and 3 more, which diagnosis.json lists")
    assert "more" not in unexamined(dict(list(many.items())[:MOST_ROWS]))[0]
    assert unexamined({}) == []


def test_bad_rows_are_listed_as_far_as_a_sentence_holds() -> None:
    rows = [
        {"time": f"2026-03-15T20:{minute:02}:00.000", "place": f"line {minute}", "probability": 0.9}
        for minute in range(MOST_ROWS + 1)
    ]
    assert bad_rows(content()) == ""
    (first,) = [rows[0] | {"place": ""}]
    assert bad_rows(content(outliers=[first])) == (
        "1 row is probably bad, further from the model than the errors allow: 2026-03-15 20:00:00, 90 %."
    )
    said = bad_rows(content(outliers=rows))
    assert said.startswith("13 rows are probably bad, ") and said.endswith(" and 1 more.")
    assert "line 11 (2026-03-15 20:11:00, 90 %)" in said and "line 12" not in said


def test_the_shape_of_what_no_effect_describes_is_told_with_its_size() -> None:
    """The largest of its magnitudes, whichever way."""
    assert shape(content()) == ""
    odd = {"mag": [0.01, -0.283, 0.1], "beside": [], "course": "comes again every 12 min"}
    said = "Light that no effect explains comes again every 12 min. It is up to 0.28 mag."
    assert shape(content(discrepancy=odd)) == said
    beside = odd | {"beside": ["zero_point_step", "background"]}
    assert f"explains beside {STEP} and {SKY} comes" in shape(content(discrepancy=beside))


# ------------------------------------------------------------------ the whole


def test_a_terminal_shows_numbers_in_columns_and_what_to_put_into_the_scene() -> None:
    shown = lines(content(), {"zero_point_step.mag": "0.250 ± 0.010 mag"}, ["zero_point_step"])
    assert shown[:2] == [headline(content()), odds(content())]
    assert shown[2] == "  zero_point_step.mag = 0.250 ± 0.010 mag"
    table = [line for line in shown if "→" in line]
    assert [line.split()[0] for line in table] == ["foil.n", "foil.r_spec", "chi-square", "rms,", "rms"]
    assert len({line.index("→") for line in table}) == 1
    assert shown[-2:] == [
        "left: nothing that the data show",
        'to fit with it, put into [model] of the scene: effects = ["zero_point_step"]',
    ]
    quiet = content(verdict="adequate", named=[], families=[])
    assert lines(quiet, {}, []) == [headline(quiet), odds(quiet), "left: nothing that the data show"]


def test_a_page_tells_the_proof_the_values_and_what_the_effect_is() -> None:
    paragraphs = words(content(), {"zero_point_step.mag": "0.250 ± 0.010 mag"})
    assert paragraphs[2] == (
        "With it in the model chi-square falls from 1061 to 110 for 116 degrees of freedom, and data that the fit has not seen "
        "are 224 more probable in logarithm than by the scene's own model, each with the errors that suit it (standard error 20). "
        "Found: added after the step (zero_point_step.mag) 0.250 ± 0.010 mag. zero_point_step: adds mag to the rows later than "
        "time hours after the first row, as when a camera was restarted."
    )
    bare = words(content(error_source="fitted", proof={"gain_of_final_over": {}}), {})[2]
    assert bare.startswith(
        "With it in the model the residuals fall from 0.187 to 0.020 mag (root mean square). zero_point_step: "
    )


WHERE = {
    "intervals": [
        {"start": "2026-03-15T19:00:30.000", "end": "2026-03-15T19:20:30.000", "significance": 4.0},
        {"start": "2026-03-15T21:00:30.000", "end": "2026-03-15T22:10:30.000", "significance": 9.0},
    ],
    "components": [{"name": "panel", "share": 0.624}, {"name": "body", "share": 0.376}],
    "coordinate": {"name": "phase_angle_deg", "from": 20.0, "to": 45.53},
}  # fmt: skip


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (
            {},
            "It shows in 2 stretches of the recording, most between 2026-03-15 21:00 and 2026-03-15 22:10; 62 % of it comes from "
            "panel; it follows the phase angle, between 20 and 45.5 deg.",
        ),
        (
            {"intervals": WHERE["intervals"][:1], "components": [], "coordinate": None},
            "It shows in 1 stretch of the recording, most between 2026-03-15 19:00 and 2026-03-15 19:20.",
        ),
        (
            {"intervals": [], "components": [], "coordinate": {"name": "time", "from": 0.0, "to": 9.0}},
            "It is too faint to show in any one stretch of the recording.",
        ),
        (
            {"intervals": [], "components": [], "coordinate": {"name": "obs_lat_body", "from": 81.7562, "to": 81.7579}},
            "It is too faint to show in any one stretch of the recording; it follows the latitude of the observer on the body, "
            "between 81.756 and 81.758 deg.",
        ),
        (
            {"intervals": [], "components": [], "coordinate": {"name": "obs_lat_body", "from": 81.7562, "to": 81.7562}},
            "It is too faint to show in any one stretch of the recording; it follows the latitude of the observer on the body, "
            "between 81.8 and 81.8 deg.",
        ),
    ],
)  # fmt: skip
def test_a_page_tells_where_it_shows(other: dict[str, Any], said: str) -> None:
    """The strongest stretch and the component with most of it; time is told by the stretches alone."""
    assert said in words(content(where=WHERE | other), {})
    assert not any(sentence.startswith("It ") for sentence in words(content(), {}))


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({}, "put what is named into effects of the scene's [model], and fit again"),
        ({"next_observation": "Look in June."}, "Look in June"),
        ({"verdict": "adequate"}, "nothing need change in the scene; torchlc fit gives the whole posterior"),
        ({"verdict": "adequate", "doubt": "few rows"}, "more rows, or smaller errors, may show what these cannot"),
        ({"verdict": "unexplained"}, "look when and where it shows, and ask what in the sizes"),
        (
            {"verdict": "unexplained", "unexamined": [LATE], "next_observation": "Look in June."},
            "Look in June; give the diagnosis more time with budget, for 1 effect was not examined",
        ),
        ({"unexamined": [LATE, LATE]}, "put what is named into effects"),  # hardly one of these
        (
            {"unexamined": [LATE, LATE], "probabilities": {"not_examined": 0.06}},
            "give the diagnosis more time with budget, for 2 effects were not examined",
        ),
        (
            {
                "verdict": "unexplained", "unexamined": [LATE],
                "probabilities": {"other_laws": {"lambert": 0.2, "cook-torrance": 0.6}, "not_in_library": 0.9},
            },
            'write model = "cook-torrance" with its numbers into the materials of the scene, and diagnose again',
        ),
    ],
)  # fmt: skip
def test_the_last_sentence_says_what_to_do_next(other: dict[str, Any], said: str) -> None:
    """On a page as on a terminal, where what the verdict asks for anyway is left out."""
    some = content(**({"named": [], "families": []} if "verdict" in other else {}) | other)
    last = words(some, {})[-1]
    assert last.startswith(f"What to do next: {said}") and last.endswith(".") and ".." not in last
    steps = [line.removeprefix("next: ") for line in lines(some, {}, []) if line.startswith("next: ")]
    asked = bool(re.match("Look|give|write", said))
    assert steps == (last.removeprefix("What to do next: ")[:-1].split("; ") if asked else [])


# ------------------------------------------------------------------ tables


def test_a_row_of_the_table_of_what_was_tried() -> None:
    tried = {
        "effect": "zero_point_drift", "target": None, "per": "night", "parameters": {"mag_per_hour": row(0.02, 0.001)},
        "delta_log_evidence": 12345.67, "heldout_delta_log_likelihood": -2.34, "chi2_after": 110.4,
    }  # fmt: skip
    assert candidate(tried) == {
        "effect": "zero_point_drift of each night", "title": "a zero point that drifts", "evidence": "+12346",
        "heldout": "-2.3", "chi2": "110", "values": "mag_per_hour 0.0200 ± 0.0010",
    }  # fmt: skip
    left = {
        "effect": "color_term", "target": "panel +Y", "parameters": {}, "delta_log_evidence": None,
        "heldout_delta_log_likelihood": None, "chi2_after": None,
    }  # fmt: skip
    assert candidate(left) | {"title": ""} == {
        "effect": "color_term [panel +Y]", "title": "", "evidence": "", "heldout": "not computed", "chi2": "",
        "values": "",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("chi2", "chi-square, which is too large"),
        ("lag 1", "residuals that are alike 1 row apart"),
        ("lag 3", "residuals that are alike 3 rows apart"),
        ("signature zero_point_step", f"what {STEP} would leave"),
        ("signature background@curve~0.1", f"what {SKY} would leave"),
        ("along phase_angle_deg", "the residuals along the phase angle"),
    ],
)
def test_a_statistic_is_said_in_words(name: str, said: str) -> None:
    assert statistic(name) == said
