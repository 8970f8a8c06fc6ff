"""How the light of a model is worked out: one class each, of one interface, chosen once."""

from __future__ import annotations

from torchlc.lightcurve.evaluators.clock import ClockTables
from torchlc.lightcurve.evaluators.contract import Evaluator
from torchlc.lightcurve.evaluators.exact import ExactGeometry
from torchlc.lightcurve.evaluators.fixed import FixedTables
from torchlc.lightcurve.evaluators.learnt import LearntGeometry
from torchlc.lightcurve.evaluators.stepped import SteppedTables
from torchlc.lightcurve.pipeline import Pipeline

__all__ = ["Evaluator", "chosen"]


def chosen(pipeline: Pipeline, sibling: Evaluator | None = None) -> Evaluator:
    """The evaluator of a pipeline. ``sibling``, of a pipeline with the same geometry, lends its tables."""
    assembly = pipeline.assembly
    if assembly.learns_geometry:
        return LearntGeometry(pipeline)
    if not assembly.geometry_free:
        kept = sibling.kept if isinstance(sibling, FixedTables) else None
        return FixedTables(pipeline, kept)
    clock = ClockTables.clock_of(assembly)
    if clock is not None:
        kept = sibling.kept if isinstance(sibling, ClockTables) else None
        return ClockTables(pipeline, clock, kept)
    stepping = SteppedTables.effect_of(assembly)
    return ExactGeometry(pipeline) if stepping is None else SteppedTables(pipeline, stepping)
