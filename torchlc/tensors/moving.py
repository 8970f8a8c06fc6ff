"""Tensors to another device or precision, wherever in an object they are."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import wraps
from types import CellType, FunctionType
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor, nn

Thing = TypeVar("Thing")
Given = ParamSpec("Given")
CPU = torch.device("cpu")
"""Where verbs compute, and where a light curve is made."""


def on(device: torch.device) -> AbstractContextManager[Any]:
    """Where tensors that are made without a device are made on this one, whatever ``torch.set_default_device`` says. It
    costs nothing where that says the same."""
    return nullcontext() if torch.get_default_device() == device else device


def on_cpu(function: Callable[Given, Thing]) -> Callable[Given, Thing]:
    """The function with the tensors that it makes on the CPU."""

    @wraps(function)
    def there(*values: Given.args, **named: Given.kwargs) -> Thing:
        with on(CPU):
            return function(*values, **named)

    return there


def moved(
    thing: Thing,
    convert: Callable[[Tensor], Tensor],
    dtype: torch.dtype,
    device: torch.device,
    kept: tuple[type, ...] = (),
    parameter: Callable[[nn.Parameter], nn.Parameter] = lambda parameter: parameter,
) -> Thing:
    """A copy of an object, of all that it holds, and of all that these hold, with ``convert(tensor)`` for every tensor,
    and for ``dtype`` and ``device`` those that convert changes them to. Classes and objects of the types
    ``kept`` are not copied; ``parameter`` says what becomes of an ``nn.Parameter``, which stays what it is. What is one object in two places is so in the copy, unless a function encloses it.

    The copy is by pickle, which finds whatever an object holds; neither tensors nor functions are pickled.
    """
    like = convert(torch.zeros((), dtype=dtype, device=device))
    known: dict[int, Any] = {}

    def replaced(item: Any) -> Any:
        if id(item) not in known:
            known[id(item)] = other(item)
        return known[id(item)]

    def other(item: Any) -> Any:
        if isinstance(item, Tensor):
            return parameter(item) if isinstance(item, nn.Parameter) else convert(item)
        if isinstance(item, torch.dtype) and item == dtype:
            return like.dtype
        if isinstance(item, torch.device) and item == device:
            return like.device
        return enclosing(item) if isinstance(item, FunctionType) and item.__closure__ else item

    def enclosing(function: FunctionType) -> FunctionType:
        cells = tuple(CellType() for _ in function.__closure__ or ())
        copy = FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__, cells
        )
        copy.__kwdefaults__ = function.__kwdefaults__
        known[id(function)] = copy
        for cell, old in zip(cells, function.__closure__ or (), strict=True):
            cell.cell_contents = copied(old.cell_contents)
        return copy

    def copied(whole: Any) -> Any:
        stream = io.BytesIO()
        taking = _Taking(stream, (Tensor, torch.dtype, torch.device, type, FunctionType, *kept))
        taking.dump(whole)
        stream.seek(0)
        return _Giving(stream, [replaced(item) for item in taking.taken]).load()

    return copied(thing)


class _Taking(pickle.Pickler):
    """Takes objects of some types out of what it pickles, each once."""

    def __init__(self, stream: io.BytesIO, types: tuple[type, ...]) -> None:
        super().__init__(stream, protocol=pickle.HIGHEST_PROTOCOL)
        self.types, self.taken = types, []
        self._number: dict[int, int] = {}

    def persistent_id(self, obj: Any) -> int | None:
        if not isinstance(obj, self.types):
            return None
        if id(obj) not in self._number:
            self._number[id(obj)] = len(self.taken)
            self.taken.append(obj)
        return self._number[id(obj)]


class _Giving(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, given: list[Any]) -> None:
        super().__init__(stream)
        self.given = given

    def persistent_load(self, pid: Any) -> Any:
        return self.given[pid]
