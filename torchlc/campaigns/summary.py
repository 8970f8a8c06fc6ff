"""The campaign on one page and in one table, from the records on disk in the manifest's order, a few rows at
a time: the same whatever worker did what when.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from torchlc.campaigns.manifest import Job
from torchlc.campaigns.objects import read_record
from torchlc.files.writing import OutputDirectory

if TYPE_CHECKING:
    import pyarrow

OBJECTS = "objects"
"""Folder of the objects' directories."""
PARQUET, TABLE, PAGE = "summary.parquet", "summary.csv", "index.html"
BLOCK = 500
"""Rows held at once."""
FORMULA_STARTS = frozenset("=+-@\t\r\n＝＋－＠")
"""Also full-width, which some spreadsheets take for the same."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
KINDS = {
    "id": "string", "directory": "string", "scene": "string", "recording": "string", "task": "string",
    "status": "string", "reason": "string", "result": "string", "seed": "int64", "seconds": "float64",
    "rows": "int64", "converged": "bool", "chi2": "float64", "dof": "int64", "rms_mag": "float64",
    "verdict": "string", "global_p": "float64", "warnings": "int64",
}  # fmt: skip
"""Column: its type, of those that hold one value; ``named`` and ``parameters`` hold lists."""


def write_summary(
    jobs: Iterable[Job],
    held: Mapping[str, str],
    directory: OutputDirectory,
    name: str,
    facts: Mapping[str, Any],
) -> None:
    """summary.parquet, summary.csv (without lists), index.html; ``held`` says of directories why their
    records are not this run's.
    """
    import pyarrow.parquet

    def fill(parquet: Path) -> None:
        schema = arrow_schema()
        with pyarrow.parquet.ParquetWriter(parquet, schema) as writer:
            for block in _blocks(_rows(jobs, held, directory.path / OBJECTS)):
                writer.write_table(pyarrow.Table.from_pylist(block, schema=schema))

    directory.write(PARQUET, fill)
    table = directory.path / PARQUET
    directory.write(TABLE, lambda path: write_csv(path, table))
    directory.write(PAGE, lambda path: _write_page(path, table, name, facts))


def summary_rows(table: Path, columns: list[str] | None = None) -> Iterator[dict[str, Any]]:
    """The rows of a summary, without holding it."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(table) as file:
        for batch in file.iter_batches(batch_size=BLOCK, columns=columns):
            yield from batch.to_pylist()


def arrow_schema() -> pyarrow.Schema:
    import pyarrow as pa

    parameter = pa.struct(
        [("name", pa.string())]
        + [(key, pa.float64()) for key in ("median", "sd", "q05", "q95")]
        + [("unit", pa.string()), ("informed", pa.bool_())]
    )
    lists = [("named", pa.list_(pa.string())), ("parameters", pa.list_(parameter))]
    return pa.schema([(name, pa.type_for_alias(kind)) for name, kind in KINDS.items()] + lists)


def _rows(jobs: Iterable[Job], held: Mapping[str, str], objects: Path) -> Iterator[dict[str, Any]]:
    for job in jobs:
        record = None if job.directory in held else read_record(objects / job.directory)
        record = record or {"reason": held.get(job.directory, "no record of it")}
        yield {
            "id": job.name,
            "directory": f"{OBJECTS}/{job.directory}",
            "scene": str(job.scene),
            "recording": str(job.recording),
            "task": job.task,
            "status": record.get("status", "failed"),
            "reason": record.get("reason"),
            "seed": job.seed,
            "seconds": record.get("seconds"),
            **record.get("outcome", {}),
        }


def _blocks(rows: Iterator[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    while block := list(islice(rows, BLOCK)):
        yield block


def write_csv(path: Path, table: Path) -> None:
    """The rows of a summary without lists, none of whose cells a spreadsheet takes for a formula."""
    columns = list(KINDS)
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(
            {name: plain_cell(value) for name, value in row.items()} for row in summary_rows(table, columns)
        )


def plain_cell(value: Any) -> Any:
    """``value`` as a spreadsheet shows it and does not run it: text that would be a formula gets an apostrophe
    before it (OWASP, CSV injection). Numbers are left, also those that are text.
    """
    if isinstance(value, str) and value[:1] in FORMULA_STARTS and not NUMBER.fullmatch(value):
        return f"'{value}"
    return value


def _write_page(path: Path, table: Path, name: str, facts: Mapping[str, Any]) -> None:
    from torchlc.report.page import environment
    from torchlc.version import __version__

    template = environment().get_template("campaign.html")
    columns = ["id", "directory", "task", "status", "reason", "result", "chi2", "dof", "rms_mag", "global_p", "seconds"]  # fmt: skip
    rows = ([row[column] for column in columns] for row in _linked(summary_rows(table, columns)))
    stream = template.stream(
        version=__version__, title=f"{name}: campaign", name=name, facts=facts, columns=columns, rows=rows
    )
    stream.enable_buffering(BLOCK)
    with path.open("w", encoding="utf-8") as file:
        file.writelines(stream)


def _linked(rows: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """``directory`` as a link of a page has it: its own percent signs are written as such."""
    for row in rows:
        yield {**row, "directory": quote(row["directory"])}
