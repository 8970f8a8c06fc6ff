"""What a campaign costs: an object of each kind, two workers against one, an empty task, memory of the client.

    python benchmarks/campaign.py [--objects 8] [--tasks 10000]

Objects are passes of a box-wing satellite, 120 rows each, four numbers free; workers are warm and have one
thread. Two workers are judged twice: by elapsed time, which needs a quiet machine, and by what of it they spent
in objects and not in waiting for one.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from distributed import Client

import torchlc
from torchlc.campaigns.cluster import connected, spread
from torchlc.campaigns.manifest import Job
from torchlc.campaigns.objects import run_object
from torchlc.terminal import quiet_libraries

ROWS = 120
KINDS = {
    "fit --steps 500": ("fit", {"steps": 500}),
    "diagnose --quick": ("diagnose", {"quick": True}),
}
SCENE = """
format = "torchlc-scene/1"
name = "box-wing"
[orbit]
tle = ["1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
       "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"]
[[stations]]
id = "station"
latitude = 37.536
longitude = 122.05
height = 110.0
[attitude]
mode = "nadir"
[[components]]
name = "body"
shape = "box"
size = [2.0, 1.7, 2.2]
centre = [0, 0, 0]
material = "body"
[[components]]
name = "panel"
shape = "plate"
size = [1.7, 6.6]
centre = [0, 5.75, 0]
u = [1, 0, 0]
v = [0, 1, 0]
tracks = { target = "sun", axis = [0, 1, 0] }
material = "panel"
[materials.body]
n = 50.0
r_spec = 0.2
r_diff = { value = 0.3, low = 0.0, high = 1.0 }
[materials.panel]
n = { value = 200.0, low = 1.0, high = 1e5, prior = "loguniform" }
r_spec = { value = 0.05, low = 0.0, high = 1.0 }
r_diff = { value = 0.05, low = 0.0, high = 1.0 }
[model]
effects = ["self_shadowing"]
[model.parameters]
band_sun_magnitude = -26.7
"""


def inputs(folder: Path, count: int) -> list[tuple[Path, Path]]:
    """The scene and ``count`` recordings of it, each with noise of its own."""
    scene = folder / "scene.toml"
    scene.write_text(SCENE)
    grid = {"start": "2020-10-17T14:00", "hours": 6.0, "cadence": 6 * 3600 / (ROWS - 1)}
    curves = (torchlc.simulate(scene, **grid, noise=0.02, seed=seed) for seed in range(count))
    return [(scene, curve.write(folder / f"{i}.ecsv")) for i, curve in enumerate(curves)]


@dataclass(frozen=True)
class Run:
    """Some objects of one kind on some workers: ``elapsed`` seconds in all; CPU and elapsed of each object."""

    workers: int
    elapsed: float
    cpu: list[float]
    wall: list[float]

    @property
    def busy(self) -> float:
        """Share of the workers' time that was spent in objects."""
        return sum(self.wall) / (self.workers * self.elapsed)


def clocked(root: Path, job: Job) -> str:
    """CPU and elapsed seconds of one object."""
    cpu, wall = time.process_time(), time.perf_counter()
    outcome = run_object(job, root / job.directory)
    assert outcome == "done", (job, outcome)
    return f"{time.process_time() - cpu} {time.perf_counter() - wall}"


def same(text: str) -> str:
    """A task that takes no time."""
    return text


def run_kind(client: Client, workers: int, kind: str, files: list[tuple[Path, Path]], root: Path) -> Run:
    task, options = KINDS[kind]
    jobs = [Job(f"{i}", *pair, task, i, options) for i, pair in enumerate(files)]
    began = time.perf_counter()
    told = [str(outcome).split() for _, outcome in spread(client, partial(clocked, root), jobs)]
    cpu, wall = ([float(number) for number in column] for column in zip(*told, strict=True))
    return Run(workers, time.perf_counter() - began, cpu, wall)


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def empty_tasks(client: Client, count: int) -> dict[str, float]:
    """What client and scheduler, which share this process, spend on tasks that do nothing."""
    before, early = time.process_time(), 0.0
    for done, _ in enumerate(spread(client, same, map(str, range(count))), start=1):
        if done == count // 10:
            early = resident_mib()
    return {
        "CPU milliseconds each, of client and scheduler": 1e3 * (time.process_time() - before) / count,
        f"MiB that they grew by from {count // 10} to {count}": resident_mib() - early,
    }


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("--objects", type=int, default=8)
    reader.add_argument("--tasks", type=int, default=10_000)
    given = reader.parse_args()
    with quiet_libraries(), tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = inputs(folder, given.objects)
        runs: dict[tuple[str, int], Run] = {}
        for workers in (1, 2):
            with connected(None, workers, 1) as client:
                for kind in KINDS:
                    run_kind(client, workers, kind, files[:workers], folder / f"warm {workers} {kind}")
                    root = folder / f"{workers} {kind}"
                    run = runs[kind, workers] = run_kind(client, workers, kind, files, root)
                    size = sum(file.stat().st_size for file in root.rglob("*") if file.is_file())
                    show(
                        f"{kind}, {workers} worker{'s' if workers > 1 else ''}",
                        {
                            "CPU seconds an object": statistics.median(run.cpu),
                            "MB an object on disk": size / len(files) / 1e6,
                            "elapsed seconds": run.elapsed,
                            "share of them in objects": run.busy,
                        },
                    )
                if workers == 1:
                    show("empty tasks", empty_tasks(client, given.tasks))
    for kind in KINDS:
        one, two = runs[kind, 1], runs[kind, 2]
        show(
            f"{kind}, two workers against one",
            {"elapsed": one.elapsed / two.elapsed, "time in objects": 2 * two.busy / one.busy},
        )


def show(title: str, found: dict[str, float]) -> None:
    print(title, *(f"  {name}: {value:.2f}" for name, value in found.items()), sep="\n", flush=True)


if __name__ == "__main__":
    main()
