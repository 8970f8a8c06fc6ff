"""The page of a campaign of many objects, in Chromium: there at once, and sorted and filtered while one watches."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from tests.chromium import PROGRAM, Page
from torchlc.campaigns.manifest import Job
from torchlc.campaigns.objects import RECORD, SCHEMA
from torchlc.campaigns.summary import OBJECTS, PAGE, PARQUET, TABLE, write_summary
from torchlc.files.writing import OutputDirectory

COUNT = 5000
AT_ONCE_S = 1.0
"""What a person does not wait for."""


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("campaign") / "out"
    jobs = [
        Job(f"object {k}", Path("scene.toml"), Path(f"night {k}.csv"), "diagnose", k) for k in range(COUNT)
    ]
    for k, job in enumerate(jobs):
        folder = out / OBJECTS / job.directory
        folder.mkdir(parents=True)
        outcome = {"rows": 300, "chi2": 300.0 + k % 77, "dof": 290, "rms_mag": 0.02, "result": "adequate"}
        record = {"schema": SCHEMA, "status": "done", "seconds": 20.0 + k % 13, "outcome": outcome}
        (folder / RECORD).write_text(json.dumps(record))
    facts = {
        "objects": COUNT,
        "done": COUNT,
        "skipped": 0,
        "failed": 0,
        "manifest": "nights.csv",
        "seed": 0,
        "torchlc": "x",
        "command": "",
    }
    with OutputDirectory(out, (PARQUET, TABLE, PAGE)) as directory:
        write_summary(jobs, {}, directory, "nights", facts)
    return out / PAGE


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
def test_five_thousand_objects_are_sorted_and_filtered_at_once(page: Path) -> None:
    """The table shows some hundred rows at a time, and all of them count."""

    def timed(script: str) -> float:
        began = time.monotonic()
        tab.run(script)
        tab.settle()
        return time.monotonic() - began

    first = "document.querySelector('tbody tr').cells[0].textContent"
    with Page(page, width=1300) as tab:
        tab.settle()
        loaded = tab.run("performance.timing.domContentLoadedEventEnd - performance.timing.navigationStart")
        assert loaded < 1000 * AT_ONCE_S
        assert "5000 of 5000 objects" in tab.run("document.getElementById('count').textContent")
        assert tab.run("document.querySelectorAll('tbody tr').length") < 500
        assert timed("document.querySelector('[data-key=id] button').click()") < AT_ONCE_S
        assert tab.run(first) == "object 0"
        assert timed("document.querySelector('[data-key=id] button').click()") < AT_ONCE_S
        assert tab.run(first) == f"object {COUNT - 1}"
        typed = "(f => {{ f.value = '{}'; f.dispatchEvent(new Event('input')); }})(document.querySelector('#filter'))"
        assert timed(typed.format("object 49")) < AT_ONCE_S
        assert tab.run("document.getElementById('count').textContent").startswith("111 of 5000")
        assert tab.problems == []
