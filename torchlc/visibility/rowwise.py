"""Functions of rows whose cost depends on the data, made to work under torch.func."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

Rows = Callable[..., tuple[Tensor, ...]]


def rowwise(function: Rows, *inputs: Tensor) -> tuple[Tensor, ...]:
    """``function(*inputs)``, rows independent of one another; it may branch on data.

    The leading axis of the first input and of every output is N rows; that of the other inputs is N, or 1 for
    what is the same in every row. Under vmap the function sees the batch as more rows, never a batched
    tensor. Gradients run it again; they are constants themselves, so second derivatives leave it out.
    """
    return _Rowwise.apply(function, False, *inputs)  # pyright: ignore[reportReturnType]


def picked(tensor: Tensor, row: Tensor) -> Tensor:
    """The given rows of a tensor whose leading axis is N or 1."""
    return tensor[row] if len(tensor) > 1 else tensor.expand(len(row), *tensor.shape[1:])


class _Rowwise(torch.autograd.Function):
    """``sums``: outputs add up over rows, so that a batch cannot be treated as more rows."""

    @staticmethod
    def forward(function: Rows, sums: bool, *inputs: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        with torch.no_grad():
            return function(*inputs)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.function, ctx.sums = inputs[:2]
        ctx.save_for_backward(*inputs[2:])
        ctx.save_for_forward(*inputs[2:])
        if ctx.sums:
            ctx.mark_non_differentiable(*output)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        function, inputs = ctx.function, ctx.saved_tensors
        wanted = ctx.needs_input_grad[2:]

        def pulled_back(*rows: Tensor) -> tuple[Tensor, ...]:
            with torch.enable_grad():
                leaves = [row.detach().requires_grad_(want) for row, want in zip(rows, wanted, strict=False)]
                outputs = function(*leaves)
            moving = [k for k, output in enumerate(outputs) if output.requires_grad]
            return torch.autograd.grad(
                [outputs[k] for k in moving],
                [leaf for leaf in leaves if leaf.requires_grad],
                [rows[len(inputs) + k] for k in moving],
                allow_unused=True,
                materialize_grads=True,
            )

        found = iter(_Rowwise.apply(pulled_back, True, *inputs, *cotangents))  # pyright: ignore
        return None, None, *(next(found) if want else None for want in wanted)

    @staticmethod
    def jvp(ctx: Any, _function: Any, _sums: Any, *tangents: Tensor) -> Any:
        function, inputs = ctx.function, ctx.saved_tensors

        def pushed_forward(*rows: Tensor) -> tuple[Tensor, ...]:
            pairs = zip(rows[: len(inputs)], rows[len(inputs) :], strict=True)
            level = [torch.broadcast_tensors(row, tangent) for row, tangent in pairs]
            primals, directions = (
                tuple(row.contiguous() for row in each) for each in zip(*level, strict=True)
            )
            return torch.func.jvp(function, primals, directions)[1]

        return rowwise(pushed_forward, *inputs, *tangents)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: Rows, sums: bool, *inputs: Tensor) -> Any:
        size = info.batch_size
        batches = [
            row.expand(size, *row.shape) if dim is None else row.movedim(dim, 0)
            for row, dim in zip(inputs, in_dims[2:], strict=True)
        ]
        if sums:
            alone = [_Rowwise.apply(function, True, *(batch[k] for batch in batches)) for k in range(size)]
            outputs = tuple(torch.stack(output) for output in zip(*alone, strict=True))  # pyright: ignore
            return outputs, (0,) * len(outputs)
        count = batches[0].shape[1]

        def more_rows(batch: Tensor, dim: int | None) -> Tensor:
            shared = dim is None and batch.shape[1] < count
            return batch[0] if shared else batch.expand(size, count, *batch.shape[2:]).flatten(0, 1)

        outputs = rowwise(function, *map(more_rows, batches, in_dims[2:]))
        return tuple(output.unflatten(0, (size, count)) for output in outputs), (0,) * len(outputs)
