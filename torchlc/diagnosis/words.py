"""A diagnosis in words, from the content of diagnosis.json."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from torchlc.brdf import MODELS
from torchlc.diagnosis.coordinates import TIME, in_words
from torchlc.digits import against_freedom, number_of, stated
from torchlc.effects import registry, with_title
from torchlc.errors import option
from torchlc.stages.effect import first_sentence
from torchlc.stages.entry import Entry

MOST_PARTS = 4
"""Values of one parameter, of curves or nights, that are listed one by one."""
MOST_ROWS = 12
"""Bad rows, or effects that were not examined, that are listed in a sentence."""
STATISTICS = {
    "chi2": "chi-square, which is too large",
    "too_small": "chi-square, which is too small",
    "window": "a stretch of rows that are too bright or too faint",
    "window of squares": "a stretch of rows that scatter too much",
}
VERDICTS = {
    "adequate": "Nothing is missing that these data could show",
    "missing_physics": "The model lacks {named}",
    "noise_model": "The misfit is noise, not physics: {named}",
    "unexplained": "Something is missing, and no effect of the library explains it",
}
LATE = (
    "Something is missing, and none of the effects that were examined explains it; it may be one of those for which there was "
    "no time"
)
TOLD_LATE = 0.05
"""Probability of effects that were not examined, from which on the first sentence says so."""


def added_values(added: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Values of the parameters of the added effects (entry: parameters), by effect and name, ready to print."""
    return {
        f"{Entry.parse(entry).name}.{short}": value
        for entry, parameters in added.items()
        for short, value in values_in_words(parameters).items()
    }


def headline(content: Mapping[str, Any]) -> str:
    """The verdict in one line with its probability, from the content of diagnosis.json."""
    if _cannot_tell(content):
        return f"These data cannot tell whether anything is missing: {content['doubt']}."
    families = [_or(family) for family in content["families"]]
    noise = [with_title(name) for name in content["named"]]
    late = content["probabilities"]["not_examined"]
    words = LATE if content["verdict"] == "unexplained" and late > TOLD_LATE else VERDICTS[content["verdict"]]
    verdict = words.format(named=_and(noise if content["verdict"] == "noise_model" else families))
    verdict = f"{verdict} (probability {probability(content['probabilities']['told'])})."
    if content["doubt"]:
        verdict = f"{verdict} {_first_upper(content['doubt'])}."
    p = chance(content["global_p"])
    return f"{verdict} The chance of structure like this where nothing is missing: {p}."


def _cannot_tell(content: Mapping[str, Any]) -> bool:
    """Whether the data say nothing of what is missing: no row is to spare."""
    return content["verdict"] == "adequate" and bool(content["doubt"])


def probability(p: float) -> str:
    """A probability as a person says it: per cent, and no more certain than a search of this kind can be."""
    per_cent = round(100 * p)
    if per_cent >= 100:
        return "over 99 %"
    return f"{per_cent} %" if per_cent > 0 else "below 1 %"


def odds(content: Mapping[str, Any]) -> str:
    """The probabilities of every kind of answer in one sentence."""
    p = content["probabilities"]
    answers = [("nothing missing", p["nothing_missing"]), ("noise alone", p["noise"])]
    late = {Entry.parse(left_out["effect"]).name for left_out in content["unexamined"]}
    late -= {row["effect"] for row in content["candidates"] if row["delta_log_evidence"] is not None}
    answers += [
        (with_title(name) + (", which was not examined," if name in late else ""), share)
        for name, share in list(p["effects"].items())[:MOST_PARTS]
        if share >= 0.005
    ]
    laws = p["other_laws"]
    answers += [
        (f"the law of reflection {law} instead", share) for law, share in laws.items() if share >= 0.005
    ]
    answers.append(("something that is not in the library", p["not_in_library"] - sum(laws.values())))
    if p["not_examined"] >= 0.005:
        answers.append(("an effect that was not examined", p["not_examined"]))
    return "Probabilities: " + ", ".join(f"{name} {probability(share)}" for name, share in answers) + "."


