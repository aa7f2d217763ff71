"""Renders, and whole steps of an optimisation, in functions that Dr.Jit freezes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt
from raytrace2.types import types

UInt = types("float32").UInt
TEXELS = "floor.bsdf.reflectance.data"
#: Parameters that frozen functions may change: surfaces may not move.
STILL = ["texels, bilinear", "texels, ewa", "texels, exact", "colour", "alpha", "light", "camera"]


def opaque(number: int) -> Any:
    return dr.opaque(UInt, number)


def same(a: Any, b: Any) -> bool:
    return bool(np.array_equal(dr.detach(a).numpy(), dr.detach(b).numpy()))


class Optimisation:
    """A parameter, its optimiser and a target."""

    def __init__(self, key: str, filter: str | None, **things: Any) -> None:
        self.scene = scenes.load(**things)
        self.params = rt.traverse(self.scene)
        self.key, self.filter = key, filter
        self.latent = scenes.Latent(self.params, key)
        self.opt = dr.opt.Adam(lr=0.01, params={"x": self.latent.start})
        self.params[key] = self.latent.value(self.opt["x"])
        self.params.update()
        self.target = dr.detach(rt.render(self.scene, self.params, spp=2, filter=filter) * 0.5)
        dr.make_opaque(self.target)

    def arguments(self, seed: int) -> tuple[Any, ...]:
        return self.params, self.opt, self.latent.base, self.target, opaque(seed)

    def step(self, params: Any, opt: Any, base: Any, target: Any, seed: Any) -> Any:
        params[self.key] = self.latent.value(opt["x"])
        params.update()
        image = rt.render(params.scene, params, spp=2, seed=seed, filter=self.filter)
        loss = dr.mean(dr.square(image - target), axis=None)
        dr.backward(loss)
        opt.step()
        return dr.detach(loss)


@pytest.mark.parametrize("case", STILL)
def test_a_frozen_step_of_an_optimisation_is_that_step(case: str) -> None:
    frozen_one, other = (Optimisation(*scenes.CASES[case]) for _ in range(2))
    frozen = dr.freeze(frozen_one.step)
    for seed in range(6):
        a, b = frozen(*frozen_one.arguments(seed)), other.step(*other.arguments(seed))
        np.testing.assert_allclose(a.array.numpy(), b.array.numpy(), rtol=1e-5)
        # Atomic additions come in any order.
        np.testing.assert_allclose(frozen_one.opt["x"].numpy(), other.opt["x"].numpy(), rtol=1e-4, atol=1e-6)
    # Adam's counters are literals at first, then arrays.
    assert frozen.n_recordings <= 3
    for filter in (frozen_one.filter, "nearest"):
        images = [rt.render(x.scene, spp=1, filter=filter) for x in (frozen_one, other)]
        np.testing.assert_allclose(images[0].numpy(), images[1].numpy(), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "ldsampler"])
def test_a_frozen_render_is_that_render_to_the_bit(sampler: str, precision: str) -> None:
    sensor = {**scenes.scene_dict()["sensor"], "sampler": {"type": sampler, "sample_count": 4}}
    scene = scenes.load(sensor=sensor)
    params = rt.traverse(scene, precision)
    params[TEXELS] = params[TEXELS] * 0.5
    params.update()

    def view(params: Any, texels: Any, seed: Any) -> Any:
        params[TEXELS] = texels
        params.update()
        return rt.render(params.scene, params, seed=seed, spp=4, filter="ewa")

    first = type(params[TEXELS])(params[TEXELS])
    rt.render(scene, params, spp=4, filter="ewa")
    frozen = dr.freeze(view)
    for k in range(4):
        texels = first * (k + 1)
        dr.make_opaque(texels)
        image = frozen(params, texels, opaque(k))
        assert same(params[TEXELS], texels)
        assert same(image, rt.render(scene, params, seed=k, spp=4, filter="ewa"))
    assert frozen.n_recordings <= 2


def test_what_moves_between_calls_is_seen() -> None:
    keys = ["box.vertex_positions", "ball.to_world", "sensor.to_world", "lamp.intensity.value"]
    scene = scenes.load()
    params = rt.traverse(scene)
    latents = {key: scenes.Latent(params, key) for key in keys}
    for key, latent in latents.items():
        params[key] = latent.value(latent.start)
    params.update()

    def view(scene: Any, seed: Any) -> Any:
        return rt.render(scene, seed=seed)

    rt.render(scene)
    frozen = dr.freeze(view)
    for k in range(12):
        key = keys[k % len(keys)]
        latent = latents[key]
        params[key] = latent.value(latent.start + 0.02 * (k + 1))
        params.update()
        assert same(frozen(scene, opaque(k)), rt.render(scene, seed=k)), key
        if k == 7:
            before = frozen.n_recordings
    assert frozen.n_recordings == before


def test_a_frozen_function_cannot_move_surfaces() -> None:
    scene = scenes.load()
    params = rt.traverse(scene)
    key = "box.vertex_positions"
    params[key] = params[key] + 0
    params.update()
    rt.render(scene, params)

    @dr.freeze
    def view(params: Any, positions: Any) -> Any:
        params[key] = positions
        params.update()
        return rt.render(params.scene, params)

    with pytest.raises(RuntimeError) as caught:
        view(params, params[key] + 0.1)
    assert isinstance(caught.value.__cause__, rt.SettingError)
    assert "frozen can" in str(caught.value.__cause__)


def test_a_frozen_function_cannot_make_tables() -> None:
    scene = scenes.load()

    @dr.freeze
    def view(scene: Any, seed: Any) -> Any:
        return rt.render(scene, seed=seed, filter="trilinear")

    with pytest.raises(RuntimeError) as caught:
        view(scene, opaque(1))
    assert isinstance(caught.value.__cause__, rt.SettingError)
    rt.render(scene, filter="trilinear")
    assert same(view(scene, opaque(1)), rt.render(scene, seed=1, filter="trilinear"))


def test_a_seed_may_be_an_array() -> None:
    scene = scenes.load()
    assert same(rt.render(scene, seed=7), rt.render(scene, seed=UInt(7)))
    for bad in (types("float32").Float(1), UInt(1, 2), 1.5):
        with pytest.raises(rt.SettingError, match="seed"):
            rt.render(scene, seed=bad)


def test_other_functions_of_dr_jit_leave_scenes_alone() -> None:
    scene = scenes.load()
    params = rt.traverse(scene)
    rt.render(scene)
    dr.enable_grad(scene, params)
    assert not dr.grad_enabled(scene.traced().live_values())
    assert not dr.grad_enabled(params[TEXELS])


@pytest.mark.parametrize("setting", ["visibility_gradients", "deterministic"])
def test_what_frozen_functions_cannot_do(setting: str) -> None:
    scene = scenes.load()
    params = rt.traverse(scene)
    key = "box.vertex_positions"
    dr.enable_grad(params[key])
    params.update()
    rt.render(scene, params)

    @dr.freeze
    def view(params: Any) -> Any:
        return rt.render(params.scene, params, **{setting: True})

    with pytest.raises(RuntimeError) as caught:
        view(params)
    assert isinstance(caught.value.__cause__, rt.SettingError)


def test_frozen_functions_refuse_arrays_of_numpy() -> None:
    scene = scenes.load()
    params = rt.traverse(scene)
    params[TEXELS] = params[TEXELS] * 0.5
    params.update()
    rt.render(scene, params)

    @dr.freeze
    def view(params: Any) -> Any:
        params[TEXELS] = scenes.PIXELS
        params.update()
        return rt.render(params.scene, params)

    with pytest.raises(RuntimeError) as caught:
        view(params)
    assert "NumPy" in str(caught.value.__cause__)
