"""Costly geometric results, kept by what they came from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import torch
from torch import Tensor

from torchlc.tensors.autodiff_state import readable

LARGEST_MEMORY = 400 * 2**20
"""What all results that are kept may have together."""


class Memory:
    """Costly geometric results by the bytes of what they came from, the oldest given up beyond LARGEST_MEMORY
    bytes."""

    def __init__(self) -> None:
        self._kept: dict[bytes, Sequence[Tensor]] = {}
        self._bytes = 0

    def recall(
        self, inputs: Sequence[Sequence[Tensor]], compute: Callable[[list[int]], Sequence[Tensor]]
    ) -> list[Tensor]:
        """What ``compute`` gives for some of the N items of ``inputs``, by their numbers, as tensors (items,
        ...): for all of them, (N, ...), but asked only for items that are new."""
        if not all(readable(tensor) for item in inputs for tensor in item):
            return list(compute(list(range(len(inputs)))))
        keys = [_digest(item) for item in inputs]
        new = {key: k for k, key in enumerate(keys) if key not in self._kept}
        computed = compute(list(new.values())) if new else ()
        made = {key: [tensor[number].clone() for tensor in computed] for number, key in enumerate(new)}
        self._kept |= made
        self._bytes += bytes_of(made)
        whole = [torch.stack(column) for column in zip(*(self._kept[key] for key in keys), strict=True)]
        while len(self._kept) > 1 and self._bytes > LARGEST_MEMORY:
            self._bytes -= bytes_of(self._kept.pop(next(iter(self._kept))))
        return whole


def bytes_of(value: Any) -> int:
    """Bytes of the tensors in a dataclass, a mapping or a sequence, however deep; what is expanded counts as what it holds."""
    if isinstance(value, Tensor):
        return value.untyped_storage().nbytes()
    if is_dataclass(value):
        return sum(bytes_of(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping):
        return sum(map(bytes_of, value.values()))
    return sum(map(bytes_of, value)) if isinstance(value, list | tuple) else 0


def _digest(tensors: Sequence[Tensor]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for tensor in tensors:
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.digest()
