"""Functions of rows whose cost depends on the data, made to work under torch.func."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torchlc.tensors.autodiff_state import transformed

MOST_KEPT = 2**14
"""Rows up to which the graph behind a value is kept for its gradient; it takes some 10 KiB a row that is partly hidden."""
Rows = Callable[..., tuple[Tensor, ...]]


def rowwise(function: Rows, *inputs: Tensor) -> tuple[Tensor, ...]:
    """``function(*inputs)``, rows independent of one another; it may branch on data.

    The leading axis of the first input and of every output is N rows; that of the others is N, or 1 for what
    is the same in every row. Under vmap the function sees the batch as more rows, never a batched tensor.
    Derivatives run it again, but for the gradient of few rows. Its Jacobian is taken as constant: second derivatives have the Gauss-Newton
    terms, not its own curvature.
    """
    followed = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs)
    kind = _Kept if followed and not transformed() and len(inputs[0]) <= MOST_KEPT else _Value
    return kind.apply(function, *inputs)  # pyright: ignore[reportReturnType]


def picked(tensor: Tensor, row: Tensor) -> Tensor:
    """The given rows of a tensor whose leading axis is N or 1."""
    return tensor[row] if len(tensor) > 1 else tensor.expand(len(row), *tensor.shape[1:])


class _Kept(torch.autograd.Function):
    """The value with the graph behind it, which a gradient then need not make again; a gradient that is itself followed is
    made as that of `_Value`."""

    @staticmethod
    def forward(ctx: Any, function: Rows, *inputs: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        ctx.function, ctx.wanted = function, tuple(tensor.requires_grad for tensor in inputs)
        ctx.save_for_backward(*inputs)
        ctx.leaves, ctx.outputs = _graph(function, ctx.wanted, inputs)
        return tuple(output.detach() for output in ctx.outputs)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        if torch.is_grad_enabled():
            pulled = _PulledBack.apply(ctx.function, ctx.wanted, *ctx.saved_tensors, *cotangents)
        else:
            pulled = _pulled(ctx.leaves, ctx.outputs, cotangents, kept=True)
        gradients = iter(pulled)  # pyright: ignore
        return None, *(next(gradients) if want else None for want in ctx.wanted)


def _graph(
    function: Rows, wanted: Sequence[bool], inputs: Sequence[Tensor]
) -> tuple[list[Tensor], tuple[Tensor, ...]]:
    """Inputs of which a gradient is wanted, cut off from what they come from, and the outputs that follow from them."""
    with torch.enable_grad():
        leaves = [tensor.detach().requires_grad_(want) for tensor, want in zip(inputs, wanted, strict=True)]
        outputs = function(*leaves)
    return [leaf for leaf in leaves if leaf.requires_grad], outputs


def _pulled(
    leaves: Sequence[Tensor], outputs: Sequence[Tensor], cotangents: Sequence[Tensor], *, kept: bool
) -> tuple[Tensor, ...]:
    """Cotangents times the Jacobian of outputs by leaves; a graph that is ``kept`` may be asked again."""
    moving = [k for k, output in enumerate(outputs) if output.requires_grad]
    if not moving:
        return tuple(map(torch.zeros_like, leaves))
    return torch.autograd.grad(
        [outputs[k] for k in moving],
        leaves,
        [cotangents[k] for k in moving],
        retain_graph=kept,
        allow_unused=True,
        materialize_grads=True,
    )


class _Value(torch.autograd.Function):
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
        wanted = tuple(ctx.needs_input_grad[1:])
        gradients = iter(_PulledBack.apply(ctx.function, wanted, *ctx.saved_tensors, *cotangents))  # pyright: ignore
        return None, *(next(gradients) if want else None for want in wanted)

    @staticmethod
    def jvp(ctx: Any, _function: Any, *tangents: Tensor) -> Any:
        return _PushedForward.apply(ctx.function, *ctx.saved_tensors, *tangents)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: Rows, *inputs: Tensor) -> Any:
        return _as_more_rows(_Value, info.batch_size, in_dims, function, inputs)


class _PushedForward(torch.autograd.Function):
    """Jacobian times tangents: inputs, then a tangent for each; linear in the tangents."""

    @staticmethod
    def forward(function: Rows, *rows: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        half = len(rows) // 2
        level = [
            torch.broadcast_tensors(row, tangent)
            for row, tangent in zip(rows[:half], rows[half:], strict=True)
        ]
        # a dual number has to own its memory
        primals, tangents = (tuple(row.contiguous() for row in each) for each in zip(*level, strict=True))
        return torch.func.jvp(function, primals, tangents)[1]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.function, half = inputs[0], len(inputs) // 2
        ctx.save_for_backward(*inputs[1 : half + 1])
        ctx.save_for_forward(*inputs[1 : half + 1])

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        inputs = ctx.saved_tensors
        wanted = tuple(ctx.needs_input_grad[1 + len(inputs) :])
        gradients = iter(_PulledBack.apply(ctx.function, wanted, *inputs, *cotangents))  # pyright: ignore
        return None, *[None] * len(inputs), *(next(gradients) if want else None for want in wanted)

    @staticmethod
    def jvp(ctx: Any, _function: Any, *tangents: Tensor) -> Any:
        inputs = ctx.saved_tensors
        return _PushedForward.apply(ctx.function, *inputs, *tangents[len(inputs) :])

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], function: Rows, *rows: Tensor) -> Any:
        return _as_more_rows(_PushedForward, info.batch_size, in_dims, function, rows)


class _PulledBack(torch.autograd.Function):
    """Cotangents times Jacobian: inputs, then a cotangent for each output; linear in the cotangents.

    ``wanted`` says of which inputs. What has one row collects from all, so that a batch is taken one by one.
    """

    @staticmethod
    def forward(function: Rows, wanted: tuple[bool, ...], *rows: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        inputs, cotangents = rows[: len(wanted)], rows[len(wanted) :]
        return _pulled(*_graph(function, wanted, inputs), cotangents, kept=False)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.function, ctx.wanted = inputs[:2]
        ctx.save_for_backward(*inputs[2 : 2 + len(ctx.wanted)])
        ctx.save_for_forward(*inputs[2 : 2 + len(ctx.wanted)])

    @staticmethod
    def backward(ctx: Any, *tangents: Tensor) -> Any:
        inputs, given = ctx.saved_tensors, iter(tangents)
        each = [
            next(given) if want else torch.zeros_like(row)
            for row, want in zip(inputs, ctx.wanted, strict=True)
        ]
        return None, None, *[None] * len(inputs), *_PushedForward.apply(ctx.function, *inputs, *each)  # pyright: ignore

    @staticmethod
    def jvp(ctx: Any, _function: Any, _wanted: Any, *tangents: Tensor) -> Any:
        inputs = ctx.saved_tensors
        return _PulledBack.apply(ctx.function, ctx.wanted, *inputs, *tangents[len(inputs) :])

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], function: Rows, wanted: tuple[bool, ...], *rows: Tensor
    ) -> Any:
        batches = _batches(info.batch_size, in_dims[2:], rows)
        alone = [
            _PulledBack.apply(function, wanted, *(batch[k] for batch in batches))
            for k in range(info.batch_size)
        ]
        outputs = tuple(torch.stack(output) for output in zip(*alone, strict=True))  # pyright: ignore
        return outputs, (0,) * len(outputs)


def _batches(size: int, in_dims: Sequence[int | None], rows: Sequence[Tensor]) -> list[Tensor]:
    """Every input with the batch as its first axis."""
    return [
        row.expand(size, *row.shape) if dim is None else row.movedim(dim, 0)
        for row, dim in zip(rows, in_dims, strict=True)
    ]


def _as_more_rows(
    kind: Any, size: int, in_dims: Sequence[Any], function: Rows, rows: Sequence[Tensor]
) -> Any:
    """``kind`` of the function, batch and rows as one axis; what is the same in all keeps its one row."""
    batches = _batches(size, in_dims[1:], rows)
    count = batches[0].shape[1]
    flat = [
        batch[0]
        if dim is None and batch.shape[1] < count
        else batch.expand(size, count, *batch.shape[2:]).flatten(0, 1)
        for batch, dim in zip(batches, in_dims[1:], strict=True)
    ]
    outputs = kind.apply(function, *flat)
    return tuple(output.unflatten(0, (size, count)) for output in outputs), (0,) * len(outputs)
