"""One case put to the methods: made if it is not there, asked of whoever has not answered.

Apart from the command, for processes that a run starts have to find it by its name, and those of a command have none.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from benchmarks.concealed.answer import method
from benchmarks.concealed.case import Case
from benchmarks.concealed.scores import judged


@dataclass(frozen=True)
class Job:
    """One case: its class, number and generator, and whom to ask."""

    kind: str
    number: int
    generator: str
    seed: int
    folder: Path
    methods: tuple[str, ...]


def run(job: Job) -> str:
    """Makes the case if it is not there, asks the methods that have not answered; returns a line about it."""
    torch.set_num_threads(1)
    began = time.process_time()
    if not (job.folder / "answer.json").exists() or "class" not in answer_of(job.folder):
        import_module(f"benchmarks.concealed.{job.generator}_cases").make(
            job.kind, job.number, job.seed, job.folder
        )
    made = time.process_time() - began
    done = {(row["method"], row["without"]) for row in results(job.folder)}
    case, shared = Case(job.folder), {}
    for name in job.methods:
        for without in (False, True) if case.kind == "one" and method(name).NAMES else (False,):
            if (name, without) not in done:
                row = asked(case, name, without, job.seed, shared)
                with (job.folder / "results.jsonl").open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    return f"{job.folder.name}: made in {made:.0f} s, asked in {time.process_time() - began - made:.0f} s"


def asked(case: Case, name: str, without: bool, seed: int, shared: dict[str, float]) -> dict[str, Any]:
    """One method's answer with its score and its CPU seconds, those of what it shares with others included."""
    one = method(name)
    row = {"case": case.folder.name, "class": case.kind, "method": name, "without": without}
    for part in one.SHARES:
        if part not in shared:
            began = time.process_time()
            _ = case.nominal if part == "nominal" else case.menu()
            shared[part] = time.process_time() - began
    began = time.process_time()
    names = set().union(*case.accepted) if without else set()
    try:
        found = judged(case, one.examine(case, names, seed))
    except (
        ArithmeticError,
        AssertionError,
        ValueError,
        RuntimeError,
    ) as problem:  # what a method's numbers may end in
        print(f"{case.folder.name}: {name} failed: {problem}", file=sys.stderr)
        return {**row, "failed": str(problem)}
    seconds = time.process_time() - began + sum(shared[part] for part in one.SHARES)
    return {**row, **found, "seconds": seconds}


def results(folder: Path) -> list[dict[str, Any]]:
    """Answers that a case has; a last line cut short by a kill is left out."""
    path = folder / "results.jsonl"
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def answer_of(folder: Path) -> dict[str, Any]:
    """What is concealed in a case."""
    return json.loads((folder / "answer.json").read_text(encoding="utf-8"))
