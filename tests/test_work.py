"""What a calculation takes is counted: alike on every machine, and near what a clock says."""

from __future__ import annotations

import time

import pytest
import torch

from torchlc.tensors.work import Work


def test_operations_and_elements_are_counted_and_views_are_not() -> None:
    rows = torch.ones(100, 7)
    with Work() as work:
        total = (rows.T[2:] * 2.0).sum()
        shape = rows.shape
    assert float(total) == 2.0 * (shape[1] - 2) * shape[0]
    assert (work.operations, work.elements) == (2, 2 * 500)
    with Work() as listed:
        torch.cat([rows, rows])
    assert (listed.operations, listed.elements) == (1, 1400)


@pytest.mark.parametrize(("size", "times"), [(10, 400), (100_000, 20)])
def test_seconds_are_near_those_of_a_clock(size: int, times: int) -> None:
    """Of arithmetic and functions together, on any machine of our time: few elements and many."""
    values = torch.linspace(0.1, 1.0, size, dtype=torch.float64)

    def calculation() -> None:
        for _ in range(times):
            torch.exp(torch.sin(values) * values - values)

    with Work() as work:
        calculation()
    began = time.process_time()
    calculation()
    # eight to a batch, operations on few elements are an eighth of what each takes alone
    taken = (time.process_time() - began) / (8 if size < 1000 else 1)
    assert 0.1 < work.seconds / taken < 10
