"""Names and values of parameters are those of ``mi.traverse``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import parameter_scenes as scenes
import pytest

import raytrace2 as rt

# What chooses samples, places a shutter or sizes a film is no parameter here, and indices of faces stay.
NOT_OURS = (
    "sampling_weight", "shutter_", "near_clip", "far_clip", "film.", "faces", "allow_thread_reordering",
)  # fmt: skip


def theirs(scene: dict[str, Any]) -> dict[str, np.ndarray]:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    found = {}
    loaded = mi.load_dict(scene, optimize=False)
    for key, value in mi.traverse(loaded):
        if not any(word in key for word in NOT_OURS):
            # Names of attributes pick components of arrays.
            value = value if isinstance(value, dr.ArrayBase) else getattr(value, "matrix", value)
            found[key] = np.array(value, np.float64)
    return found


def test_every_parameter_of_mitsuba_is_one_here_with_its_value() -> None:
    scene = scenes.everything()
    known = theirs(scene)
    ours = rt.traverse(rt.load_dict(scene))
    assert sorted(known.keys() - ours.keys()) == []
    for key, value in known.items():
        mine = ours[key].numpy()
        if key == "sun.to_world":
            mine, value = mine[:3, 2], value.reshape(4, 4)[:3, 2]
        np.testing.assert_allclose(mine.ravel(), value.ravel(), rtol=2e-6, atol=2e-6, err_msg=key)


def test_what_is_a_parameter_only_here() -> None:
    scene = scenes.everything()
    more = rt.traverse(rt.load_dict(scene)).keys() - theirs(scene).keys()
    assert {key.rsplit(".", 2)[-2] for key in more} == {"specular_reflectance", "specular_transmittance"}


def test_names_of_the_documentation() -> None:
    scene = rt.load_string(
        """<scene version="3.0.0">
        <bsdf type="diffuse" id="mat"><rgb name="reflectance" value=".1 .2 .3"/></bsdf>
        <shape type="sphere" id="ball"><ref id="mat"/></shape>
        <shape type="cube" id="mesh"><ref id="mat"/></shape>
        <emitter type="point" id="light"/>
        <sensor type="perspective" id="sensor"/>
        </scene>"""
    )
    assert list(rt.traverse(scene).keys()) == [
        "mat.reflectance.value", "ball.to_world", "mesh.vertex_positions", "mesh.vertex_normals",
        "mesh.vertex_texcoords", "light.position", "light.intensity.value", "sensor.x_fov",
        "sensor.principal_point_offset_x", "sensor.principal_point_offset_y", "sensor.to_world",
    ]  # fmt: skip


def test_a_byte_image_is_given_as_linear_numbers() -> None:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    bitmap = mi.Bitmap(np.array([[[0, 128, 255]]], np.uint8))
    bitmap.set_srgb_gamma(True)
    image = {"type": "bitmap", "bitmap": bitmap}
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": image}}
    value = rt.traverse(rt.load_dict(scenes.scene(floor=floor)))["floor.bsdf.reflectance.data"]
    np.testing.assert_allclose(value.numpy().ravel(), [0, 0.2158605, 1], rtol=1e-6)


def test_the_mapping() -> None:
    params = rt.traverse(rt.load_dict(scenes.scene()))
    assert len(params) == len(list(params)) == len(params.keys()) == len(params.values())
    assert all(key in params for key, _ in params.items())
    text = repr(params)
    assert "floor.bsdf.reflectance.data" in text and "TensorXf" in text and "∂, D" in text
    params.keep([r".*\.intensity", "floor"])
    assert list(params.keys()) == [
        "floor.bsdf.reflectance.data", "floor.bsdf.reflectance.to_uv", "floor.to_world", "lamp.intensity.value",
    ]  # fmt: skip
    other = params.copy()
    del other["floor.to_world"]
    assert "floor.to_world" in params and "floor.to_world" not in other
    assert params.flags("floor.to_world") == "D" and params.flags("lamp.intensity.value") == ""


def test_a_wrong_name_tells_of_near_ones() -> None:
    params = rt.traverse(rt.load_dict(scenes.scene()))
    with pytest.raises(KeyError, match=r"lamp\.intensity\.value"):
        params["lamp.intensity"]
    with pytest.raises(KeyError, match="floor.to_world"):
        params["floor.toworld"] = 1
    with pytest.raises(TypeError, match="traverse takes a Scene"):
        rt.traverse({})  # type: ignore[arg-type]
