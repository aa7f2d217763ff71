"""Renders within steps of other frameworks, where these are installed."""

from __future__ import annotations

import gc
from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt

KEY = "floor.bsdf.reflectance.data"
START = np.random.default_rng(2).normal(size=scenes.PIXELS.shape).astype(np.float32)
HOW: dict[str, Any] = {"spp": 4, "filter": "ewa"}


def by_dr_jit_alone() -> tuple[float, np.ndarray]:
    """The loss, and its gradient by what a sigmoid takes to the texels."""
    scene = scenes.load()
    params = rt.traverse(scene)
    x = type(params[KEY])(START)
    dr.enable_grad(x)
    params[KEY] = 1 / (1 + dr.exp(-x))
    params.update()
    loss = dr.mean(dr.square(rt.render(scene, params, **HOW) - 0.2), axis=None)
    dr.backward(loss)
    return float(loss.array[0]), dr.grad(x).numpy()


def test_a_render_within_a_step_of_pytorch() -> None:
    torch = pytest.importorskip("torch")
    scene = scenes.load()
    params = rt.traverse(scene)

    @dr.wrap(source="torch", target="drjit")
    def image(texels: Any) -> Any:
        params[KEY] = texels
        params.update()
        return rt.render(scene, params, **HOW)

    x = torch.tensor(START, requires_grad=True)
    optimiser = torch.optim.SGD([x], lr=10.0)
    losses = []
    for _ in range(3):
        optimiser.zero_grad()
        loss = torch.mean((image(torch.sigmoid(x)) - 0.2) ** 2)
        loss.backward()
        losses.append((float(loss), x.grad.numpy().copy()))
        optimiser.step()
    value, gradient = by_dr_jit_alone()
    assert losses[0][0] == pytest.approx(value, rel=1e-5)
    np.testing.assert_allclose(losses[0][1], gradient, rtol=1e-3, atol=1e-5 * np.abs(gradient).max())
    assert losses[2][0] < losses[0][0]


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    "key", ["sensor.to_world", "box.vertex_positions", "lamp.intensity.value", "ball.bsdf.alpha.value", KEY]
)
def test_gradients_of_tensors_of_pytorch(key: str, precision: str) -> None:
    torch = pytest.importorskip("torch")

    def target(image: Any) -> Any:
        return (image - 0.2) ** 2

    scene = scenes.load()
    params = rt.traverse(scene, precision)
    value = params[key]
    start = np.array(value.numpy())[..., 0] if dr.is_matrix_v(value) else np.array(value.numpy())
    x = torch.tensor(start, requires_grad=True)
    image = picture(params, key, **HOW)(x)
    assert image.dtype == x.dtype == getattr(torch, precision)
    target(image).mean().backward()

    scene = scenes.load()
    params = rt.traverse(scene, precision)
    dr.enable_grad(params[key])
    dr.backward(dr.mean(target(rt.render(scene, params, **HOW)), axis=None))
    expected = np.array(dr.grad(params[key]).numpy()).reshape(start.shape)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(x.grad.numpy(), expected, atol=1e-5 * np.abs(expected).max())


def picture(params: rt.SceneParameters, key: str, **how: Any) -> Any:
    """A function of PyTorch's: the image for a value of the parameter ``key``."""

    @dr.wrap(source="torch", target="drjit")
    def image(value: Any) -> Any:
        params[key] = value
        params.update()
        return rt.render(params.scene, params, **how)

    return image


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_an_optimiser_of_pytorch_finds_texels(precision: str) -> None:
    torch = pytest.importorskip("torch")
    params = rt.traverse(scenes.load(), precision)
    image = picture(params, KEY, spp=8, seed=1, seed_grad=1, filter="bilinear")
    with torch.no_grad():
        truth = image(torch.tensor(np.array(params[KEY].numpy())))
    x = torch.full(params[KEY].shape, 0.5, dtype=truth.dtype, requires_grad=True)
    optimiser, losses = torch.optim.Adam([x], lr=0.05), []
    for _ in range(40):
        optimiser.zero_grad()
        loss = torch.mean((image(x) - truth) ** 2)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.02 * losses[0]


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_an_optimiser_of_pytorch_finds_a_pose(precision: str) -> None:
    """From depth, by what moves a matrix in PyTorch."""
    torch = pytest.importorskip("torch")
    params, key = rt.traverse(scenes.load(), precision), "sensor.to_world"
    image = picture(params, key, spp=4, seed=1, seed_grad=1, integrator="aov:depth")
    base = torch.tensor(np.array(params[key].numpy())[..., 0])
    with torch.no_grad():
        truth = image(base)
    moved = torch.tensor([0.1, -0.1, 0.15], dtype=base.dtype, requires_grad=True)
    optimiser = torch.optim.Adam([moved], lr=0.02)
    for _ in range(40):
        optimiser.zero_grad()
        matrix = base.clone()
        matrix[:3, 3] += moved
        apart = image(matrix) - truth
        # Pixels across an edge say nothing of how far off the camera is.
        torch.mean(torch.where(apart.abs() < 0.3, apart**2, torch.zeros_like(apart))).backward()
        optimiser.step()
    assert float(moved.detach().abs().max()) < 0.01


def test_memory_that_pytorch_writes_into_is_not_the_scenes() -> None:
    """Optimisers write into their tensors, and tensors go."""
    torch = pytest.importorskip("torch")
    key, found = "ball.bsdf.alpha.value", []
    for disturbed in (False, True):
        params = rt.traverse(scenes.load())
        x = torch.tensor([0.3], requires_grad=True)
        y = x * 1
        loss = torch.mean((picture(params, key, **HOW)(y) - 0.2) ** 2)
        if disturbed:
            with torch.no_grad():
                y.mul_(2)
        del y
        gc.collect()
        loss.backward()
        found.append((float(x.grad), rt.render(params.scene).numpy()))
        del x, loss
        gc.collect()
        assert np.array_equal(rt.render(params.scene).numpy(), found[-1][1])
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-5)
    assert np.array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize(("framework", "module"), [("torch", "torch"), ("jax", "jax.numpy")])
def test_a_loss_of_another_framework(framework: str, module: str) -> None:
    other = pytest.importorskip(module)
    scene = scenes.load()
    params = rt.traverse(scene)

    @dr.wrap(source="drjit", target=framework)
    def loss_of(image: Any) -> Any:
        return other.mean((image - 0.2) ** 2)

    x = type(params[KEY])(START)
    dr.enable_grad(x)
    params[KEY] = 1 / (1 + dr.exp(-x))
    params.update()
    loss = loss_of(rt.render(scene, params, **HOW))
    dr.backward(loss)
    value, gradient = by_dr_jit_alone()
    assert float(np.asarray(loss.array.numpy()).ravel()[0]) == pytest.approx(value, rel=1e-5)
    np.testing.assert_allclose(dr.grad(x).numpy(), gradient, rtol=1e-3, atol=1e-5 * np.abs(gradient).max())
