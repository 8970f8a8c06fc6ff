"""The benchmark of concealed causes: its scores against scipy and closed forms, its tracer against Lambert's law, its command."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from benchmarks.concealed.__main__ import main
from benchmarks.concealed.answer import absent, method, method_names
from benchmarks.concealed.asking import run
from benchmarks.concealed.case import Case
from benchmarks.concealed.linear import conditional
from benchmarks.concealed.methods.distortion_snr import statistics, trained
from benchmarks.concealed.scores import (
    auc,
    calibration_error,
    found_share,
    in_families,
    overlap,
    overview,
    reliability,
)

ROOT = Path(__file__).parents[1]


def test_auc_is_mann_and_whitneys() -> None:
    rng = np.random.default_rng(1)
    positive, negative = rng.integers(0, 9, 40) + 2.0, rng.integers(0, 9, 60) + 0.0  # with many ties
    expected = stats.mannwhitneyu(positive, negative).statistic / (40 * 60)
    assert auc(positive, negative) == pytest.approx(expected, abs=1e-12)
    assert auc([1.0], []) is None


def test_auc_agrees_with_scikit_learn() -> None:
    metrics = pytest.importorskip("sklearn.metrics", reason="scikit-learn is not installed")
    rng = np.random.default_rng(2)
    positive, negative = rng.normal(1, 1, 50), rng.normal(0, 1, 80)
    expected = metrics.roc_auc_score(np.r_[np.ones(50), np.zeros(80)], np.r_[positive, negative])
    assert auc(positive, negative) == pytest.approx(expected, abs=1e-12)


def test_overlap_counts_rows() -> None:
    rows = np.arange(10)
    assert overlap((rows >= 2) & (rows < 6), (rows >= 4) & (rows < 9)) == pytest.approx(2 / 7)
    assert overlap(rows < 0, rows < 5) == 0
    assert overlap(None, rows < 5) is None
    assert overlap(rows < 5, rows < 0) is None


def test_calibration_error_of_known_shares() -> None:
    """Two bins: 0.85 of which 60 % are right, 0.25 of which half are: (10 * 0.25 + 4 * 0.25) / 14."""
    confidence = [0.85] * 10 + [0.25] * 4
    right = [True] * 6 + [False] * 4 + [True, False] * 2
    assert calibration_error(confidence, right) == pytest.approx(0.25)
    assert [one["count"] for one in reliability(confidence, right)] == [4, 10]
    assert calibration_error([1.0, 1.0], [True, True]) == 0


def test_names_and_families() -> None:
    accepted = [frozenset({"a", "b"}), frozenset({"c"})]
    assert in_families([("x", "a"), ("b", "y")], accepted)
    assert not in_families([("x",), ("b",)], accepted)
    assert not in_families([], accepted)
    assert found_share([("a",), ("d",), ("b",)], [frozenset({"a", "b"})]) == 0.5
    assert found_share([("c",)], accepted) == 1


def test_overview_counts_what_was_said() -> None:
    said = {"class": "one", "method": "m", "without": False, "confidence": 0.9}
    rows = [
        {**said, "verdict": "named", "sets": [["a", "b"]], "right": True},
        {**said, "verdict": "none", "sets": [["c"]], "right": False, "confidence": 0.5},
        {**said, "verdict": "named", "sets": [["a"]], "right": True, "without": True},
        {**said, "verdict": "named", "sets": [["a"]], "right": True, "method": "other"},
    ]
    (line,) = overview(rows, "m", "command")
    assert line["named"] == "a + b (1), none (1)"
    assert line["right"] == "1 of 2"
    assert line["probability"] == pytest.approx(0.7)


def test_density_of_unseen_rows() -> None:
    """p(asked | known) = p(both) / p(known), by torch's normal distribution."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((7, 7))
    covariance, mean, u = root @ root.T + np.eye(7), rng.standard_normal(7), rng.standard_normal(7)
    known, asked = np.array([0, 2, 3, 6]), np.array([1, 4, 5])

    def log_prob(rows: np.ndarray) -> float:
        law = torch.distributions.MultivariateNormal(
            torch.tensor(mean[rows]), torch.tensor(covariance[np.ix_(rows, rows)])
        )
        return float(law.log_prob(torch.tensor(u[rows])))

    expected = log_prob(np.r_[known, asked]) - log_prob(known)
    assert conditional(u, mean, covariance, known, asked) == pytest.approx(expected, abs=1e-10)


def test_localised_statistics_are_matched_filters() -> None:
    """In white noise t_i is chi-square of one degree of freedom, and a distortion of amplitude a adds a^2 to its mean; of 1000
    draws the first mean has a standard error of sqrt(2/1000) = 0.045, the second of sqrt(66/1000) = 0.26; 3.4 of each are let."""
    rng = np.random.default_rng(4)
    patterns = np.eye(30)[:5]
    weights = trained(patterns, rng.standard_normal((20000, 30)))
    null, noise = rng.standard_normal((5000, 30)), rng.standard_normal((1000, 30))
    plain, shifted = (statistics(weights, null, rows)[1][:, 0] for rows in (noise, noise + 4 * patterns[0]))
    assert plain.mean() == pytest.approx(1.0, abs=0.15)
    assert shifted.mean() == pytest.approx(17.0, abs=0.9)
    assert stats.kstest(plain, stats.chi2(1).cdf).pvalue > 0.01


