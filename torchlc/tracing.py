"""What follows a computation, and so forbids that it branches on its data."""

from __future__ import annotations

import torch


def transformed() -> bool:
    """True under a transform of torch.func."""
    return bool(torch._C._functorch.peek_interpreter_stack())  # pyright: ignore[reportAttributeAccessIssue]


def traced() -> bool:
    """True where gradients or transforms follow."""
    return torch.is_grad_enabled() or transformed()
