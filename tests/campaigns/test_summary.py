"""The summary of a campaign as a spreadsheet opens it."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pandas
import pyarrow.parquet

from torchlc.campaigns.summary import arrow_schema, write_csv


def test_no_cell_of_the_summary_is_a_formula(tmp_path: Path):
    """Cells that a spreadsheet would run (OWASP, CSV injection) are text; numbers, also negative ones, are numbers."""
    hostile = [
        "=cmd|' /C calc'!A0",
        "+1+cmd",
        "-2+3",
        "@SUM(1)",
        "\t=1",
        "\r=1",
        "＝1",
        "plain",
        "a=b",
        "-5",
        "+1e3",
        "-.5",
    ]
    rows = [
        {"id": text, "directory": "objects/x", "scene": "s", "recording": "r", "task": "fit", "status": "failed",
         "reason": text, "seed": 1, "rms_mag": -0.5, "chi2": 1e-7}
        for text in hostile
    ]  # fmt: skip
    pyarrow.parquet.write_table(
        pyarrow.Table.from_pylist(rows, schema=arrow_schema()), tmp_path / "t.parquet"
    )
    write_csv(tmp_path / "t.csv", tmp_path / "t.parquet")
    with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as stream:
        cells = [row["id"] for row in csv.DictReader(stream)]
    assert cells == [f"'{text}" for text in hostile[:7]] + hostile[7:]
    assert not any(cell[:1] in "=+-@\t\r" and not re.fullmatch(r"[-+]?[\d.]+(e\d+)?", cell) for cell in cells)
    table = pandas.read_csv(tmp_path / "t.csv")
    assert set(table.rms_mag) == {-0.5} and set(table.chi2) == {1e-7}
