"""Tables of docs/evidence: what was recorded, what is known to be missing, what torchlc says of it. From the numbers that the examples
wrote; docs/conf.py has the tables, docs/fill_numbers.py writes them into the pages."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
DIAGNOSES = "`python examples/calibration/real_recordings.py docs/real_data --only {}`"
FAMILIES = "`python examples/calibration/mmt9_families.py docs/evidence`"
BODY, THERE = "hac_body03", ("self_shadowing", "near_field", "radiance_power", "start_phase")
"""The laboratory's body, and the effects that its rendering is known to have."""
NOT_THERE = ("finite_sun", "background", "radiance_threshold")
"""Effects that would be named for a penumbra, uniform ambient light and a threshold, none of which the laboratory's rendering has."""
FLEETS = "`python examples/fleets docs/evidence {}`"


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


def between(numbers: list[float]) -> str:
    """The least and the largest of some probabilities."""
    return f"{min(numbers):.2f} to {max(numbers):.2f}"


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


def median(rows: Any, key: str) -> str:
    return f"{statistics.median(row[key] for row in rows):.2f}"


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


CLOCKS = {"time_offset", "wobble"}


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


def overview() -> str:
    """One row a recording or question: documented cause, name, probability, whether that is right, and the command."""
    diagnoses, fleets = read("real_data/verdicts.json"), read("evidence/fleets.json")
    eros, pomenis = diagnoses["eros"], diagnoses["starlink_v15"]
    split = fleets["v2mini"]["splits"][0]
    height = next(row for row in fleets["v2mini"]["splits"] if row["column"] == "height")
    dark, visor = fleets["v2mini"]["dark"], fleets["visor"]
    low, high = visor["auc_of_magnitude_90"]
    tracks = [found for name, found in diagnoses.items() if name.startswith("mmt9")]
    silent = sum(not found["named"] for found in tracks)
    told = [found for found in tracks if found.get("probability") is not None]
    rows = [
        *laboratory(diagnoses),
        (
            "[433 Eros](../real_data/index.md), 73 curves",
            "shadows of a body that is not convex; clocks of photographic and early photoelectric curves",
            named(eros),
            probability(eros),
            "yes",
            DIAGNOSES.format("eros"),
        ),
        (
            "[Starlink v1.5](starlink.md), 720 passes",
            "surfaces unlike the laboratory's; satellites differ",
            named(pomenis),
            probability(pomenis),
            "in part: more light than two plates send is sure, its place is not",
            DIAGNOSES.format("starlink_v15"),
        ),
        (
            "[Starlink v2 mini](starlink.md), two populations",
            "direct-to-cell satellites at 330 to 380 km, others at 500 to 580 km",
            f"two populations, divided by {split['column']}",
            f"{split['probability']:.2f} ({height['column']}: {height['probability']:.2f}), of the columns recorded",
            "yes: both columns divide the same satellites",
            FLEETS.format("v2mini"),
        ),
        (
            "[Starlink v2 mini](starlink.md), rows not illuminated",
            "none documented",
            f"in the umbra by their own place and time: {dark['wholly_hidden']} of {len(dark['rows'])}",
            "",
            "place or time of these rows is wrong: what is in the umbra is not of 3 to 6 mag",
            FLEETS.format("v2mini"),
        ),
        (
            "[Visor or none](starlink.md), 23 satellites",
            "visor fitted or not",
            f"area under the curve {visor['auc_of_magnitude']:.2f} ({low:.2f} to {high:.2f}, 90 %)",
            f"{between([row['probability'] for row in visor['satellites']])} a satellite",
            "silent: these magnitudes do not tell",
            FLEETS.format("visor"),
        ),
        (
            f"[Mini-MegaTORTORA](../real_data/index.md), {len(tracks)} tracks",
            "none documented; shapes and attitudes are nominal",
            f"clocks, wobbles and others in {len(tracks) - silent}, nothing in {silent}",
            between([found["probability"] for found in told if found["named"]]) if told else "not stored",
            "not shown: nominal shapes may be behind these names",
            DIAGNOSES.format("mmt9"),
        ),
        *shared_families(),
        (
            "[Tumbling bodies](../tutorials/tumbling.md)",
            "a made-up recording of known rotation",
            "pole and period, with their aliases",
            "as the page says",
            "yes",
            "`torchlc rotation`",
        ),
    ]  # fmt: skip
    for page in ("paper_story", "concealed"):
        for one in read(f"evidence/{page}.json")["overview"]:
            likely = one["probability"]
            rows.append(
                (
                    f"[{one['recording']}]({page}.md)",
                    one["cause"],
                    one["named"],
                    "" if likely is None else f"{likely:.2f}",
                    one["right"],
                    f"`{one['command']}`",
                )
            )
    head = ("recording", "documented cause", "named", "probability", "right?", "command")
    return table([head, *rows])


