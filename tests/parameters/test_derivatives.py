"""Buffers that kernels read have the derivatives of what they follow from."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import parameter_scenes as scenes
import pytest

import raytrace2 as rt
from raytrace2.parameters.cameras import live_camera
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import types

T64 = types("float64")


def flat(value: Any) -> Any:
    """All numbers of buffers, in one row."""
    parts = value if isinstance(value, list | tuple) else [value]
    found = []
    for part in parts:
        if isinstance(part, list | tuple):
            found.append(flat(part))
        elif dr.is_float_v(part):
            found.append(T64.Float(dr.ravel(part)))
    return dr.concat(found) if found else T64.Float(0)


def buffers(scene: rt.Scene, filter: FilterSettings | None) -> Any:
    traced = scene.traced("brute_force", "float64", filter)
    values = []
    for slot, value in zip(traced.slots, traced.live_values(), strict=True):
        # How often samples are drawn has no derivatives; of an environment's texels it is the fourth word.
        if slot.attribute == "texels":
            value = dr.select(dr.arange(T64.UInt, dr.width(value)) % 4 == 3, 0, value)
        if slot.attribute not in ("chances", "areas", "rows", "columns"):
            values.append(value)
    for sensor, settings in enumerate(scene.cameras):
        slots = live_camera(scene, sensor, settings, T64)[1]
        values += [slot.made(scene.store.values(T64)) for slot in slots]
    return flat(values)


def check(scene: dict[str, Any], key: str, filter: FilterSettings | None = None) -> None:
    check_scene(rt.load_dict(scene), key, filter)


def check_scene(loaded: rt.Scene, key: str, filter: FilterSettings | None = None) -> None:
    params = rt.traverse(loaded, "float64")
    value = params[key]
    dr.enable_grad(value)
    params.update()
    found = buffers(loaded, filter)
    rng = np.random.default_rng(3)
    weights = T64.Float(rng.normal(size=dr.width(found)))
    dr.backward(dr.sum(found * weights))
    gradient = dr.grad(params[key]).numpy()
    gradient = np.array([[g] for g in gradient.ravel()]).reshape(gradient.shape)
    assert np.isfinite(gradient).all()
    before = params[key].numpy()
    direction = rng.normal(size=before.shape)
    if before.ndim == 3 and before.shape[:2] in ((4, 4), (3, 3)) and "data" not in key:
        direction[-1] = 0
    step = 1e-6
    ends = []
    for sign in (1, -1):
        moved = before + sign * step * direction
        params[key] = moved[..., 0] if "to_" in key else moved
        params.update()
        ends.append(buffers(loaded, filter).numpy() @ weights.numpy())
    numeric = (ends[0] - ends[1]) / (2 * step)
    analytic = float((gradient * direction).sum())
    assert analytic == pytest.approx(numeric, rel=2e-6, abs=2e-6 * (1 + np.abs(weights.numpy()).max()))
    assert abs(analytic) > 1e-9


def keys_of(scene: dict[str, Any]) -> list[str]:
    return list(rt.traverse(rt.load_dict(scene)).keys())


@pytest.mark.parametrize("key", keys_of(scenes.everything()))
def test_buffers_have_the_derivatives_of_what_they_follow_from(key: str) -> None:
    check(scenes.everything(), key)


def shining() -> dict[str, Any]:
    """Every shape that emits."""
    T = scenes.transforms()
    plain = {"type": "area", "radiance": scenes.rgb(1, 2, 3)}
    image = {"type": "area", "radiance": scenes.bitmap(scenes.COLOR)}
    return scenes.scene(
        square={"type": "rectangle", "light": plain, "to_world": T().scale([0.3, -0.2, 1])},
        round={"type": "disk", "light": image, "to_world": T().rotate([0.6, 0, 0.8], 50)},
        tube={"type": "cylinder", "light": plain, "radius": 0.3},
        ball={"type": "sphere", "light": image},
        box={"type": "cube", "light": image},
        edgy={"type": "cube", "face_normals": True, "flip_normals": True, "light": plain},
    )


SHINING = [k for k in keys_of(shining()) if k.endswith(("to_world", "positions", "vertex_normals", "texcoords"))]


@pytest.mark.parametrize("key", [k for k in SHINING if not k.startswith(("floor", "sensor"))])
def test_area_lights_follow_their_shapes(key: str) -> None:
    check(shining(), key)


@pytest.mark.parametrize("key", ["sky.data", "sky.scale", "sky.to_world"])
@pytest.mark.parametrize("width", [7, 8])
def test_environments_over_footprints(key: str, width: int) -> None:
    sky = {"type": "envmap", "bitmap": scenes.bitmap(scenes.SKY[:, :width])["bitmap"], "scale": 2.0}
    check(scenes.scene(sky=sky), key, FilterSettings("ewa"))


def reliefs(mode: str) -> dict[str, Any]:
    """A bump and a normal map."""
    stretched = scenes.transforms()().scale([2, 1.5, 1])
    bump = {"type": "bumpmap", "t": scenes.bitmap(scenes.COLOR, wrap_mode=mode, to_uv=stretched), "scale": 0.7}
    normal = {"type": "normalmap", "normalmap": scenes.bitmap(scenes.NORMALS, wrap_mode=mode)}
    grey = {"type": "diffuse"}
    return scenes.scene(
        a={"type": "cube", "bsdf": {**bump, "n": grey}}, c={"type": "cube", "bsdf": {**normal, "n": grey}}
    )


RELIEFS = [key for key in keys_of(reliefs("repeat")) if any(x in key for x in ("texture.", "normalmap", "scale"))]


@pytest.mark.parametrize("key", RELIEFS)
@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_moments_of_reliefs(key: str, mode: str) -> None:
    check(reliefs(mode), key, FilterSettings("ewa"))


def test_what_has_no_derivatives_is_refused_by_name() -> None:
    bump = {"type": "bumpmap", "t": scenes.bitmap(scenes.GREY, filter_type="nearest"), "n": {"type": "diffuse"}}
    scene = rt.load_dict(scenes.scene(box={"type": "cube", "bsdf": bump}))
    params = rt.traverse(scene)
    dr.enable_grad(params["box.bsdf.nested_texture.data"])
    params.update()
    with pytest.raises(rt.SettingError, match=r"box\.bsdf\.nested_texture\.data"):
        scene.traced().live_values()


def attributed(vertex: bool) -> rt.Scene:
    """A mesh whose colours are its own."""
    from dataclasses import replace

    from raytrace2.scene import description as d

    loaded = rt.load_dict(scenes.scene(box={"type": "cube"})).description
    mesh: Any = loaded.shapes[-1]
    name = "vertex_color" if vertex else "face_color"
    values = np.random.default_rng(5).random((len(mesh.vertices), 3) if vertex else (len(mesh.faces), 1))
    bsdf = d.DiffuseBsdf(d.MeshAttributeTexture(name, 0.5))
    mesh = replace(mesh, attributes={name: values}, bsdf=bsdf)
    return rt.Scene(replace(loaded, shapes=(*loaded.shapes[:-1], mesh), names=()))


@pytest.mark.parametrize("vertex", [False, True])
@pytest.mark.parametrize("last", ["color", "scale"])
def test_attributes_of_meshes(vertex: bool, last: str) -> None:
    scene = attributed(vertex)
    key = next(k for k in rt.traverse(scene).keys() if k.startswith("box") and k.endswith(last))
    check_scene(scene, key)