def unexamined(reasons: Mapping[str, str]) -> list[str]:
    """Candidates that were left out, by entry with the reason: a sentence for each reason, with the first of them."""
    sentences = []
    for reason in dict.fromkeys(reasons.values()):
        entries = [entry for entry, why in reasons.items() if why == reason]
        listed = [
            f"the law {entry}" if entry in MODELS else with_title(entry) for entry in entries[:MOST_ROWS]
        ]
        more = len(entries) - MOST_ROWS
        rest = f" and {more} more, which diagnosis.json lists" if more > 0 else ""
        sentences.append(f"not examined, for {reason}: {', '.join(listed)}{rest}")
    return sentences


def bad_rows(content: Mapping[str, Any]) -> str:
    """Which rows are probably outliers, in a sentence; nothing where none is."""
    rows = content["outliers"]
    if not rows:
        return ""
    shown = ", ".join(
        f"{row['place']} ({when})" if row["place"] else when
        for row in rows[:MOST_ROWS]
        for when in [f"{row['time'][:19].replace('T', ' ')}, {probability(row['probability'])}"]
    )
    more = f" and {len(rows) - MOST_ROWS} more" if len(rows) > MOST_ROWS else ""
    return f"{_bad(len(rows))}, further from the model than the errors allow: {shown}{more}."


def _count_of_bad_rows(content: Mapping[str, Any]) -> str:
    """How many rows are probably outliers; nothing where none is."""
    count = len(content["outliers"])
    return f"{_bad(count)}: see the table of bad rows." if count else ""


def _bad(count: int) -> str:
    return f"{number_of(count, 'row')} {'is' if count == 1 else 'are'} probably bad"


def shape(content: Mapping[str, Any]) -> str:
    """What no effect describes, in a sentence; nothing where none is likely."""
    odd = content["discrepancy"]
    if odd is None:
        return ""
    size = max(map(abs, odd["mag"]))
    beside = f" beside {' and '.join(map(with_title, odd['beside']))}" if odd["beside"] else ""
    return f"Light that no effect explains{beside} {odd['course']}. It is up to {size:.2g} mag."


def lines(content: Mapping[str, Any], added: Mapping[str, str], completed: Sequence[str]) -> list[str]:
    """What a terminal shows, from the content of diagnosis.json: the verdict, what was found, the materials before and
    after, what to do next; ``completed`` is the list of effects to fit with."""
    output = _answer(content)
    output += [sentence for sentence in (bad_rows(content), shape(content)) if sentence]
    output += [f"  {name} = {value}" for name, value in added.items()]
    if content["named"]:
        rows = [(f"  {name}", before, f"→ {after}") for name, before, after in changes(content["materials"])]
        rows += [(f"  {name}", before, f"→ {after}") for name, before, after in improvement(content)]
        widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
        output += [f"{name:{widths[0]}}  {before:>{widths[1]}} {after}" for name, before, after in rows]
    output.append(f"left: {content['remaining']['note']}")
    output += [f"next: {step}" for step in _next_steps(content)]
    if content["verdict"] == "missing_physics":
        effects = json.dumps(list(completed))
        output.append(f"to fit with it, put into [model] of the scene: effects = {effects}")
    return output


