"""Tail probabilities against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest

from raytrace2.reference.student import binomial_quantile, incomplete_beta, t_pvalue, t_to_z

stats = pytest.importorskip("scipy.stats")
special = pytest.importorskip("scipy.special")


def test_t_pvalues() -> None:
    t = np.linspace(0.0, 60.0, 300)[:, None]
    df = np.array([1.0, 2.0, 5.0, 7.3, 14.0, 30.0, 1000.0])
    np.testing.assert_allclose(t_pvalue(t, df), 2.0 * stats.t.sf(t, df), rtol=1e-10, atol=1e-300)
    assert t_pvalue(np.inf, 7.0) == 0.0 and t_pvalue(0.0, 7.0) == 1.0


def test_incomplete_beta() -> None:
    rng = np.random.default_rng(0)
    a, b, x = rng.uniform(0.5, 300.0, 2000), rng.uniform(0.5, 300.0, 2000), rng.random(2000)
    np.testing.assert_allclose(incomplete_beta(a, b, x), special.betainc(a, b, x), atol=1e-11)
    a = 10.0 ** rng.uniform(2, 6, 200)
    x = np.clip(0.3 + rng.normal(0, 2, 200) / np.sqrt(a), 0.0, 1.0)
    np.testing.assert_allclose(incomplete_beta(0.3 * a, 0.7 * a, x), special.betainc(0.3 * a, 0.7 * a, x), atol=1e-8)


@pytest.mark.parametrize(("n", "p"), [(50, 0.01), (300, 0.01), (10_000, 0.01), (1_000_000, 0.002), (400, 0.3)])
def test_binomial_quantile_is_the_tight_one(n: int, p: float) -> None:
    alpha = 1e-4
    count = n * binomial_quantile(n, p, alpha)
    assert stats.binom.sf(np.ceil(count) - 1, n, p) <= alpha
    assert stats.binom.sf(np.floor(count) - 2, n, p) > alpha


def test_z_is_the_normal_deviate_of_the_same_probability() -> None:
    for df in (7.0, 14.0, 60.0):
        t = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 20.0])
        np.testing.assert_allclose(t_to_z(t, df), stats.norm.isf(stats.t.sf(t, df)), rtol=0.01)
