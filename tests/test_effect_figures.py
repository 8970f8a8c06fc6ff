"""Every effect of the library has its figure, its size and its cost on the page of effects."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from torchlc.effects import registry

HERE = Path(__file__).parents[1] / "docs" / "effects"
LARGEST_BYTES = 60_000


@pytest.mark.parametrize("name", registry())
def test_an_effect_has_a_figure_and_a_size(name: str) -> None:
    figure = HERE / "figures" / f"{name}.png"
    assert figure.is_file(), f"run docs/effects/make_figures.py {name}"
    assert figure.stat().st_size < LARGEST_BYTES
    size = json.loads((HERE / "sizes.json").read_text(encoding="utf-8"))[name]
    assert size["rms_mag"] > 1e-4, "in a scene where it matters"
    assert size["cost"] > 0
