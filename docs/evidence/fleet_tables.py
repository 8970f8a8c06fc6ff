"""What is said of fleets of Starlink satellites."""

from __future__ import annotations

from stored import read, table


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
