"""A diagnosis whose time ends, that is interrupted, or that goes on from what it had finished."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import torchlc
from torchlc.diagnosis.clock import Clock
from torchlc.diagnosis.engine import Search
from torchlc.diagnosis.hypotheses import Workbench
from torchlc.diagnosis.run import diagnose
from torchlc.files.steps import Steps
from torchlc.readers import load_recording


def test_a_budget_ends_among_the_effects_that_promise_least(demo, tmp_path: Path) -> None:
    """Panels 1.5 deg off the Sun: refits of single effects come in the order of what their signatures promise, whether they turn
    the geometry or not. A search that is cut short has then asked the likeliest."""
    scene, recording = demo
    model = scene.model.model_copy(
        update={
            "effects": [*scene.model.effects, "panel_offset"],
            "parameters": {**scene.model.parameters, "panel_offset.deg": 1.5},
        }
    )
    hidden = torchlc.simulate(scene.model_copy(update={"model": model}), recording, noise=0.01)
    search = Search(
        Workbench(scene, load_recording(hidden.write(tmp_path / "hidden.ecsv"), scene)), Clock(None), 0
    )
    search.null()
    search.singles(["zero_point_drift", "saturation", "background", "panel_offset"], lambda _: 0.0)
    refitted = [one.added[0] for one in search.visited if len(one.added) == 1]
    judged = [one.added[0] for one in search.linear]  # of too little promise beside the first to be refitted
    assert refitted[0] == "panel_offset" and len(refitted) + len(judged) > 2
    promised = [search.probes[entry].score for entry in (*refitted, *judged)]
    assert promised == sorted(promised, reverse=True)


@pytest.mark.long
def test_a_search_goes_on_from_what_it_had_finished(demo, tmp_path: Path) -> None:
    """Of all steps none is done again, and of half of them, as a kill leaves them, the other half is; the answer is that of
    the run left alone, to the rounding of a refit that is read instead of made. Steps of another search are not known."""
    file = tmp_path / "search.pt"

    def run(steps: Steps):
        found = diagnose(*demo, effects=["panel_offset", "saturation"], steps=steps).to_json()
        return found["verdict"], found["named"], found["probabilities"], found["materials"]

    alone = run(Steps("one", file, lambda fill: fill(file)))
    stored = torch.load(file, weights_only=True)
    names = list(stored["steps"])
    assert len(names) > 6
    made: list[str] = []

    class Watched(Steps):
        def of(self, name, kind, make):
            return super().of(name, kind, lambda: (made.append(name), make())[1])

    assert_close(run(Watched("one", file)), alone)
    assert not made
    stored["steps"] = {name: stored["steps"][name] for name in names[: len(names) // 2]}
    torch.save(stored, file)
    assert_close(run(Watched("one", file)), alone)
    assert made == names[len(names) // 2 :]
    assert not Steps("another", file).resumed


def assert_close(found, expected) -> None:
    """Equal, numbers to a millionth."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        found, expected = list(found.values()), list(expected.values())
    if isinstance(expected, (list, tuple)):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_close(one, other)
    elif isinstance(expected, float):
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)
    else:
        assert found == expected


def test_an_interruption_gives_the_verdict_so_far(demo) -> None:
    """Ctrl-C while candidates are refitted: a verdict, with what was examined and what was not."""

    def stop(text: str, _: float) -> None:
        if text.startswith("leads"):
            raise KeyboardInterrupt

    found = diagnose(*demo, effects=["zero_point_drift", "background", "saturation"], progress=stop)
    assert found.verdict in ("adequate", "noise_model")
    refitted = {
        row["effect"] for row in found.to_json()["candidates"] if row["delta_log_evidence"] is not None
    }
    late = {row["effect"] for row in found.to_json()["unexamined"]}
    assert (
        late and late | refitted >= {"zero_point_drift", "background", "saturation"} and not late & refitted
    )
    assert any(text.startswith("interrupted") for text in found.warnings)


def test_a_budget_that_is_spent_says_what_was_not_examined(demo) -> None:
    """Less than the null takes: every candidate is told, and none is hidden behind a verdict."""
    found = diagnose(*demo, budget=1e-3, effects=["panel_offset", "background"])
    content = found.to_json()
    assert {row["effect"] for row in content["unexamined"]} == {"panel_offset", "background"}
    told = [text for text in found.warnings if "not examined" in text]
    assert len(told) == 1 and all(name in told[0] for name in ("panel_offset", "background"))
    assert any(text.startswith("the search was ended after") for text in found.warnings)
    assert any("Probabilities: " in text for text in found.lines())
