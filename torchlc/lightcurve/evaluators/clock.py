"""A mesh that a clock's offset alone moves: tables are smooth in the offset."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.evaluators.contract import Evaluator, cubic
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import Tables, phase_angle_of, sky_of
from torchlc.stages.effect import Effect
from torchlc.stages.light import Brightness
from torchlc.tensors.autodiff_state import apart

NODES = 9
"""Offsets about the one that is asked for: four steps either way before a node is new."""
CLOCK_TURN_DEG = 3.0
MOST_TRACED_PAIRS = 1_000_000
"""Facet-row pairs of a mesh beyond which a clock offset is interpolated; 3 deg between nodes keep the cubic
within 2e-4."""


class ClockTables(Evaluator):
    """Tables at nine offsets of the clock and cubics between them; 2e-4 mag at most. Positions are those at the very
    offset."""

    way = "clocked"
    own_error_mag = 2e-4

    def __init__(
        self,
        pipeline: Pipeline,
        clock: Effect,
        kept: dict[bool, tuple[list[Tables], float]] | None = None,
    ) -> None:
        super().__init__(pipeline)
        self.clock = clock
        self.kept: dict[bool, tuple[list[Tables], float]] = {} if kept is None else kept

    @classmethod
    def clock_of(cls, assembly: Assembly) -> Effect | None:
        """The clock whose offset alone moves a mesh without lobes; None if it is otherwise."""
        plain = all(model.additive for model in assembly.models.values()) and not assembly.stage("scatter")
        if not plain or assembly.traced_pairs <= MOST_TRACED_PAIRS:
            return None
        movers = set(map(assembly.effect_of, assembly.moving))
        if len(movers) != 1:
            return None
        (clock,) = movers
        return clock if clock is not None and clock.shifts_clock else None

    @property
    def clock_name(self) -> str:
        return self.clock.full_name(self.clock.quantities[0].name)

    @property
    def warnings(self) -> tuple[str, ...]:
        reach = NODES // 2 * self.step
        return (
            f"{self.clock.name}: light is interpolated between offsets of up to {reach:.3g} s either way; beyond, it is "
            f"that at {reach:.3g} s",
        )

    def light(self, theta: Tensor, shares: bool) -> Brightness:
        flat = theta[None] if theta.ndim == 1 else theta.flatten(0, -2)
        return self.joined([self._interpolated(flat, shares)], theta)

    def _interpolated(self, flat: Tensor, shares: bool) -> Brightness:
        """Rows of theta (B, P) whose clock offsets differ, from tables at NODES offsets CLOCK_TURN_DEG of a
        turn apart, by cubics through four of them; offsets beyond the outermost are taken there. Positions are
        those at the very offset."""
        nodes, step = self.nodes(shares or self.assembly.needs_shares)
        half = NODES // 2
        columns = nodes[0].columns
        row = torch.arange(self.assembly.T) if columns is None else columns.row
        values = self.values(flat)
        position = self.assembly.rows(values, self.clock_name, row) / step
        position = position.expand(len(flat), len(row)).clamp(-half, half) + half
        first_node = (position.detach().floor().long() - 1).clamp(0, NODES - 4)
        weights = cubic(position - first_node)
        column = torch.arange(len(row))
        view = self.pipeline.places(values, len(flat))
        phase_angle = phase_angle_of(view, columns)
        surfaces = []
        for number, surface in enumerate(nodes[0].surfaces):
            table = {}
            for name in surface.table:
                stack = torch.stack([node.surfaces[number].table[name] for node in nodes])
                table[name] = sum(
                    (weights[k] * stack[first_node + k, column] for k in range(4)),
                    start=torch.zeros_like(position),
                )
            surfaces.append(replace(surface, table=table, phase_angle=phase_angle))
        sky = sky_of(view, columns, self.assembly.instants, fixed=False)
        return self.shone(Tables(tuple(surfaces), (), sky, columns), flat, shares)

    @cached_property
    def step(self) -> float:
        """Seconds in which the body makes CLOCK_TURN_DEG of a turn, at the median row."""
        with apart():
            values = self.assembly.attitude_values(self.values(self.parameters.start()))
            state = [self.assembly.track.at(zero, zero, 0.0) for zero in (0.0, 1.0)]
            first, second = (self.assembly.attitude.rotation(moment, values) for moment in state)
            turn = torch.linalg.matrix_norm(first - second).median() / math.sqrt(2)
            return float(math.radians(CLOCK_TURN_DEG) / turn.clamp(min=1e-12))

    def nodes(self, detail: bool) -> tuple[list[Tables], float]:
        """Tables at NODES offsets of the clock about none, and the step between them, s."""
        if detail not in self.kept:
            with apart():
                values = self.values(self.parameters.start())
                clock = self.clock_name
                clocks = [name for name in values if name == clock or name.startswith(f"{clock}[")]
                made = []
                for k in range(-(NODES // 2), NODES // 2 + 1):
                    offset = k * self.step
                    moved = {**values, **{name: torch.full_like(values[name], offset) for name in clocks}}
                    made.append(self.pipeline.make_tables(self.pipeline.view(moved), detail, compact=True))
                self.kept[detail] = made, self.step
        return self.kept[detail]