def words(content: Mapping[str, Any], added: Mapping[str, str]) -> list[str]:
    """Verdict, proof, place, materials and what cannot be told, in sentences for a page, which has a table of bad rows, from the content
    of diagnosis.json.
    """
    named, gains = content["named"], content["improvement"]
    paragraphs = _answer(content)
    if content["verdict"] == "missing_physics":
        proof = (
            f"With it in the model the residuals fall from {gains['rms_before']:.3f} to "
            f"{gains['rms_after']:.3f} mag (root mean square)"
            if content["error_source"] == "fitted"
            else f"With it in the model chi-square falls from {gains['chi2_before']:.0f} to "
            f"{against_freedom(gains['chi2_after'], gains['dof'], 0)}"
        )
        gain = content["proof"]["gain_of_final_over"].get("null")
        if gain is not None:
            proof += (
                f", and data that the fit has not seen are {gain['difference']:.0f} more probable in logarithm than by the "
                f"scene's own model, each with the errors that suit it (standard error {gain['error']:.0f})"
            )
        meant = [
            f"{name}: {_lowered(first_sentence(registry()[name]))}" for name in named if name in registry()
        ]
        values = (
            f" Found: {'; '.join(f'{_with_meaning(name)} {value}' for name, value in added.items())}."
            if added
            else ""
        )
        paragraphs.append(f"{proof}.{values} {' '.join(meant)}")
    if content["where"] is not None:
        paragraphs.append(_place(content["where"]))
    paragraphs += [sentence for sentence in (_count_of_bad_rows(content), shape(content)) if sentence]
    paragraphs.append(f"What is left: {content['remaining']['note']}.")
    paragraphs.append(f"What to do next: {_advice(content)}.")
    return paragraphs


def _answer(content: Mapping[str, Any]) -> list[str]:
    """The verdict, and the probabilities of all answers unless the data say nothing of them."""
    if _cannot_tell(content):
        return [headline(content)]
    return [headline(content), odds(content)]


def _next_steps(content: Mapping[str, Any]) -> list[str]:
    """The observation that would separate what is left; and another law that the surfaces follow, or more time where effects
    that may be it were not examined."""
    steps = [content["next_observation"].rstrip(".")] if content["next_observation"] else []
    count, laws = len(content["unexamined"]), content["probabilities"]["other_laws"]
    unexplained = content["verdict"] == "unexplained"
    likely = content["probabilities"]["not_examined"] > TOLD_LATE
    if unexplained and sum(laws.values()) > 0.5:
        law = max(laws, key=lambda name: laws[name])
        steps.append(
            f'write model = "{law}" with its numbers into the materials of the scene, and diagnose again'
        )
    elif count and (likely or unexplained):
        were = "was" if count == 1 else "were"
        steps.append(
            f"give the diagnosis more time with {option('budget')}, for {number_of(count, 'effect')} {were} not examined"
        )
    return steps


def _advice(content: Mapping[str, Any]) -> str:
    """What to do next: what would separate what is left, else what the verdict asks for."""
    steps = _next_steps(content)
    if steps:
        return "; ".join(steps)
    if content["verdict"] == "adequate":
        return (
            "more rows, or smaller errors, may show what these cannot"
            if content["doubt"]
            else "nothing need change in the scene; torchlc fit gives the whole posterior of the materials"
        )
    if content["verdict"] != "unexplained":
        return "put what is named into effects of the scene's [model], and fit again"
    return "look when and where it shows, and ask what in the sizes, the attitude or the recording belongs to that"


def _place(where: Mapping[str, Any]) -> str:
    intervals = where["intervals"]
    text = "It is too faint to show in any one stretch of the recording"
    if intervals:
        text = f"It shows in {len(intervals)} stretch{'es' if len(intervals) != 1 else ''} of the recording"
        strongest = max(intervals, key=lambda interval: interval["significance"])
        text += f", most between {_clock(strongest['start'])} and {_clock(strongest['end'])}"
    if where["components"]:
        first = where["components"][0]
        text += f"; {100 * first['share']:.0f} % of it comes from {first['name']}"
    coordinate = where["coordinate"]
    if coordinate and coordinate["name"] != TIME:  # the stretches are of time
        text += f"; it follows {in_words(coordinate['name'], coordinate['from'], coordinate['to'])}"
    return text + "."


