"""Primitive records: sixteen words that tell a ray test all it needs about one primitive.

Every kind of primitive fits the same record, so that a leaf that mixes kinds reads one packet and then asks for its
kind. Words 0 to 11 hold the geometry; :data:`ID` the primitive's number; :data:`KIND` one of the codes below;
:data:`ROOT`, for a nested structure, which of its roots to enter, and :data:`INSTANCE_NUMBER` which instance leads
there. Integers travel as the bits of a float in float32, as the value of a float in float64 (where every 32-bit
integer is exact).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import aligned_zeros
from ..types import Types

WORDS = 16
GEOMETRY = 12
ID = 12
KIND = 13
ROOT = 14
INSTANCE_NUMBER = 15

TRIANGLE, SPHERE, RECTANGLE, DISK, CYLINDER, INSTANCE, NESTED = range(7)
KIND_NAMES = ("triangle", "sphere", "rectangle", "disk", "cylinder", "instance", "nested structure")

#: The number of no primitive, surface or instance.
NONE = 0xFFFFFFFF


def make_records(
    geometry: np.ndarray, ids: np.ndarray, kind: int, types: Types, roots: np.ndarray | None = None
) -> np.ndarray:
    """Records (n, 16) in the precision of ``types`` from ``geometry`` (n, at most 12) and integer ``ids`` (n,)."""
    records = aligned_zeros((len(geometry), WORDS), types.numpy)
    records[:, : geometry.shape[1]] = geometry
    records[:, ID] = encode_integers(ids, types)
    records[:, KIND] = encode_integers(np.full(len(geometry), kind), types)
    if roots is not None:
        records[:, ROOT] = encode_integers(roots, types)
    return records


def encode_integers(values: np.ndarray, types: Types) -> np.ndarray:
    """32-bit integers as the floats that stand for them in a record."""
    values = np.asarray(values).astype(np.uint32)
    return values.view(np.float32) if types.precision == "float32" else values.astype(np.float64)


def decode_integer(word: Any, types: Types) -> Any:
    """The UInt that a record's word stands for."""
    if types.precision == "float32":
        return dr.reinterpret_array(types.UInt, word)
    return types.UInt(word)


def load_words(buffer: Any, index: Any, types: Types) -> list[Any]:
    """The sixteen words of record (or node) ``index``, by packet gathers."""
    packet = dr.gather(types.ArrayXf, buffer, index, shape=(WORDS, dr.width(index)))
    return [packet[k] for k in range(WORDS)]
