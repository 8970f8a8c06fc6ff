"""What follows a computation, and so forbids that it branches on its data."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor
from torch._C import _functorch  # pyright: ignore[reportAttributeAccessIssue]
from torch._functorch.pyfunctorch import temporarily_clear_interpreter_stack
from torch.autograd import forward_ad


def transformed() -> bool:
    """True under a transform of torch.func."""
    return bool(_functorch.peek_interpreter_stack())


def traced() -> bool:
    """True where gradients or transforms follow."""
    return torch.is_grad_enabled() or transformed()


def followed(tensor: Tensor) -> bool:
    """True if a gradient is taken of what is computed from ``tensor``, backwards or forwards."""
    return tensor.requires_grad or forward_ad.unpack_dual(tensor).tangent is not None


def readable(tensor: Tensor) -> bool:
    """True if the numbers of ``tensor`` are at hand: not if torch.func.vmap runs over them, nor on the device "meta", where
    tensors are shapes alone."""
    while _functorch.is_functorch_wrapped_tensor(tensor):
        if _functorch.is_batchedtensor(tensor):
            return False
        tensor = _functorch.get_unwrapped(tensor)
    return not tensor.is_meta


@contextmanager
def apart() -> Iterator[None]:
    """Outside of all transforms and gradients: for what no free number moves and is kept, so that it is the same
    whoever asks first."""
    with torch.no_grad(), temporarily_clear_interpreter_stack():
        yield
