"""How threads add up what many samples say of one number: each in a copy of its own, or all in one place with atomics.

Copies have to be cleared and added up, which takes time by their size; atomics take time by the number of samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr

#: Entries of a buffer that cost as much to copy, clear and add up as one lane's atomics: measured on two cores, where
#: 65,536 lanes that filter 4 million numbers are already quicker with copies.
_ENTRIES_A_LANE = 64

#: What all threads' copies of one buffer may have.
_MOST_ENTRIES = 2**27


@contextmanager
def private_sums(lanes: int) -> Iterator[None]:
    """While it lasts, derivatives of ``lanes`` lanes by larger buffers than Dr.Jit's threshold go to copies a thread,
    as long as that is quicker and the copies have less than 2^27 entries together."""
    before = dr.expand_threshold()
    enough = min(_ENTRIES_A_LANE * lanes, _MOST_ENTRIES // max(dr.thread_count(), 1))
    dr.set_expand_threshold(max(before, enough))
    try:
        yield
    finally:
        dr.set_expand_threshold(before)
