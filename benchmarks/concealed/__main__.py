"""Conceal causes, ask every method, score them:

    python -m benchmarks.concealed --seed S --cases N -o DIR [--classes one,two] [--methods diagnosis,chi_square]

A stopped run goes on where it was. DIR holds a folder for each case and ``summary.json``; ``--publish FILE`` writes the
summary elsewhere too. Both are written anew after each case, so that a run that is stopped leaves the scores of what it
has done. A method whose library is not installed is left out, and this is said, in the summary too; ``pip install -r
benchmarks/concealed/requirements.txt`` installs all of them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import platform
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.concealed.answer import absent, method, method_names
from benchmarks.concealed.asking import Job, answer_of, results, run
from benchmarks.concealed.scores import overview, summary

CLASSES = ("none", "one", "two", "three", "unlisted", "other law", "nominal scene")
GENERATORS = {"reference": None, "tracer": "mitsuba"}
"""By name, the module beside numpy that it needs; its cases come from ``<name>_cases``."""
TRACED = ("none", "one", "two", "unlisted", "nominal scene")
"""Classes that the path tracer makes as well."""


def jobs(
    seed: int,
    cases: int,
    classes: Sequence[str],
    generators: Sequence[str],
    methods: Sequence[str],
    out: Path,
):
    """Classes in turn, generators in turn within each."""
    made = []
    for index in range(cases):
        kind, number = classes[index % len(classes)], index // len(classes)
        able = [one for one in generators if one != "tracer" or kind in TRACED]
        if not able:
            raise SystemExit(f"no generator of {', '.join(generators)} makes the class {kind!r}")
        generator = able[number % len(able)]
        folder = out / "cases" / f"{generator}-{kind.replace(' ', '-')}-{number}"
        made.append(Job(kind, number, generator, seed, folder, tuple(methods)))
    return made


def told(options: argparse.Namespace) -> dict[str, Any]:
    """The summary of all that the folder holds, of this call and of earlier ones, with what it was made by."""
    folders = [one for one in sorted((options.out / "cases").iterdir()) if results(one)]
    answers = [answer_of(one) for one in folders]
    rows = [row for one in folders for row in results(one)]
    good = [row for row in rows if "failed" not in row]
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    ).stdout.strip()
    return {
        "seed": options.seed,
        "commit": commit,
        "machine": f"{platform.machine()}, {multiprocessing.cpu_count()} cores",
        "cases": len(folders),
        "classes": {kind: sum(one["class"] == kind for one in answers) for kind in CLASSES},
        "generators": {name: sum(one["generator"] == name for one in answers) for name in GENERATORS},
        "failed": len(rows) - len(good),
        "titles": {row["method"]: method(row["method"]).TITLE for row in good},
        "left_out": {
            method(name).TITLE: absent(name)
            for name in method_names()
            if absent(name) and not any(row["method"] == name for row in good)
        },
        "scores": summary(good),
        "overview": overview(
            good, "diagnosis", f"python -m benchmarks.concealed --seed {options.seed} -o DIR"
        ),
    }


def claim(folder: Path, seed: int) -> None:
    """Marks a folder as that of a seed; ends where it is another's."""
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / "seed.txt"
    if mark.exists() and mark.read_text(encoding="utf-8").strip() != str(seed):
        raise SystemExit(
            f"{folder} holds cases of seed {mark.read_text().strip()}, not {seed}; give another folder"
        )
    mark.write_text(f"{seed}\n", encoding="utf-8")


def _chosen(text: str | None, known: Sequence[str], what: str) -> list[str]:
    names = list(known) if text is None else [one.strip() for one in text.split(",")]
    for one in names:
        if one not in known:
            raise SystemExit(f"--{what}: {one!r}; expected some of {', '.join(known)}")
    return names


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--classes", help=f"some of {', '.join(CLASSES)}")
    parser.add_argument("--methods", help=f"some of {', '.join(method_names())}")
    parser.add_argument("--generators", help=f"some of {', '.join(GENERATORS)}")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--publish", type=Path, help="the summary's further place")
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.processes < 1:
        raise SystemExit("--cases and --processes: at least 1")
    methods = _chosen(options.methods, method_names(), "methods")
    generators = _chosen(options.generators, list(GENERATORS), "generators")
    for name in [one for one in methods if absent(one)]:
        print(f"{name} is left out: {', '.join(absent(name))} is not installed", file=sys.stderr)
        methods.remove(name)
    for name in [one for one in generators if GENERATORS[one] and not find_spec(str(GENERATORS[one]))]:
        print(f"cases of {name} are left out: {GENERATORS[name]} is not installed", file=sys.stderr)
        generators.remove(name)
    wanted = jobs(
        options.seed,
        options.cases,
        _chosen(options.classes, CLASSES, "classes"),
        generators,
        methods,
        options.out,
    )
    claim(options.out, options.seed)
    if options.processes == 1:
        for job in wanted:
            publish(run(job), options)
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(options.processes, mp_context=context) as pool:
            for done in as_completed([pool.submit(run, job) for job in wanted]):
                publish(done.result(), options)


def publish(line: str, options: argparse.Namespace) -> None:
    """Prints what is said of a case, and writes the summary of all that are done; never half of it."""
    print(line, flush=True)
    content = json.dumps(told(options), indent=1) + "\n"
    for path in (options.out / "summary.json", options.publish):
        if path is not None:
            whole = path.with_name(path.name + ".new")
            whole.write_text(content, encoding="utf-8")
            whole.replace(path)


if __name__ == "__main__":
    main()
