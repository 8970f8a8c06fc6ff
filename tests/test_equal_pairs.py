"""Slots of facet pairs that have the same angles are counted once, with all of their weight."""

from __future__ import annotations

import torch

from torchlc.pairs.slots import EMPTY, deduplicated


def test_equal_pairs_of_a_row_are_one_with_their_weights_added() -> None:
    """12 slots of 40 rows with angles from a list of 5, some without weight. For each row a dictionary from angles to summed weights, made in
    plain Python, is what the slots hold; to 1e-14, as sums of up to 12 numbers below 1 go in another order."""
    generator = torch.Generator().manual_seed(3)
    slots, rows = 12, 40
    kinds = torch.randint(0, 5, (slots, rows), generator=generator)
    listed = torch.rand(len(EMPTY) - 1, 5, dtype=torch.float64, generator=generator)
    listed[0] = 0.5  # the first angle alone does not tell them apart
    weight = torch.rand(slots, rows, dtype=torch.float64, generator=generator)
    weight *= torch.rand(slots, rows, generator=generator) > 0.3
    *angles, merged = deduplicated((*(column[kinds] for column in listed), weight))
    for row in range(rows):
        expected: dict[tuple[float, ...], float] = {}
        for slot in range(slots):
            if weight[slot, row] > 0:
                key = tuple(listed[:, kinds[slot, row]].tolist())
                expected[key] = expected.get(key, 0.0) + float(weight[slot, row])
        held = [slot for slot in range(len(merged)) if merged[slot, row] > 0]
        made = {tuple(float(one[slot, row]) for one in angles): float(merged[slot, row]) for slot in held}
        assert made.keys() == expected.keys() and len(held) == len(expected)
        assert max(abs(made[key] - expected[key]) for key in expected) < 1e-14
