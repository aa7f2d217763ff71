"""Parameters that are given as other arrays than they are kept as: derivatives stay, and memory is their own."""

from __future__ import annotations

from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt
from raytrace2.types import types

HOW: dict[str, Any] = {"spp": 4, "filter": "ewa"}
KEYS = [
    "floor.bsdf.reflectance.data", "box.bsdf.reflectance.value", "ball.bsdf.alpha.value", "lamp.intensity.value",
    "lamp.position", "box.vertex_positions", "ball.to_world", "sensor.to_world",
]  # fmt: skip


def start(params: rt.SceneParameters, key: str) -> np.ndarray:
    """The parameter as other frameworks write it."""
    value = params[key]
    array = np.array(value.numpy())
    if dr.is_matrix_v(value):
        return array[..., 0]
    return array.reshape(-1, 3) if key.endswith("positions") else array


def gradient(key: str, given: Any, precision: str) -> np.ndarray:
    """That of a loss by ``given(start)``."""
    scene = scenes.load()
    params = rt.traverse(scene, precision)
    x = given(params, start(params, key))
    dr.enable_grad(x)
    params[key] = x
    params.update()
    dr.backward(dr.mean(dr.square(rt.render(scene, params, **HOW) - 0.2), axis=None))
    found = np.array(dr.grad(x).numpy())
    return (found[..., 0] if dr.is_matrix_v(x) else found).ravel()


def close(a: np.ndarray, b: np.ndarray) -> bool:
    assert np.abs(b).max() > 0
    return bool(np.abs(a - b).max() <= 1e-5 * np.abs(b).max())


@pytest.mark.parametrize("key", KEYS)
def test_tensors_keep_their_derivatives(key: str) -> None:
    expected = gradient(key, lambda params, _: dr.detach(type(params[key])(params[key])), "float32")
    found = gradient(key, lambda params, array: params.types.TensorXf(array.astype(np.float32)), "float32")
    assert close(found, expected)
    # Of another precision than the parameters.
    wide = gradient(key, lambda params, array: types("float64").TensorXf(array.astype(np.float64)), "float32")
    assert close(wide, expected)


def test_arrays_keep_their_derivatives() -> None:
    key = "box.vertex_positions"
    expected = gradient(key, lambda params, array: params.types.Float(array.ravel()), "float32")
    found = gradient(key, lambda params, array: params.types.Array3f(array.T), "float32")
    assert close(found.reshape(3, -1).T.ravel(), expected)
    key = "lamp.intensity.value"
    expected = gradient(key, lambda params, array: params.types.Array3f(array.ravel()), "float32")
    found = gradient(key, lambda params, array: params.types.Float(array.ravel()), "float32")
    assert close(found, expected)


def test_what_would_lose_derivatives_is_refused() -> None:
    params = rt.traverse(scenes.load())
    for key, shape in (("sensor.to_world", (1, 4, 4)), ("floor.bsdf.reflectance.data", (42,))):
        x = dr.ones(params.types.Float, int(np.prod(shape)))
        dr.enable_grad(x)
        given = params.types.TensorXf(x, shape) if len(shape) > 1 else x
        with pytest.raises(rt.SettingError, match=f"{key} must be .* derivatives"):
            params[key] = given


@pytest.mark.parametrize("key", KEYS)
def test_derivatives_of_other_frameworks_are_refused_by_name(key: str) -> None:
    class Tensor:
        """As PyTorch's, which gives no array while it carries derivatives."""

        def __array__(self, *_: Any, **__: Any) -> np.ndarray:
            raise RuntimeError("Can't call numpy() on Tensor that requires grad.")

    params = rt.traverse(scenes.load())
    with pytest.raises(rt.SettingError, match=f"{key}: a Tensor loses its derivatives here: .* dr.wrap"):
        params[key] = Tensor()


@pytest.mark.parametrize("key", ["floor.bsdf.reflectance.data", "box.vertex_positions"])
def test_the_memory_of_a_parameter_is_its_own(key: str) -> None:
    """Dr.Jit shares that of NumPy's arrays."""
    scene = scenes.load()
    params = rt.traverse(scene)
    expected = rt.render(scene).numpy()
    array = np.ascontiguousarray(start(params, key).astype(np.float32))
    params[key] = params.types.TensorXf(array)
    params.update()
    np.testing.assert_array_equal(rt.render(scene).numpy(), expected)
    array *= 1.5
    np.testing.assert_array_equal(rt.render(scene).numpy(), expected)


def test_the_same_array_again_changes_nothing() -> None:
    params = rt.traverse(scenes.load())
    other = params.copy()
    key = "box.vertex_positions"
    x = params[key] * 1.1
    dr.eval(x)
    for expected in ([key], []):
        params[key] = x
        assert params.update() == expected
    other[key] = x * 1.1
    other.update()
    params[key] = x
    assert params.update() == [key]
