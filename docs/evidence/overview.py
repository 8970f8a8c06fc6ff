"""Tables of docs/evidence: what was recorded, what is known to be missing, what torchlc says of it. From the numbers that the examples
wrote; docs/conf.py has the tables, docs/fill_numbers.py writes them into the pages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
DIAGNOSES = "`python examples/calibration/real_recordings.py docs/real_data`"
FLEETS = "`python examples/fleets.py docs/evidence {}`"


def read(path: str) -> Any:
    return json.loads((DOCS / path).read_text(encoding="utf-8"))


def named(found: dict[str, Any]) -> str:
    """Names of a diagnosis, or its verdict where it names nothing."""
    return ", ".join(f"`{name}`" for name in found["named"]) or found["verdict"].replace("_", " ")


def probability(found: dict[str, Any]) -> str:
    """That of the first name, where the diagnosis was stored with it."""
    said = found.get("probability")
    return "not stored" if said is None else f"{said:.2f}"


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
    rows = [
        (
            "[433 Eros](../real_data/index.md), 73 curves",
            "shadows of a body that is not convex; clocks of photographic and early photoelectric curves",
            named(eros),
            probability(eros),
            "yes",
            DIAGNOSES,
        ),
        (
            "[Starlink v1.5](starlink.md), 720 passes",
            "surfaces unlike the laboratory's; satellites differ",
            named(pomenis),
            probability(pomenis),
            "in part: more light than two plates send is sure, its place is not",
            DIAGNOSES,
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
            "0.50 to 0.81 a satellite",
            "silent: these magnitudes do not tell",
            FLEETS.format("visor"),
        ),
        (
            f"[Mini-MegaTORTORA](../real_data/index.md), {len(tracks)} tracks",
            "none documented; shapes and attitudes are nominal",
            f"clocks, wobbles and others in {len(tracks) - silent}, nothing in {silent}",
            "not stored",
            "not shown: nominal shapes may be behind these names",
            DIAGNOSES,
        ),
        (
            "[Tumbling bodies](../tutorials/tumbling.md)",
            "a made-up recording of known rotation",
            "pole and period, with their aliases",
            "as the page says",
            "yes",
            "`torchlc rotation`",
        ),
    ]  # fmt: skip
    visors = [row["probability"] for row in visor["satellites"]]
    rows[4] = (*rows[4][:3], f"{min(visors):.2f} to {max(visors):.2f} a satellite", *rows[4][4:])
    for page in ("paper_story", "concealed"):
        for one in read(f"evidence/{page}.json")["overview"]:
            told = one["probability"]
            rows.append(
                (
                    f"[{one['recording']}]({page}.md)",
                    one["cause"],
                    one["named"],
                    "" if told is None else f"{told:.2f}",
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
        "evidence_overview": overview(),
        "evidence_nights": nights(),
        "evidence_classes": classes(),
        "evidence_splits": splits(),
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