def values_in_words(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Each parameter's value with its uncertainty; those that every curve or night has for itself in one, by their
    root mean square and range."""
    texts = {}
    for name, row in parameters.items():
        short, bracket, _ = name.partition("[")
        parts = [numbers["median"] for other, numbers in parameters.items() if other.startswith(f"{short}[")]
        if not bracket or len(parts) <= MOST_PARTS:
            texts[name] = _pair(row["median"], row["sd"], row["unit"])
        elif f"{short} of {len(parts)}" not in texts:
            spread = math.sqrt(sum(part**2 for part in parts) / len(parts))
            unit = f" {row['unit']}" if row["unit"] else ""
            low, high = min(parts), max(parts)
            texts[f"{short} of {len(parts)}"] = (
                f"root mean square {spread:.3g}{unit}, from {low:.3g} to {high:.3g}{unit}"
            )
    return texts


def _with_meaning(name: str) -> str:
    """A number of an effect with what it is: "half width (glint.width)" of "glint.width"."""
    effect, _, short = name.partition(".")
    quantity = re.split(r"\[| of ", short)[0]
    known = registry()[effect].quantities if effect in registry() else ()
    meant = next((listed.meaning for listed in known if listed.name == quantity), "")
    return f"{meant} ({name})" if meant else name


def statistic(name: str) -> str:
    """A statistic of the battery (:class:`~torchlc.diagnosis.gate.Battery`) as a person says it."""
    kind, _, rest = name.partition(" ")
    if kind == "along":
        return f"the residuals along {in_words(rest)}"
    if kind == "signature":
        return f"what {with_title(Entry.parse(rest).name)} would leave"
    if kind == "lag":
        return f"residuals that are alike {rest} row{'s' if rest != '1' else ''} apart"
    return STATISTICS.get(name, name)


def improvement(content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(measure, before, after); chi-square only where errors are quoted, for fitted ones make it what it is."""
    rows = [("chi-square", "chi2", 0), ("rms, mag", "rms", 4), ("rms of unseen rows, mag", "heldout_rms", 4)]
    table = []
    for name, key, digits in rows[content["error_source"] == "fitted" :]:
        before, after = (content["improvement"][f"{key}_{when}"] for when in ("before", "after"))
        if before is not None and after is not None:
            table.append((name, f"{before:.{digits}f}", f"{after:.{digits}f}"))
    return table


def changes(content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(parameter, before, after) of every material's parameter."""
    before, after = content["before"], content["after"]
    return [
        (name, material_value(before[name]), material_value(after[name])) for name in before if name in after
    ]


def material_value(row: Mapping[str, Any]) -> str:
    return stated({**row, "unit": ""})


def _pair(median: float, sd: float | None, unit: str) -> str:
    spread = sd or 0.0
    return stated(
        {
            "median": median,
            "sd": spread,
            "q05": median - 1.64 * spread,
            "q95": median + 1.64 * spread,
            "unit": unit,
        }
    )


def chance(p: float | None) -> str:
    if p is None:
        return "unknown"
    return "below 1e-12" if p < 1e-12 else f"{p:.2g}"


def _or(family: Sequence[str]) -> str:
    return (
        with_title(family[0])
        if len(family) == 1
        else f"{with_title(family[0])}, or {' or '.join(map(with_title, family[1:]))}: these data cannot tell which"
    )


def _and(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else "nothing"


def _clock(iso: str) -> str:
    return iso[:16].replace("T", " ")


def _first_upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _lowered(text: str) -> str:
    return text[:1].lower() + text[1:]


def _signed(value: float | None) -> str:
    return "" if value is None else f"{value:+.1f}" if abs(value) < 1000 else f"{value:+.0f}"


def candidate(row: Mapping[str, Any]) -> dict[str, str]:
    values = ", ".join(f"{name} {value}" for name, value in values_in_words(row["parameters"]).items())
    return {
        "effect": row["effect"]
        + (f" [{row['target']}]" if row.get("target") else "")
        + (f" of each {row['per']}" if row.get("per") else ""),
        "title": registry()[row["effect"]].title if row["effect"] in registry() else "",
        "evidence": _signed(row["delta_log_evidence"]),
        "heldout": _signed(row["heldout_delta_log_likelihood"]) or "not computed",
        "chi2": "" if row["chi2_after"] is None else f"{row['chi2_after']:.0f}",
        "values": values,
    }