def test_a_traced_plate_obeys_lamberts_law() -> None:
    """albedo / pi area cos cos; 83,000 paths with every hit of the same radiance leave the outline's 0.3 %."""
    pytest.importorskip(
        "mitsuba", reason="mitsuba is not installed (pip install -r benchmarks/concealed/requirements.txt)"
    )
    import mitsuba

    from benchmarks.concealed.tracer_cases import _box, _bsdf, rendered

    mitsuba.set_variant("scalar_rgb")
    plate = _box(np.zeros(3), np.array([0.7, 0.4, 1.0]), np.eye(3), _bsdf({"albedo": 0.6}), "rectangle")
    sun, observer = math.radians(40.0), math.radians(25.0)
    directions = [np.array([math.sin(a), 0.0, math.cos(a)]) for a in (sun, -observer)]
    found = rendered([plate], [(directions[0], 1.0)], directions[1], seed=1)
    expected = 0.6 / math.pi * 1.4 * 0.8 * math.cos(sun) * math.cos(observer)
    assert found == pytest.approx(expected, rel=0.01)


def test_the_pit_is_a_closed_body() -> None:
    """Its volume by the divergence theorem is the cube's less the pit's, its area the cube's and the pit's walls'."""
    from benchmarks.concealed.tracer_cases import FLOOR, OPENING, pit

    lines = [line.split() for line in pit().splitlines()]
    points = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    corners = points[np.array([line[1:] for line in lines if line[0] == "f"], dtype=int) - 1]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side, deep = 2 * OPENING, 1 - FLOOR
    assert (corners[:, 0] * crosses).sum() / 6 == pytest.approx(8 - side**2 * deep, abs=1e-6)
    assert np.linalg.norm(crosses, axis=1).sum() / 2 == pytest.approx(24 + 4 * side * deep, abs=1e-6)


@pytest.mark.long
def test_the_command_makes_asks_and_scores(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two traced cases: nothing missing is called none, a second lamp is seen; a second run asks no one again."""
    pytest.importorskip(
        "mitsuba", reason="mitsuba is not installed (pip install -r benchmarks/concealed/requirements.txt)"
    )
    call = ["--seed", "5", "--cases", "2", "--classes", "none,unlisted", "--generators", "tracer", "--processes", "1",
            "--methods", "chi_square,matched_filter,sbi_mmd", "-o", str(tmp_path)]  # fmt: skip
    main(call)
    told = capsys.readouterr()
    assert ("sbi_mmd is left out" in told.err) == (importlib.util.find_spec("sbi") is None)
    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["cases"] == 2
    scores = content["scores"]["chi_square"]["all"]
    assert scores["auc"] == 1.0
    assert scores["detected"]["0.01"] == 1.0
    assert scores["false_alarms"]["0.01"] == 0.0
    assert scores["first"] is None  # it cannot name
    files = sorted(tmp_path.rglob("results.jsonl"))
    before = [file.read_text() for file in files]
    main(call)
    assert [file.read_text() for file in files] == before
    assert content["left_out"].get(method("sbi_flow").TITLE) == (absent("sbi_flow") or None)

    def stopped(job):
        if job.kind == "unlisted":
            raise KeyboardInterrupt
        return run(job)

    (tmp_path / "summary.json").unlink()
    monkeypatch.setattr("benchmarks.concealed.__main__.run", stopped)
    with pytest.raises(KeyboardInterrupt):
        main(call)
    assert json.loads((tmp_path / "summary.json").read_text())["scores"] == content["scores"]
    with pytest.raises(SystemExit, match="holds cases of seed 5"):
        main([*call[:1], "6", *call[2:]])

    case = Case(next(tmp_path.glob("cases/tracer-none-0")))
    p = [
        stats.chi2.sf((row**2).sum(), case.rows - case.nominal.posterior.size)
        for row in case.null_residuals(400, 1)
    ]
    assert stats.kstest(p, "uniform").pvalue > 0.01  # the refit takes one degree of freedom for each number


@pytest.mark.long
def test_the_command_shares_its_cases_among_processes(tmp_path: Path) -> None:
    """Started as a person starts it: each process has to find what it is to do."""
    call = ["--seed", "6", "--cases", "2", "--classes", "one,other law", "--generators", "reference", "--processes", "2",
            "--methods", "chi_square", "-o", str(tmp_path)]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.concealed", *call],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "summary.json").read_text())["scores"]["chi_square"]["all"]["cases"] == 2


def test_every_method_says_what_it_is() -> None:
    for name in method_names():
        one = method(name)
        assert one.TITLE and isinstance(one.NAMES, bool)
        assert set(one.SHARES) <= {"nominal", "menu"}
        assert absent(name) == [need for need in one.NEEDS if importlib.util.find_spec(need) is None]


@pytest.mark.parametrize("wrong", [["--classes", "four"], ["--methods", "tarot"], ["--cases", "0"]])
def test_bad_choices_are_told(tmp_path: Path, wrong: list[str]) -> None:
    with pytest.raises(SystemExit, match=r"expected some of|at least 1"):
        main(["--seed", "1", "-o", str(tmp_path), *wrong])
