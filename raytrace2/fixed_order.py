"""Derivatives that are the same to the bit from run to run.

What one value does to many samples comes back to it as a sum, which threads add to in the order in which they happen to
come. On one thread that is the order of the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr


def ordered(function: Callable[[list[Any]], Any], inputs: list[Any], value: Any) -> Any:
    """``value``, which is ``function(inputs)``, with derivatives whose kernels run on one thread."""
    return dr.custom(_Ordered, inputs, value, function)


@contextmanager
def one_thread() -> Iterator[None]:
    """While it lasts, kernels run on one thread."""
    count = dr.thread_count()
    dr.sync_thread()
    dr.set_thread_count(1)
    try:
        yield
        dr.sync_thread()
    finally:
        dr.set_thread_count(count)


class _Ordered(dr.CustomOp):
    def eval(self, inputs: list[Any], value: Any, function: Callable[[list[Any]], Any]) -> Any:
        self._inputs, self._function = inputs, function
        return type(value)(value)

    def forward(self) -> None:
        copies = self._copies()
        dr.set_grad(copies, self.grad_in("inputs"))
        self.set_grad_out(dr.forward_to(self._function(copies)))

    def backward(self) -> None:
        copies = self._copies()
        value = self._function(copies)
        dr.set_grad(value, self.grad_out())
        with one_thread():
            dr.enqueue(dr.ADMode.Backward, value)
            dr.traverse(dr.ADMode.Backward)
            found = dr.grad(copies)
            dr.eval(found)
        self.set_grad_in("inputs", found)

    def name(self) -> str:
        return "ordered"

    def _copies(self) -> list[Any]:
        copies = [type(x)(dr.detach(x)) for x in self._inputs]
        dr.enable_grad(copies)
        return copies
