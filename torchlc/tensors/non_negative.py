"""Least squares without negative numbers, of many small problems at once."""

from __future__ import annotations

import torch
from torch import Tensor

RIDGE = 1e-10
"""Share of a column's square that is added to it, so that columns alike have one solution."""
SPARE, PIVOTS = 3, 5
"""Rounds in which wrong signs need not grow fewer, and the most rounds a column."""
PARALLEL = 1e-12
"""Square of the sine between two columns below which they are one."""
DARK = 1e-200
"""Square of a column that holds nothing."""


def non_negative(products: Tensor, targets: Tensor) -> Tensor:
    """Least squares (..., K) without negative numbers, from normal equations: exact for two columns, else by block principal
    pivoting (Kim and Park 2011, SIAM J. Sci. Comput. 33, 3261, algorithm 1), exact but for RIDGE."""
    count = targets.shape[-1]
    if count == 2:
        return _two(torch.diagonal(products, dim1=-2, dim2=-1), products[..., 0, 1], targets)
    normal, aim = products.reshape(-1, count, count), targets.reshape(-1, count)
    diagonal = torch.diagonal(normal, dim1=-2, dim2=-1)
    present = diagonal > DARK  # a column of nothing has none
    scale = torch.where(present, torch.where(present, diagonal, 1.0).rsqrt(), 0.0)
    normal, aim = normal * scale[:, :, None] * scale[:, None, :], aim * scale
    least = 1e-12 * aim.abs().amax(-1, keepdim=True)
    free = aim > 0
    solution = torch.zeros_like(aim)
    left = torch.arange(len(aim))
    fewest, spare = torch.full((len(aim),), count + 1), torch.full((len(aim),), SPARE)
    for _ in range(PIVOTS * count):
        kept = free.to(normal)
        system = normal * kept[:, :, None] * kept[:, None, :]
        system.diagonal(dim1=-2, dim2=-1).add_(1 - kept + RIDGE)
        factor, _ = torch.linalg.cholesky_ex(system)
        solved = torch.cholesky_solve((aim * kept)[..., None], factor)[..., 0]
        solution[left] = solved
        slope = (normal @ solved[..., None])[..., 0] - aim
        wrong = torch.where(free, solved, slope) < -least
        number = wrong.sum(-1)
        on = number > 0
        if not bool(on.any()):
            break
        left, normal, aim, least, free, fewest, spare, wrong, number = (
            tensor[on] for tensor in (left, normal, aim, least, free, fewest, spare, wrong, number)
        )
        # all that are wrong change sides while they grow fewer; else, so that no round repeats, the last of them alone
        fell = number < fewest
        every = fell | (spare > 0)
        spare, fewest = torch.where(fell, SPARE, spare - 1), torch.where(fell, number, fewest)
        last = count - 1 - wrong.flip(-1).to(torch.int8).argmax(-1)
        alone = torch.zeros_like(wrong).scatter_(1, last[:, None], True)
        free = free ^ torch.where(every[:, None], wrong, alone)
    return (solution.clamp(min=0) * scale).reshape(targets.shape)


def _two(diagonal: Tensor, cross: Tensor, targets: Tensor) -> Tensor:
    """Least squares (..., 2) without negative numbers: both columns where neither comes out negative, else the better one alone."""
    safe = diagonal.clamp(min=DARK)
    determinant = safe[..., 0] * safe[..., 1] - cross**2
    solvable = determinant > PARALLEL * safe[..., 0] * safe[..., 1]
    pair = (safe.flip(-1) * targets - cross[..., None] * targets.flip(-1)) / torch.where(
        solvable, determinant, 1.0
    )[..., None]
    alone = torch.where(diagonal > DARK, targets.clamp(min=0) / safe, 0.0)
    first = alone[..., 0] * targets[..., 0] >= alone[..., 1] * targets[..., 1]
    single = torch.where(torch.stack([first, ~first], -1), alone, 0.0)
    return torch.where((solvable & (pair > 0).all(-1))[..., None], pair, single)
