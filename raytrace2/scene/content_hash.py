"""A digest of everything in a description that shapes the image."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

# Where things come from and how they were written changes no pixel; settings choose how, not what, to compute
_NAMES = frozenset({"id", "location", "filename", "source", "hash", "settings", "names", "grey", "flipped"})


def content_hash(description: Any) -> str:
    """The SHA-256 (hexadecimal) of a description: names of types and fields, numbers exactly, arrays by their bytes.

    Equal scenes have equal digests however they were written; objects that are shared are digested once.
    """
    return _digest(description, {}).hex()


def _digest(value: Any, known: dict[int, bytes]) -> bytes:
    if id(value) in known:
        return known[id(value)]
    hasher = hashlib.sha256()
    if isinstance(value, np.ndarray):
        hasher.update(f"array {value.dtype.str} {value.shape}".encode())
        hasher.update(np.ascontiguousarray(value).data)
    elif is_dataclass(value) and not isinstance(value, type):
        hasher.update(type(value).__name__.encode())
        for item in fields(value):
            if item.name not in _NAMES:
                hasher.update(f" {item.name} ".encode() + _digest(getattr(value, item.name), known))
    elif isinstance(value, dict):
        hasher.update(b"dict")
        for key in sorted(value):
            hasher.update(f" {key} ".encode() + _digest(value[key], known))
    elif isinstance(value, tuple | list):
        hasher.update(f"sequence {len(value)}".encode())
        for item in value:
            hasher.update(_digest(item, known))
    else:
        return hashlib.sha256(f"{type(value).__name__} {value!r}".encode()).digest()
    known[id(value)] = hasher.digest()
    return known[id(value)]
