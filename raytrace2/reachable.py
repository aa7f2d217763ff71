"""The Dr.Jit arrays that objects of this package hold, wherever in them, for functions that Dr.Jit freezes."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from types import FunctionType, MethodType
from typing import Any

import drjit as dr
import numpy as np

_PLAIN = str | int | float | bool | bytes | type | np.ndarray | np.generic | None


def reachable(roots: Iterable[Any], leave_out: tuple[type, ...] = ()) -> tuple[list[Any], tuple[Any, ...]]:
    """All arrays below ``roots``, each object once, in an order that depends on nothing but how they hang together; and
    all plain numbers and words there, by which two states are told apart for which kernels may differ.

    Attributes, members of containers, what functions have closed over and what a method ``held_elsewhere`` gives count
    as below; objects of other packages,
    descriptions of scenes (frozen, and without arrays) and those of the types ``leave_out`` do not.
    """
    arrays: list[Any] = []
    plain: list[Any] = []
    seen: set[int] = set()
    waiting = list(roots)[::-1]
    while waiting:
        item = waiting.pop()
        if isinstance(item, bool | int | float | str):
            plain.append(item)
            continue
        if isinstance(item, _PLAIN) or id(item) in seen:
            continue
        seen.add(id(item))
        if isinstance(item, dr.ArrayBase):
            arrays.append(item)
        elif not isinstance(item, leave_out):
            waiting += list(_parts(item))[::-1]
    return arrays, tuple(plain)


def _parts(item: Any) -> Iterable[Any]:
    if isinstance(item, list | tuple):
        return item
    if isinstance(item, Mapping):
        return item.values()
    if isinstance(item, MethodType):
        return (item.__self__, item.__func__)
    if isinstance(item, functools.partial):
        return (item.func, item.args, item.keywords)
    if isinstance(item, FunctionType):
        return [cell.cell_contents for cell in item.__closure__ or ()]
    module = type(item).__module__
    if not module.startswith(__package__ or "") or module.endswith(".scene.description"):
        return []
    elsewhere: Any = getattr(item, "held_elsewhere", None)
    # What structures tell of themselves, times among it, is in no kernel.
    attributes = [v for name, v in getattr(item, "__dict__", {}).items() if name != "_statistics"]
    return [*attributes, *(elsewhere() if elsewhere else ())]
