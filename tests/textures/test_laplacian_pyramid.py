from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from drjit.opt import Adam

import raytrace2 as rt
from raytrace2.types import types

T32, T64 = types("float32"), types("float64")


@pytest.mark.parametrize("wrap_mode", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("shape", [(8, 8, 3), (7, 5, 1), (1, 9, 3), (33, 20, 3), (1, 1, 1)])
def test_the_sum_of_levels_is_the_texture(shape: tuple[int, int, int], wrap_mode: str) -> None:
    image = np.random.default_rng(0).random(shape)
    for t, error in ((T32, 1e-6), (T64, 1e-15)):
        for count in (None, 1):
            pyramid = rt.LaplacianPyramid(t.TensorXf(image), count, wrap_mode)
            assert pyramid.texture().shape == shape
            assert np.abs(np.array(pyramid.texture()) - image).max() <= error
    pyramid = rt.LaplacianPyramid(T64.TensorXf(image), None, wrap_mode)
    *_, last = pyramid.levels.values()
    assert last.shape == (1, 1, shape[2])
    assert np.allclose(np.array(last)[0, 0], image.mean((0, 1)))


@pytest.mark.parametrize("shape", [(8, 16, 3), (7, 5, 1)])
def test_gradients_of_levels(shape: tuple[int, int, int]) -> None:
    t = T64
    rng = np.random.default_rng(1)
    pyramid = rt.LaplacianPyramid(t.TensorXf(rng.random(shape)))
    weights = t.Float(rng.random(int(np.prod(shape))))
    levels = {name: t.TensorXf(level) for name, level in pyramid.levels.items()}
    dr.enable_grad(levels)
    dr.backward_from(dr.sum(pyramid.texture(levels).array * weights))
    for name, level in levels.items():
        step = rng.normal(size=level.shape)
        ends = [
            dr.sum(
                pyramid.texture({**pyramid.levels, name: pyramid.levels[name] + s * t.TensorXf(step)}).array * weights
            )[0]
            for s in (-1, 1)
        ]
        assert (np.array(dr.grad(level)) * step).sum() == pytest.approx((ends[1] - ends[0]) / 2, rel=1e-9)


def test_coarse_levels_are_smooth() -> None:
    t = T64
    pyramid = rt.LaplacianPyramid(t.TensorXf(np.zeros((32, 32, 1))), 4)
    levels = {name: t.TensorXf(level) for name, level in pyramid.levels.items()}
    levels["level_3"] = levels["level_3"] + 1
    assert np.allclose(np.array(pyramid.texture(levels)), 1)
    one = np.zeros((4, 4, 1))
    one[1, 1] = 1
    levels["level_3"] = t.TensorXf(one)
    image = np.array(pyramid.texture(levels))[..., 0]
    assert image.sum() == pytest.approx(64)
    assert np.abs(np.diff(image, axis=0)).max() < 0.26


def test_clamped_levels() -> None:
    t = T32
    rng = np.random.default_rng(2)
    pyramid = rt.LaplacianPyramid(t.TensorXf(rng.random((9, 12, 3))))
    levels = {name: level + 0.3 for name, level in pyramid.levels.items()}
    inside = pyramid.clamped(levels)
    texture, expected = np.array(pyramid.texture(inside)), np.clip(np.array(pyramid.texture(levels)), 0, 1)
    assert np.allclose(texture, expected, atol=1e-6)
    assert all(np.array_equal(inside[n], levels[n]) for n in levels if n != "level_0")


def test_an_optimiser_recovers_a_texture() -> None:
    t = T32
    goal = t.TensorXf(np.random.default_rng(3).random((16, 16, 3)))
    pyramid = rt.LaplacianPyramid(dr.full(t.TensorXf, 0.5, shape=(16, 16, 3)))
    optimizer = Adam(lr=0.02, params=dict(pyramid.levels))
    for _ in range(150):
        dr.backward(dr.mean(dr.square(pyramid.texture(optimizer).array - goal.array)))
        optimizer.step()
    assert np.abs(np.array(pyramid.texture(optimizer)) - np.array(goal)).mean() < 0.01


def test_what_is_no_texture_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        rt.LaplacianPyramid(T32.TensorXf(np.zeros((3, 3))))
    with pytest.raises(ValueError, match="1 to 3 levels"):
        rt.LaplacianPyramid(T32.TensorXf(np.zeros((3, 4, 1))), 4)
    with pytest.raises(ValueError, match="wrap_mode"):
        rt.LaplacianPyramid(T32.TensorXf(np.zeros((3, 4, 1))), wrap_mode="tile")
    with pytest.raises(ValueError, match="shape"):
        rt.total_variation(T32.TensorXf(np.zeros(3)))


@pytest.mark.parametrize("shape", [(6, 5, 3), (4, 7), (1, 5, 1), (1, 1, 3)])
def test_total_variation(shape: tuple[int, ...]) -> None:
    t = T64
    image = np.random.default_rng(4).random(shape)
    expected = sum(np.abs(d).mean() for d in (np.diff(image, axis=0), np.diff(image, axis=1)) if d.size)
    tensor = t.TensorXf(image)
    dr.enable_grad(tensor)
    value = rt.total_variation(tensor)
    assert value[0] == pytest.approx(expected)
    if max(shape[:2]) == 1:
        return
    dr.backward_from(value)
    step = np.random.default_rng(5).normal(size=shape) * 1e-7
    ends = [rt.total_variation(t.TensorXf(image + s * step))[0] for s in (-1, 1)]
    assert (np.array(dr.grad(tensor)) * step).sum() == pytest.approx((ends[1] - ends[0]) / 2, rel=1e-5)
    flat = dr.full(t.TensorXf, 0.5, shape=shape)
    dr.enable_grad(flat)
    dr.backward_from(rt.total_variation(flat))
    assert not np.any(dr.grad(flat))
