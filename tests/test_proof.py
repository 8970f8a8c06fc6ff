"""How much better one model predicts unseen rows than another, and how sure that is: by hand, and against many repetitions."""

from __future__ import annotations

import math

import pytest
import torch

from torchlc.diagnosis.proof import Unseen, difference


def blocks(*densities: float) -> Unseen:
    return Unseen(torch.tensor(densities, dtype=torch.float64), 0.1)


def test_a_difference_is_the_sum_over_blocks_with_the_error_of_a_sum() -> None:
    """Gains of 1, 2 and 6 scatter by sqrt(7) about their mean of 3, and a sum of three of them by sqrt(21)."""
    gain, error = difference(blocks(-10.0, -20.0, -30.0), blocks(-11.0, -22.0, -36.0))
    assert (gain, error) == pytest.approx((9.0, math.sqrt(21.0)))


def test_a_difference_turns_its_sign_with_the_models_and_knows_no_zero_of_density() -> None:
    """Another unit of the rows adds the same to the log density of a block under both."""
    first, second = blocks(3.0, -1.0, 4.0, 1.5), blocks(2.0, 0.5, -3.0, 1.0)
    gain, error = difference(first, second)
    assert difference(second, first) == (-gain, error)
    unit = torch.tensor([7.0, -40.0, 0.3, 12.0], dtype=torch.float64)
    shifted = (Unseen(model.log_density + unit, model.rms) for model in (first, second))
    assert difference(*shifted) == pytest.approx((gain, error))
    assert gain == pytest.approx(first.total - second.total)
    turned = (Unseen(model.log_density.flip(0), model.rms) for model in (first, second))
    assert difference(*turned) == pytest.approx((gain, error))


def test_blocks_that_gain_alike_leave_no_doubt_and_one_block_leaves_all() -> None:
    assert difference(blocks(5.0, 6.0, 7.0), blocks(3.0, 4.0, 5.0)) == (6.0, 0.0)
    assert difference(blocks(5.0), blocks(3.0)) == (2.0, math.inf)


def test_the_error_is_that_of_many_repetitions() -> None:
    """Five blocks that gain 3 on average and scatter by 2: sums of 4000 repetitions scatter by as much as the errors say."""
    generator = torch.Generator().manual_seed(1)
    each = 3.0 + 2.0 * torch.randn(4000, 5, generator=generator, dtype=torch.float64)
    repeated = [difference(Unseen(gains, 0.1), blocks(*[0.0] * 5)) for gains in each]
    gains, errors = torch.tensor(repeated, dtype=torch.float64).T
    # the scatter of 4000 numbers is known to 1 in 90
    assert float(errors.square().mean().sqrt()) == pytest.approx(float(gains.std()), rel=0.04)
