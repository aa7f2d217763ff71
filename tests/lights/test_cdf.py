import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.lights import cdf
from raytrace2.types import types

BUFFER = 64


def invert(weights, u, precision="float32"):
    t = types(precision)
    table = np.ones(BUFFER)
    table[: len(weights) + 1] = cdf.cumulative(np.array(weights, dtype=np.float64))
    steps = cdf.steps(len(weights))
    i, inside = cdf.invert(
        t.Float(table.astype(t.numpy)), t.UInt(0), dr.opaque(t.UInt, len(weights)), steps, t.Float(u), t.Bool(True)
    )
    return i.numpy(), inside.numpy()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.one_of(st.just(0.0), st.floats(1e-30, 1e30)), min_size=1, max_size=40))
def test_choices_lie_in_their_interval_and_have_weight(weights):
    u = np.concatenate([np.linspace(0, 1, 64), [1 - 2**-24, 1.0]]).astype(np.float32)
    i, inside = invert(weights, u)
    w = np.array(weights)
    assert (i < len(w)).all()
    assert ((inside >= 0) & (inside < 1)).all()
    if w.any():
        assert (w[i] > 0).all()
        table = cdf.cumulative(w).astype(np.float32)
        table[table < np.finfo(np.float32).tiny] = 0  # kernels take subnormal numbers for zero
        u = np.minimum(u, np.float32(1 - 2**-23))
        assert ((table[i] <= u) & (u < table[i + 1])).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_frequencies_are_the_weights(precision):
    weights = np.array([1.0, 0, 3, 2, 0, 0, 4])
    i, inside = invert(weights, (np.arange(10000) + 0.5) / 10000, precision)
    assert np.allclose(np.bincount(i, minlength=7) / 10000, weights / 10, atol=1e-4)
    assert abs(inside.mean() - 0.5) < 1e-3


def test_steps_suffice_for_every_count():
    for count in range(1, BUFFER - 1):
        i, _ = invert(np.ones(count), (np.arange(count) + 0.5) / count)
        assert (i == np.arange(count)).all()
