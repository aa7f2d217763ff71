"""What users do with differentiable renders besides one render and one backward pass."""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import gradient_scenes as scenes
import numpy as np
import pytest

import raytrace2 as rt

TEXELS = "floor.bsdf.reflectance.data"


def start(key: str = TEXELS, precision: str = "float32", **things: Any) -> tuple[rt.Scene, rt.SceneParameters]:
    scene = scenes.load(**things)
    params = rt.traverse(scene, precision)
    dr.enable_grad(params[key])
    params.update()
    return scene, params


def loss(image: Any) -> Any:
    return dr.sum(dr.square(image), axis=None)


def gradient(params: rt.SceneParameters, key: str = TEXELS) -> np.ndarray:
    return np.array(dr.grad(params[key]).numpy())


def alone(key: str = TEXELS, things: dict[str, Any] | None = None, **how: Any) -> np.ndarray:
    """The gradient of the loss of one render."""
    scene, params = start(key, **(things or {}))
    dr.backward(loss(rt.render(scene, params, **how)))
    return gradient(params, key)


def close(a: np.ndarray, b: np.ndarray) -> bool:
    assert np.abs(b).max() > 0
    return bool(np.abs(a - b).max() <= 1e-5 * np.abs(b).max())


def two_cameras() -> dict[str, Any]:
    """A second camera."""
    to_world = scenes.transforms()().look_at([2, -2, 2], [0, 0, 0], [0, 0, 1])
    return {"other": {**scenes.scene_dict()["sensor"], "to_world": to_world}}


def film(**settings: Any) -> dict[str, Any]:
    """A film with these settings."""
    sensor = scenes.scene_dict()["sensor"]
    return {"sensor": {**sensor, "film": {**sensor["film"], **settings}}}


def test_gradients_add_up() -> None:
    expected = alone(spp=2, seed=1) + alone(spp=2, seed=2)
    scene, params = start()
    for seed in (1, 2):
        dr.backward(loss(rt.render(scene, params, spp=2, seed=seed)))
    assert close(gradient(params), expected)
    scene, params = start()
    first, second = (rt.render(scene, params, spp=2, seed=seed) for seed in (1, 2))
    dr.backward(loss(first) + loss(second))
    assert close(gradient(params), expected)


def test_a_backward_pass_can_be_done_again() -> None:
    expected = alone(spp=2)
    scene, params = start()
    total = loss(rt.render(scene, params, spp=2))
    dr.backward(total, flags=dr.ADFlag.ClearInterior)
    dr.backward(total)
    assert close(gradient(params), 2 * expected)


def test_cameras_add_up() -> None:
    things = two_cameras()
    expected = alone(things=things, spp=2) + alone(things=things, spp=2, sensor=1)
    scene, params = start(**things)
    first, second = (rt.render(scene, params, spp=2, sensor=k) for k in (0, 1))
    dr.backward(loss(first) + loss(second))
    assert close(gradient(params), expected)


def test_another_cameras_place_has_no_gradient() -> None:
    scene, params = start("other.to_world", **two_cameras())
    dr.backward(loss(rt.render(scene, params)))
    assert not gradient(params, "other.to_world").any()
    image = rt.render(scene, params)
    dr.forward(params["other.to_world"])
    assert not dr.grad(image).numpy().any()


@pytest.mark.parametrize("key", ["behind.bsdf.reflectance.value", "behind.to_world"])
def test_what_is_out_of_view_has_no_gradient(key: str) -> None:
    behind = {
        "type": "rectangle",
        "to_world": scenes.transforms()().translate([0, 0, -50]),
        "bsdf": {"type": "diffuse"},
    }
    assert not alone(key, {"behind": behind}).any()


@pytest.mark.parametrize("key", [TEXELS, "box.vertex_positions", "ball.to_world", "sensor.to_world"])
def test_derivatives_are_those_of_the_scene_that_was_rendered(key: str) -> None:
    """It may change before they are asked for."""
    expected = alone(key, spp=8, seed=3)
    scene, params = start(key)
    before = params[key]
    image = rt.render(scene, params, spp=8, seed=3)
    for other in (key, "lamp.intensity.value", "box.vertex_positions", "sensor.to_world"):
        latent = scenes.Latent(params, other)
        params[other] = latent.value(dr.detach(latent.start) * 1.1 + 0.2)
        params.update()
        rt.render(scene)
    after = rt.render(scene, spp=2).numpy()
    dr.backward(loss(image))
    assert close(np.array(dr.grad(before).numpy()), expected)
    assert np.array_equal(rt.render(scene, spp=2).numpy(), after)