def table(rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def nights() -> str:
    found = read("evidence/fleets.json")["v15"]
    models = {name: row for name, row in found.items() if isinstance(row, dict)}
    rows = [
        (name, f"{row['seen']:.2f}", f"{row['unseen']:.2f}", f"{row['unseen_median']:+.2f}")
        for name, row in models.items()
    ]
    rows.append(("published, inferred Phong", "0.46", f"{found['published']:.2f}", ""))
    return table([("model", "robust sigma, seen", "unseen nights", "their median"), *rows])


def classes() -> str:
    found = read("evidence/fleets.json")["v2mini"]
    rows = []
    for key, name in (("high", "above 430 km"), ("low", "below 430 km")):
        row = found[key]
        spread = row["parameters"]["object_scatter.mag"]
        rows.append(
            (name, str(row["objects"]), str(row["rows"]), f"{row['unseen']:.2f}", f"{row['unseen_objects']:.2f}", f"{spread:.2f}")
        )  # fmt: skip
    head = (
        "class",
        "satellites",
        "rows",
        "robust sigma, rows of unseen satellites",
        "of their medians",
        "spread that was learnt",
    )
    return table([head, *rows])  # fmt: skip


def observers() -> str:
    """Satellites below 430 km by who saw them."""
    found = read("evidence/fleets.json")["observers"]
    rows = [
        (
            title,
            str(row["rows"]),
            str(row["objects"]),
            str(row["passes"]),
            f"{row['within_pass']:.2f}",
            f"{row['unseen']:.2f}",
            f"{row['unseen_with_outliers']:.2f}",
            f"{row['unseen_median_of_passes']:.2f}",
        )
        for key, title in (("photometer", "the survey's photometer"), ("visual", "visual observers"))
        for row in [found[key]]
    ]
    head = (
        "seen by",
        "rows",
        "satellites",
        "passes",
        "rows of one pass differ by, mag",
        "robust sigma, rows of unseen satellites",
        "where rows may be outliers",
        "of medians of their passes",
    )
    return table([head, *rows])


def bright() -> str:
    """Share of bright rows by station."""
    rows = [
        (f"{row['latitude']:.1f}", str(row["rows"]), f"{100 * row['bright']:.0f} %")
        for row in read("evidence/fleets.json")["observers"]["stations"]
    ]
    return table([("station's latitude", "rows", "brighter than 3 mag at 400 km"), *rows])


def splits() -> str:
    rows = [
        (
            row["column"],
            f"{row['log_evidence']:.1f}",
            f"{row['probability']:.2g}",
            f"{row['between'][0]:.6g} and {row['between'][1]:.6g}",
            *(
                f"{side['objects']}: {side['median']:+.2f} ± {side['sigma']:.2f}"
                for side in (row["below"], row["above"])
            ),
        )
        for row in read("evidence/fleets.json")["v2mini"]["splits"]
    ]
    head = (
        "column",
        "ln of the evidence gained",
        "probability",
        "cut between",
        "satellites below, mag",
        "and above",
    )
    return table([head, *rows])


def dark() -> str:
    rows = [
        (
            row["object"],
            row["time"],
            f"{row['mag']:.1f}",
            f"{row['elevation_deg']:.0f}",
            f"{row['hidden']:.2f}",
        )
        for row in read("evidence/fleets.json")["v2mini"]["dark"]["rows"]
    ]
    return table([("satellite", "time, UTC", "mag", "elevation, deg", "of the Sun hidden"), *rows])


def visor() -> str:
    found = read("evidence/fleets.json")["visor"]
    rows = [
        (row["name"], f"{row['mag']:.2f}", f"{row['reduced']:.2f}", "yes" if row["visor"] else "no", f"{row['probability']:.2f}")
        for row in found["satellites"]
    ]  # fmt: skip
    return table([("satellite", "mag", "at 550 km", "visor", "probability of one"), *rows])


def tables() -> dict[str, str]:
    """What stands in the pages, by name."""
    fleets = read("evidence/fleets.json")
    visors, dim, ways = fleets["visor"], fleets["v2mini"]["dark"], fleets["modes"]
    return {
        **body(),
        "evidence_overview": overview(),
        "evidence_tracks": tracks(),
        "evidence_families": families(),
        "evidence_families_remain": remaining(),
        "evidence_families_shared": freed(),
        "evidence_families_clocks": clocks(),
        "evidence_nights": nights(),
        "evidence_classes": classes(),
        "evidence_splits": splits(),
        "evidence_observers": observers(),
        "evidence_bright": bright(),
        "evidence_bright_told": f"{fleets['observers']['bright_told']:.2f}",
        "evidence_dark": dark(),
        "evidence_visor": visor(),
        "evidence_v15_rows": str(fleets["v15"]["rows"]),
        "evidence_v15_nights": str(fleets["v15"]["nights"]),
        "evidence_v2_rows": str(fleets["v2mini"]["rows"]),
        "evidence_v2_objects": str(fleets["v2mini"]["objects"]),
        "evidence_dark_others": str(dim["others_wholly_hidden"]),
        "evidence_modes_passes": str(ways["passes"]),
        "evidence_modes_second": str(ways["passes"] - ways["first_passes"]),
        "evidence_modes_second_sigma": f"{ways['sigma'][1]:.2f}",
        "evidence_modes_first_sigma": f"{ways['sigma'][0]:.1f}",
        "evidence_modes_both": f"{ways['satellites_in_both']} of {ways['satellites_of_several_passes']}",
        "evidence_modes_gain": f"{ways['log_density_gained']:.0f} ± {ways['standard_error']:.0f}",
        "evidence_modes_unseen": f"{ways['unseen_in_its_mode']:.2f}",
        "evidence_modes_single": f"{ways['unseen_one_model']:.2f}",
        "evidence_visor_fainter": f"{visors['fainter_with_visor']:.2f}",
        "evidence_visor_sigma": f"{visors['sigma']:.2f}",
        "evidence_visor_auc": f"{visors['auc_of_magnitude']:.2f}",
        "evidence_visor_auc_90": " to ".join(f"{end:.2f}" for end in visors["auc_of_magnitude_90"]),
        "evidence_visor_left_out": f"{visors['auc']:.2f}",
        "evidence_visor_right": f"{visors['right']} of {visors['of']}",
    }
