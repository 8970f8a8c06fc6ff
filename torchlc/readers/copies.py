"""Curves that are exact copies of others, at the same rows or later ones: no two measurements agree in every digit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchlc.digits import number_of

WINDOW = 6
"""Successive rows that are compared as one: values of 30 steps a row agree by chance in one of 7e8 pairs of such."""
CHANGES = 3
"""Steps within a window that have to be no 0: what stays the same agrees with itself anywhere."""
SHARE = 0.5
"""Of the windows of the shorter of two curves that have to agree."""
FEWEST = 12
"""Rows of a curve below which it is not compared."""
SEED = 20_260_419


def copies(seconds: np.ndarray, observed: np.ndarray, curve: np.ndarray, ids: Sequence[str]) -> list[str]:
    """A sentence for each curve that copies an earlier one of the list, for rows (T,) in order of time.

    Rows are counted within each curve. A copy may be delayed, and may go on at its beginning where the other ends.
    """
    rows = [np.flatnonzero(curve == code) for code in range(len(ids))]
    rows = [group for group in rows if len(group) >= FEWEST]
    if len(rows) < 2:
        return []
    keys, owner, position = [], [], []
    weight = np.random.default_rng(SEED).integers(1, 2**63, WINDOW, dtype=np.uint64) | np.uint64(1)
    for number, indices in enumerate(rows):
        values = observed[indices] + 0.0
        bits = np.lib.stride_tricks.sliding_window_view(values.view(np.uint64), WINDOW)
        moving = np.lib.stride_tricks.sliding_window_view(np.diff(values) != 0, WINDOW - 1).sum(-1) >= CHANGES
        mixed = bits ^ (bits >> np.uint64(29))
        keys.append((mixed * weight).sum(-1, dtype=np.uint64)[moving])
        position.append(np.flatnonzero(moving))
        owner.append(np.full(len(position[-1]), number))
    key, owner, position = np.concatenate(keys), np.concatenate(owner), np.concatenate(position)
    order = np.lexsort((position, owner, key))
    key, owner, position = key[order], owner[order], position[order]
    twin = (key[1:] == key[:-1]) & (owner[1:] != owner[:-1])
    first, second = owner[:-1][twin], owner[1:][twin]
    lag = position[1:][twin] - position[:-1][twin]
    sentences = []
    for a, b in np.unique(np.stack([first, second], -1), axis=0):
        both = (first == a) & (second == b)
        windows = min(len(rows[a]), len(rows[b])) - WINDOW + 1
        lags, counts = np.unique(lag[both], return_counts=True)
        if both.sum() < SHARE * windows:
            continue
        main = int(lags[counts.argmax()])
        start = rows[b][max(main, 0)], rows[a][max(-main, 0)]
        delay = seconds[start[0]] - seconds[start[1]]
        equal = int(counts.max()) + WINDOW - 1
        name, other = ids[int(curve[rows[b][0]])], ids[int(curve[rows[a][0]])]
        what = (
            f"{number_of(abs(main), 'row')} {'behind' if main > 0 else 'ahead'}, {delay:+.6g} s"
            if main
            else "row by row"
        )
        sentences.append(
            f"curve {name} repeats curve {other} to the last digit ({what}; {equal} of {len(rows[b])} rows): one of the "
            "two is no measurement"
        )
    return sentences
