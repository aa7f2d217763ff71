"""Which primitives a structure has to hold."""

from __future__ import annotations

import numpy as np

from ..surfaces import record
from ..surfaces.primitives import Primitives

# Odd numbers without a pattern: their products with the words of a record sum up to its digest.
_FACTORS = np.random.default_rng(1).integers(0, 2**63, record.GEOMETRY + 1, dtype=np.uint64) * 2 + 1


def held(parts: Primitives) -> Primitives:
    """``parts`` without those that no ray can be seen to meet: see :func:`indices_held`."""
    kept = indices_held(parts)
    return parts if kept is None else parts.reordered(kept)


def indices_held(parts: Primitives) -> np.ndarray | None:
    """Which primitives (indices, increasing) a structure has to hold, or None for all of them.

    A structure over nothing has a box that encloses nothing. Of equal primitives the first stands for all: the others
    are met at the same t and have the larger number, so a heap of copies costs what one does.
    """
    keep: np.ndarray = np.all(parts.lo <= parts.hi, axis=1)
    keep[_copies(parts)] = False
    return None if keep.all() else np.flatnonzero(keep)


def _copies(parts: Primitives) -> np.ndarray:
    """The indices of primitives that equal an earlier one to the last bit."""
    bits = np.uint32 if parts.types.precision == "float32" else np.uint64
    words = parts.records.view(bits)
    columns = [*range(record.GEOMETRY), record.KIND]
    digest = np.zeros(len(parts), np.uint64)
    for column, factor in zip(columns, _FACTORS, strict=True):
        digest += words[:, column] * factor
    order = np.argsort(digest, kind="stable") if _any_equal(digest) else np.zeros(0, np.int64)
    earlier, later = order[:-1], order[1:]
    alike = np.flatnonzero(digest[earlier] == digest[later])
    earlier, later = earlier[alike], later[alike]
    same = (words[earlier][:, columns] == words[later][:, columns]).all(axis=1)
    nested = np.isin(parts.records[later, record.KIND], _nested_codes(parts))
    return later[same & ~nested]


def _any_equal(digest: np.ndarray) -> bool:
    ordered = np.sort(digest)
    return bool((ordered[1:] == ordered[:-1]).any())


def _nested_codes(parts: Primitives) -> np.ndarray:
    """The words of kinds that lead into structures: copies of those differ in what is not compared."""
    kinds = (record.INSTANCE, record.NESTED)
    codes = [kind + 8 * place for kind in kinds for place in range(len(parts.nested))]
    return record.encode_integers(np.array(codes, np.uint32), parts.types)
