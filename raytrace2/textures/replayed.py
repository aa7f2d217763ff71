"""Derivatives of sums that loops make, by running the loop once more.

Dr.Jit differentiates a loop in reverse mode only with help, and in either mode it carries derivatives of the whole
state along. Of a sum over texels nothing but the terms has any: which texels come next is a matter of whole numbers. So
the loop runs again, and each of its turns differentiates its own term (Vicini, Speierer and Jakob 2021, "Path Replay
Backpropagation", do so with bounces): no memory grows with the turns, and it works within a symbolic loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr


def summed(
    state: tuple[Any, ...],
    sums: tuple[Any, ...],
    more: Callable[..., Any],
    turn: Callable[..., tuple[Any, ...]],
    terms: Callable[..., tuple[Any, ...]],
    inputs: Sequence[Any],
    buffers: Sequence[Any],
    label: str | None = None,
) -> tuple[Any, ...]:
    """``dr.while_loop((*state, *sums), more, turn)``, whose ``sums`` have derivatives by ``inputs`` and ``buffers``.

    ``terms(inputs, *state)`` is what a turn that begins in ``state`` adds to each of the sums, made of the ``inputs``
    that it is given (Dr.Jit arrays, as many as ``inputs``) and of gathers from ``buffers``; anything else in it counts
    as constant, and so must the ``state``. Without derivatives the loop is exactly that loop.
    """
    if not dr.grad_enabled(inputs, buffers):
        return dr.while_loop((*state, *sums), more, turn, label=label)
    wanted = [dr.grad_enabled(x) for x in inputs]
    loop = _Loop(dr.detach(state), dr.detach(sums), more, turn, terms, wanted, label)
    made = dr.custom(_Replayed, loop, tuple(inputs), tuple(b for b in buffers if dr.grad_enabled(b)))
    return *loop.final, *made


class _Loop:
    """What :func:`summed` is given, in a form that Dr.Jit does not look into."""

    def __init__(self, state: Any, sums: Any, more: Any, turn: Any, terms: Any, wanted: Any, label: Any) -> None:
        self.state, self.sums, self.more, self.turn, self.terms = state, sums, more, turn, terms
        self.wanted, self.label = wanted, label
        self.final: tuple[Any, ...] = ()


class _Replayed(dr.CustomOp):
    def eval(self, loop: _Loop, inputs: tuple[Any, ...], buffers: Any) -> tuple[Any, ...]:
        self.loop, self.inputs = loop, inputs
        self.add_input(buffers)
        # What the loop's functions know of themselves may carry derivatives, of which the loop shall make none.
        with dr.suspend_grad():
            result = dr.while_loop((*loop.state, *loop.sums), loop.more, loop.turn, label=loop.label)
        loop.final = result[: len(loop.state)]
        return tuple(result[len(loop.state) :])

    def forward(self) -> None:
        tangents = self.grad_in("inputs")
        zero = tuple(dr.zeros(type(s), self._width()) for s in self.loop.sums)

        def derive(local: list[Any], terms: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
            for x, tangent in zip(local, tangents, strict=True):
                if dr.grad_enabled(x):
                    dr.set_grad(x, tangent)
            made = terms()
            # One term may be part of another, and buffers keep their tangents for the next turn.
            dr.forward_to(made, flags=dr.ADFlag.ClearEdges | dr.ADFlag.AllowNoGrad)
            return tuple(dr.grad(m) for m in made)

        self.set_grad_out(self._replay(zero, derive))

    def backward(self) -> None:
        adjoints = self.grad_out()
        zero = tuple(dr.zeros(type(x), self._width()) for x in self.inputs)

        def derive(local: list[Any], terms: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
            products = [dr.dot(a, m) if dr.depth_v(m) > 1 else a * m for a, m in zip(adjoints, terms(), strict=True)]
            total = products[0]
            for p in products[1:]:
                total = total + p
            if dr.grad_enabled(total):
                dr.backward_from(total)
            return tuple(dr.grad(x) for x in local)

        self.set_grad_in("inputs", self._replay(zero, derive))

    def name(self) -> str:
        return self.loop.label or "sum"

    def _width(self) -> int:
        return dr.width(self.loop.state, self.loop.sums, self.inputs)

    def _replay(self, zero: tuple[Any, ...], derive: Any) -> tuple[Any, ...]:
        """The sums of ``derive`` over all turns."""
        loop, n = self.loop, len(self.loop.state)

        def again(*both: Any) -> tuple[Any, ...]:
            state, sums = both[:n], both[n:]
            with dr.resume_grad():
                local = [dr.copy(x) for x in self.inputs]
                for x, wanted in zip(local, loop.wanted, strict=True):
                    if wanted:
                        dr.enable_grad(x)
                found = dr.detach(derive(local, lambda: loop.terms(local, *state)))
            with dr.suspend_grad():
                following = loop.turn(*state, *loop.sums)[:n]
            return *following, *(s + f for s, f in zip(sums, found, strict=True))

        with dr.suspend_grad():
            return tuple(dr.while_loop((*loop.state, *zero), lambda *b: loop.more(*b[:n], *loop.sums), again)[n:])


def finite(value: Any) -> Any:
    """``value`` (a Dr.Jit array), whose derivatives are 0 where they would be infinite or NaN, in either direction."""
    return dr.custom(_Finite, value) if dr.grad_enabled(value) else value


class _Finite(dr.CustomOp):
    def eval(self, value: Any) -> Any:
        return value

    def forward(self) -> None:
        self.set_grad_out(_masked(self.grad_in("value")))

    def backward(self) -> None:
        self.set_grad_in("value", _masked(self.grad_out()))

    def name(self) -> str:
        return "finite derivatives"


def _masked(value: Any) -> Any:
    return dr.select(dr.isfinite(value), value, 0)


__all__ = ["finite", "summed"]
