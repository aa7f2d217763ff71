"""Steps of an optimisation, one after another: kernels, memory, and the order of sums."""

from __future__ import annotations

from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt


def step(params: rt.SceneParameters, opt: Any, latent: scenes.Latent, filter: str | None, seed: int) -> None:
    params[latent.key] = latent.value(opt["x"])
    params.update()
    image = rt.render(params.scene, params, seed=seed, filter=filter, size=(6, 5))
    dr.backward(dr.mean(dr.square(image - 0.1), axis=None))
    opt.step()


@pytest.mark.parametrize("case", scenes.CASES)
def test_later_steps_compile_nothing_and_keep_nothing(case: str) -> None:
    key, filter = scenes.CASES[case]
    params = rt.traverse(scenes.load())
    latent = scenes.Latent(params, key)
    opt = dr.opt.Adam(lr=1e-4, params={"x": latent.start})
    held = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for seed in range(6):
            dr.kernel_history_clear()
            step(params, opt, latent, filter, seed)
            kernels = dr.kernel_history([dr.KernelType.JIT])
            if seed >= 2:
                assert all(k["cache_hit"] and not k["cache_disk"] for k in kernels), seed
            dr.sync_thread()
            held.append(len(dr.whos(as_string=True).splitlines()))
    assert held[-1] == held[-2] == held[-3]


@pytest.mark.parametrize("case", ["texels, ewa", "vertices", "sphere", "light"])
def test_deterministic_gradients_are_the_same_to_the_bit(case: str) -> None:
    key, filter = scenes.CASES[case]
    scene = scenes.load()
    params = rt.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    found = []
    for deterministic in [True] * 4 + [False]:
        dr.set_grad(params[key], 0)
        image = rt.render(scene, params, spp=8, filter=filter, size=(60, 48), deterministic=deterministic)
        dr.backward(dr.sum(dr.square(image), axis=None))
        found.append(dr.grad(params[key]).numpy().copy())
    assert all(np.array_equal(found[0], other) for other in found[1:4])
    assert np.abs(found[4] - found[0]).max() <= 1e-4 * np.abs(found[0]).max()
    assert np.abs(found[0]).max() > 0
    tangents = []
    for deterministic in (True, False):
        image = rt.render(scene, params, filter=filter, deterministic=deterministic)
        dr.forward(params[key])
        tangents.append(dr.grad(image).numpy())
    np.testing.assert_allclose(*tangents, rtol=1e-3, atol=1e-5 * np.abs(tangents[1]).max())
