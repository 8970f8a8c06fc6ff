"""Tables of docs/evidence: what was recorded, what is known to be missing, what torchlc says of it. From the numbers that the examples
wrote; docs/conf.py has the tables, docs/fill_numbers.py writes them into the pages."""

from __future__ import annotations

from family_tables import clocks, families, freed, remaining, shared_families, tracks
from fleet_tables import bright, classes, dark, nights, observers, splits, visor
from laboratory_tables import body, laboratory
from stored import DIAGNOSES, between, named, probability, read, table
from tumbling_tables import tumbling_bodies

FLEETS = "`python examples/fleets docs/evidence {}`"


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
        *tumbling_bodies(),
        (
            "[A made-up tumbling body](../tutorials/tumbling.md)",
            "its rotation, known",
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