def test_samples_of_the_gradient_are_its_own() -> None:
    found = []
    for spp, seed in ((2, 1), (5, 4)):
        scene, params = start()
        dr.backward(dr.sum(rt.render(scene, params, spp=spp, seed=seed, spp_grad=4, seed_grad=9), axis=None))
        found.append(gradient(params))
    assert close(*found)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"filter": {"type": "gaussian"}},
        {"crop_width": 4, "crop_height": 3, "crop_offset_x": 2, "crop_offset_y": 4},
        {"pixel_format": "luminance"},
        {"pixel_format": "luminance", "filter": {"type": "gaussian"}, "crop_width": 4, "sample_border": True},
    ],
    ids=["box", "gaussian", "crop", "luminance", "all"],
)
def test_both_modes_agree(settings: dict[str, Any], precision: str) -> None:
    things = film(**settings)
    scene, params = start(precision=precision, **things)
    how: dict[str, Any] = {"spp": 4, "seed": 3, "seed_grad": 3}
    image = rt.render(scene, params, **how)
    weights = np.random.default_rng(1).random(image.shape)
    dr.backward(dr.sum(image * type(image)(weights), axis=None))
    backward = gradient(params).sum()
    assert gradient(params).dtype == precision
    for into in (False, True):
        scene, params = start(precision=precision, **things)
        image = rt.render(scene, params, **how)
        if into:
            dr.set_grad(params[TEXELS], 1)
            tangent = dr.forward_to(image).numpy()
        else:
            dr.forward(params[TEXELS])
            tangent = dr.grad(image).numpy()
        assert (tangent * weights).sum() == pytest.approx(backward, rel=1e-5)


def test_passes_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = alone("ball.to_world", spp=8)
    module = sys.modules["raytrace2.render"]
    for function in (module._choices, module.render_detailed):  # type: ignore[attr-defined]
        monkeypatch.setitem(function.__kwdefaults__, "max_lanes", 100)
    assert close(alone("ball.to_world", spp=8), expected)


def test_only_parameters_that_are_kept_count() -> None:
    scene, params = start()
    params.keep([TEXELS])
    assert dr.grad_enabled(rt.render(scene, params))
    scene, params = start()
    params.keep(["lamp"])
    assert not dr.grad_enabled(rt.render(scene, params))


def test_renders_without_derivatives() -> None:
    scene, params = start()
    with dr.suspend_grad():
        assert not dr.grad_enabled(rt.render(scene, params))
    assert not dr.grad_enabled(rt.render(scene))


@pytest.mark.parametrize("depth", [0, 1, 2])
def test_no_path_is_too_long_for_its_own_bound(depth: int, recwarn: pytest.WarningsRecorder) -> None:
    scene, params = start(integrator={"type": "path", "max_depth": depth})
    dr.backward(loss(rt.render(scene, params)))
    assert not [str(warning.message) for warning in recwarn]
    assert gradient(params).any() == (depth > 1)


def test_paths_that_are_too_long_are_told() -> None:
    around = {"type": "sphere", "radius": 9.0, "flip_normals": True, "bsdf": {"type": "diffuse", "reflectance": 1.0}}
    parts = {name: scenes.scene_dict()[name] for name in ("type", "sensor", "lamp")}
    endless = {"type": "path", "max_depth": -1, "rr_depth": 1000}
    scene = rt.load_dict({**parts, "around": around, "integrator": endless})
    params = rt.traverse(scene)
    dr.enable_grad(params["around.bsdf.reflectance.value"])
    with pytest.warns(RuntimeWarning, match="paths were longer than 256 bounces"):
        dr.backward(loss(rt.render(scene, params, spp=1)))


def test_what_is_refused() -> None:
    scene, params = start()
    for wrong in (start()[1], {TEXELS: params[TEXELS]}):
        with pytest.raises(rt.SettingError, match="params"):
            rt.render(scene, wrong)  # type: ignore[arg-type]
