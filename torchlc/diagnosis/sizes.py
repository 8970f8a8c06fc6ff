"""Sizes that the scene may have wrong: the rival of an effect that adds area."""

from __future__ import annotations

from typing import Any

import torch

from torchlc.diagnosis.evidence import Scorer
from torchlc.diagnosis.refit import Hypothesis, Refit, Workbench, refit
from torchlc.diagnosis.search import Found, judged
from torchlc.effects import effect_class
from torchlc.files.numbers import Free
from torchlc.lightcurve.assembly import assemble
from torchlc.readers import Recording
from torchlc.scene import Scene

SIZES = ("size", "radius", "length")
SIGMA = 0.1
"""What is believed of a size that the scene gives as certain: this share of it."""


def resized(
    scene: Scene, recording: Recording, scorer: Scorer, baseline: Refit, final: Refit, seed: int
) -> Found | None:
    """The final model with every size of the scene's components free in place of the area that effects add; None where the
    scene has no size to free."""
    freed = with_free_sizes(scene)
    if freed is None:
        return None
    kept = tuple(entry for entry in final.hypothesis.added if not effect_class(entry).adds_area)
    bench, hypothesis = Workbench(assemble(freed, recording), seed), Hypothesis(kept)
    starts = torch.cat([bench.start(hypothesis, one.theta[None], one.names) for one in (final, baseline)])
    return judged(refit(bench.likelihood(hypothesis), hypothesis, starts), scorer)


def with_free_sizes(scene: Scene) -> Scene | None:
    """The scene with a normal prior about each size that it gives as certain; None where there is none."""
    components = [
        part.model_copy(update={name: _freed(getattr(part, name)) for name in SIZES if hasattr(part, name)})
        for part in scene.components
    ]
    if components == list(scene.components):
        return None
    return scene.model_copy(update={"components": components})


def _freed(size: Any) -> Any:
    if isinstance(size, tuple):
        return tuple(_freed(one) for one in size)
    if isinstance(size, Free):
        return size
    return Free(value=size, low=0.5 * size, high=2.0 * size, sigma=SIGMA * size, prior="normal")
