"""What a loop writes down in each turn for a later loop of the same kernel, in memory that lives as long as the kernel
works on a lane: it does not grow with the number of rays."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import drjit as dr


class Tape:
    """Room for ``length`` entries a lane, PyTrees like ``like`` (Dr.Jit arrays, dataclasses of them, lists, None).

    A PyTree itself, so that it can be part of the state of a symbolic loop.
    """

    DRJIT_STRUCT = {"leaves": list}

    def __init__(self, like: Any = None, length: int = 0) -> None:
        self.leaves = [dr.alloc_local(_kept(type(leaf)), length) for leaf in leaves(like)] if length else []

    def write(self, index: Any, entry: Any) -> None:
        """Writes down ``entry`` at ``index`` (UInt), which must be less than the length."""
        for place, leaf in zip(self.leaves, leaves(entry), strict=True):
            place[index] = leaf if _kept(type(leaf)) is type(leaf) else dr.select(leaf, 1, _kept(type(leaf))(0))

    def read(self, index: Any, like: Any) -> Any:
        """The entry at ``index``, in the shape of ``like``."""
        return rebuilt(like, (_as(leaf, place[index]) for leaf, place in zip(leaves(like), self.leaves, strict=True)))


def _kept(kind: Any) -> Any:
    # Dr.Jit 1.5 makes kernels that LLVM refuses of local arrays of masks.
    return dr.uint32_array_t(kind) if dr.is_mask_v(kind) else kind


def _as(like: Any, stored: Any) -> Any:
    return stored != 0 if dr.is_mask_v(like) else stored


def leaves(tree: Any) -> list[Any]:
    """The Dr.Jit arrays of a PyTree, in order."""
    if tree is None or isinstance(tree, bool | int | float):
        return []
    if isinstance(tree, list | tuple):
        return [leaf for part in tree for leaf in leaves(part)]
    if is_dataclass(tree):
        return [leaf for field in fields(tree) for leaf in leaves(getattr(tree, field.name))]
    return [tree]


def rebuilt(like: Any, arrays: Any) -> Any:
    """``like`` with its Dr.Jit arrays taken from the iterator ``arrays``."""
    if like is None or isinstance(like, bool | int | float):
        return like
    if isinstance(like, list | tuple):
        return type(like)(rebuilt(part, arrays) for part in like)
    if is_dataclass(like) and not isinstance(like, type):
        return replace(like, **{field.name: rebuilt(getattr(like, field.name), arrays) for field in fields(like)})
    return next(arrays)
