"""Functions of rows whose cost depends on the data, made to work under torch.func."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

Rows = Callable[..., tuple[Tensor, ...]]


def rowwise(function: Rows, *inputs: Tensor) -> tuple[Tensor, ...]:
    """``function(*inputs)``, every input and output with leading axis N, rows independent of one another.

    ``function`` may branch on data: under vmap it sees the batch as more rows, never a batched tensor.
    Gradients run it again; second derivatives are refused.
    """
    return _Rowwise.apply(function, *inputs)  # pyright: ignore[reportReturnType]


class _Rowwise(torch.autograd.Function):
    @staticmethod
    def forward(function: Rows, *inputs: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        with torch.no_grad():
            return function(*inputs)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.function = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        function, inputs = ctx.function, ctx.saved_tensors
        wanted = ctx.needs_input_grad[1:]

        def pulled_back(*rows: Tensor) -> tuple[Tensor, ...]:
            with torch.enable_grad():
                leaves = [row.detach().requires_grad_(want) for row, want in zip(rows, wanted, strict=False)]
                outputs = function(*leaves)
            asked = [leaf for leaf in leaves if leaf.requires_grad]
            moving = [k for k, output in enumerate(outputs) if output.requires_grad]
            return torch.autograd.grad(
                [outputs[k] for k in moving],
                asked,
                [rows[len(inputs) + k] for k in moving],
                allow_unused=True,
                materialize_grads=True,
            )

        found = iter(rowwise(pulled_back, *inputs, *cotangents))
        return None, *(next(found) if want else None for want in wanted)

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Tensor) -> Any:
        function, inputs = ctx.function, ctx.saved_tensors

        def pushed_forward(*rows: Tensor) -> tuple[Tensor, ...]:
            apart = [row.contiguous() for row in rows]  # a dual number has to own its memory
            return torch.func.jvp(function, tuple(apart[: len(inputs)]), tuple(apart[len(inputs) :]))[1]

        return rowwise(pushed_forward, *inputs, *tangents)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: Rows, *inputs: Tensor) -> Any:
        size = info.batch_size

        def more_rows(row: Tensor, dim: int | None) -> Tensor:
            if dim is not None:
                return row.movedim(dim, 0).flatten(0, 1)
            if row.stride(0) == 0:  # the same in every row: stays one copy
                return row[:1].expand(size * len(row), *row.shape[1:])
            return row.expand(size, *row.shape).flatten(0, 1)

        outputs = rowwise(function, *map(more_rows, inputs, in_dims[1:]))
        return tuple(out.unflatten(0, (size, -1)) for out in outputs), (0,) * len(outputs)
