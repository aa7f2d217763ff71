"""Renders within steps of other frameworks, where these are installed."""

from __future__ import annotations

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


def test_a_loss_of_jax_of_a_render() -> None:
    jnp = pytest.importorskip("jax.numpy")
    scene = scenes.load()
    params = rt.traverse(scene)

    @dr.wrap(source="drjit", target="jax")
    def loss_of(image: Any) -> Any:
        return jnp.mean((image - 0.2) ** 2)

    x = type(params[KEY])(START)
    dr.enable_grad(x)
    params[KEY] = 1 / (1 + dr.exp(-x))
    params.update()
    loss = loss_of(rt.render(scene, params, **HOW))
    dr.backward(loss)
    value, gradient = by_dr_jit_alone()
    assert float(np.asarray(loss.array.numpy()).ravel()[0]) == pytest.approx(value, rel=1e-5)
    np.testing.assert_allclose(dr.grad(x).numpy(), gradient, rtol=1e-3, atol=1e-5 * np.abs(gradient).max())
