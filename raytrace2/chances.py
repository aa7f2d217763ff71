"""Derivatives of random choices, which jump from one thing to the next and have none themselves."""

from __future__ import annotations

from typing import Any

import drjit as dr


def by_choice(weight: Any, chance: Any) -> Any:
    """``weight`` of what was chosen with the probability ``chance``, with the derivative that it would have if the
    choice were averaged over: the weight of a choice is a value over its probability, of which only the value moves."""
    if not dr.grad_enabled(chance):
        return weight
    fixed = dr.detach(chance)
    likely = fixed > 0
    # A one in itself, so that renders without derivatives by parameters do not compute it.
    return weight * dr.replace_grad(type(chance)(1), dr.select(likely, chance / dr.select(likely, fixed, 1), 1))
