"""A scene whose parameters were changed is the scene that has the new values from the start."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import parameter_scenes as scenes
import pytest

import raytrace2 as rt
from raytrace2.types import types


def rendered(scene: rt.Scene, precision: str = "float32", **settings: Any) -> np.ndarray:
    image: np.ndarray = rt.render(scene, spp=4, precision=precision, **settings).numpy()
    return image


def check(changes: dict[str, Any], after: dict[str, Any], precision: str = "float32", **settings: Any) -> None:
    """``changes`` of the scene that has things of the names in ``after`` make it that with ``after``."""
    before, wanted = after.pop("before"), scenes.scene(**after)
    scene = rt.load_dict(scenes.scene(**before))
    first = rendered(scene, precision, **settings)
    params = rt.traverse(scene, precision)
    for key, value in changes.items():
        params[key] = value
    assert sorted(params.update()) == sorted(changes)
    image = rendered(scene, precision, **settings)
    assert np.abs(image - first).max() > 1e-3
    expected = rendered(rt.load_dict(wanted), precision, **settings)
    # A ray here and there takes another way where values round otherwise.
    close = np.isclose(image, expected, rtol=1e-5, atol=1e-6)
    assert close.mean() > 0.995


def diffuse(value: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": value}


def ball(T: Any, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "to_world": T().translate([0, 0, 0.5]).scale(0.5), **more}


def cases() -> dict[str, Any]:
    """By name: before, changes, after."""
    T = scenes.transforms()
    other = 1 - scenes.COLOR
    moved = T().translate([0.4, 0.1, 0.6]).rotate([0, 0, 1], 30).scale(0.4)
    look = T().look_at([1, -2.5, 1.5], [0, 0, 0.3], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 18, "filter": {"type": "box"}}
    area = {"type": "area", "radiance": scenes.rgb(3, 2, 1)}
    cube = T().translate([0, 0, 0.5]).scale(0.3)

    def camera(kind: str = "perspective", **more: Any) -> dict[str, Any]:
        return {"type": kind, "film": film, "to_world": look} | ({} if kind == "orthographic" else {"fov": 50}) | more

    def same(name: str, make: Any, old: Any, key: str, new: Any, value: Any = None) -> tuple[Any, Any, Any]:
        return {name: make(old)}, {key: new if value is None else value}, {name: make(new)}

    def lamp(kind: str, **more: Any) -> Any:
        return lambda pair: {"type": kind, **more, pair[0]: pair[1]}

    found = {
        "colour": same("b", lambda c: ball(T, m=diffuse(scenes.rgb(*c))), [0.1, 0.2, 0.3], "b.bsdf.reflectance.value",
                       [0.5, 0.4, 0.8]),
        "grey": same("b", lambda c: ball(T, m=diffuse(c)), 0.1, "b.bsdf.reflectance.value", 0.8),
        "image": same("floor", lambda i: {"type": "rectangle", "to_world": T().scale([3, 3, 1]),
                                          "m": diffuse(scenes.bitmap(i))},
                      scenes.COLOR, "floor.bsdf.reflectance.data", other),
        "uv": same("floor", lambda s: {"type": "rectangle", "to_world": T().scale([3, 3, 1]),
                                       "m": diffuse(scenes.bitmap(scenes.COLOR, to_uv=T().scale(s)))},
                   [1, 1, 1], "floor.bsdf.reflectance.to_uv", [2, 3, 1], np.diag([2.0, 3, 1])),
        "board": same("b", lambda c: ball(T, m=diffuse({"type": "checkerboard", "color0": c,
                                                        "to_uv": T().scale([9, 9, 1])})),
                      0.1, "b.bsdf.reflectance.color0.value", 0.7),
        "roughness": same("b", lambda a: ball(T, m={"type": "roughconductor", "alpha": a}), 0.1, "b.bsdf.alpha.value",
                          0.4),
        "metal": same("b", lambda a: ball(T, m={"type": "conductor", "eta": a[0], "k": a[1]}), [0.0, 1.0],
                      "b.bsdf.eta.value", [0.5, 1.0], 0.5),
        "glass": same("b", lambda n: ball(T, m={"type": "dielectric", "int_ior": n, "ext_ior": 1.0}), 1.1, "b.bsdf.eta",
                      1.7),
        "white": same("b", lambda n: ball(T, m={"type": "dielectric", "specular_transmittance": n}), 1.0,
                      "b.bsdf.specular_transmittance.value", 0.5),
        "mask": same("b", lambda a: ball(T, m={"type": "mask", "opacity": a, "n": diffuse(0.5)}), 0.5,
                     "b.bsdf.opacity.value", 0.9),
        "bump": same("b", lambda s: ball(T, m={"type": "bumpmap", "scale": s, "n": diffuse(0.5),
                                               "t": scenes.bitmap(scenes.GREY)}), 1.0, "b.bsdf.scale", 0.2),
        "place": same("b", lambda m: {"type": "sphere", "to_world": m, "m": diffuse(0.5)},
                      T().translate([0, 0, 0.5]).scale(0.5), "b.to_world", moved),
        "shining place": same("b", lambda m: {"type": "sphere", "to_world": m, "m": diffuse(0.5), "e": area},
                              T().translate([0, 0, 0.5]).scale(0.3), "b.to_world", moved),
        "point": same("lamp", lamp("point", intensity=4.0), ["position", [0, 0, 3]], "lamp.position",
                      ["position", [1, 1, 2]], [1, 1, 2]),
        "intensity": same("lamp", lamp("point", position=[0, 0, 3]), ["intensity", scenes.rgb(1, 2, 3)],
                          "lamp.intensity.value", ["intensity", scenes.rgb(3, 2, 1)], [3, 2, 1]),
        "sun": same("lamp", lamp("directional"), ["to_world", T().rotate([1, 0, 0], 170)], "lamp.to_world",
                    ["to_world", T().rotate([1, 0, 0], 130)], T().rotate([1, 0, 0], 130)),
        "spot": same("lamp", lamp("spot", intensity=5.0),
                     ["to_world", T().translate([0, 0, 3]).rotate([1, 0, 0], 180)], "lamp.to_world",
                     ["to_world", T().translate([1, 0, 3]).rotate([1, 0, 0], 170)],
                     T().translate([1, 0, 3]).rotate([1, 0, 0], 170)),
        "constant": same("lamp", lamp("constant"), ["radiance", scenes.rgb(1, 2, 3)], "lamp.radiance.value",
                         ["radiance", scenes.rgb(3, 2, 1)], [3, 2, 1]),
        "sky": same("lamp", lamp("envmap", bitmap=scenes.bitmap(scenes.SKY)["bitmap"]), ["scale", 1.0], "lamp.scale",
                    ["scale", 0.3], 0.3),
        "sky image": same("lamp", lambda i: {"type": "envmap", "bitmap": scenes.bitmap(i)["bitmap"]}, scenes.SKY,
                          "lamp.data", scenes.SKY[::-1], np.pad(scenes.SKY[::-1], ((0, 0), (1, 1), (0, 0)))),
        "camera": same("sensor", lambda m: camera(to_world=m), look @ T().translate([0, 0, -1]), "sensor.to_world",
                       look),
        "view": same("sensor", lambda f: camera(fov=f), 50, "sensor.x_fov", 30),
        "flat camera": same("sensor", lambda m: camera("orthographic", to_world=m), look, "sensor.to_world",
                            look @ T().scale([2, 2, 1])),
        "focus": same("sensor", lambda d: camera("thinlens", aperture_radius=0.2, focus_distance=d), 2.0,
                      "sensor.focus_distance", 5.0),
        "mesh": same("b", lambda m: {"type": "cube", "to_world": m, "face_normals": True}, T(), "b.vertex_positions",
                     cube),
    }  # fmt: skip
    corners = np.array(rt.load_dict(scenes.scene(b=found["mesh"][2]["b"])).description.shapes[-1].vertices)  # type: ignore[attr-defined]
    found["mesh"][1]["b.vertex_positions"] = corners.ravel()
    return found


CASES = list(cases())


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", CASES)
def test_a_changed_scene_is_the_other_scene(name: str, precision: str) -> None:
    before, changes, after = cases()[name]
    check(changes, {**after, "before": before}, precision)


@pytest.mark.parametrize("filter", ["nearest", "trilinear", "ewa", "exact"])
def test_every_filter_reads_the_new_image(filter: str) -> None:
    before, changes, after = cases()["image"]
    check(changes, {**after, "before": before}, filter=filter)


@pytest.mark.parametrize("accel", ["brute_force", "bvh:width=8", "bounding_volumes", "kdtree", "bsp", "grid"])
def test_every_structure_meets_what_has_moved(accel: str) -> None:
    before, changes, after = cases()["place"]
    check(changes, {**after, "before": before}, accel=accel)


def groups(to_world: Any, radius: float) -> dict[str, Any]:
    group = {"type": "shapegroup", "inner": {"type": "sphere", "radius": radius, "bsdf": diffuse(0.9)}}
    return {"g": group, "i": {"type": "instance", "to_world": to_world, "of": {"type": "ref", "id": "g"}}}


def test_instances_and_what_is_in_them() -> None:
    T = scenes.transforms()
    old, new = T().translate([0, 0, 0.5]), T().translate([0.5, 0, 0.7])
    check({"i.to_world": new}, {**groups(new, 0.5), "before": groups(old, 0.5)})
    check({"g.inner.to_world": T().scale(0.3)}, {**groups(old, 0.3), "before": groups(old, 0.5)})


def test_rays_meet_what_has_moved() -> None:
    T = scenes.transforms()
    scene = rt.load_dict(scenes.scene(b=ball(T)))
    ray = rt.Ray([0, 0, 5], [0, 0, -1])
    assert scene.intersect(ray).t.numpy()[0] == pytest.approx(4)
    params = rt.traverse(scene)
    params["b.to_world"] = T().translate([0, 0, 2]).scale(0.5)
    assert scene.intersect(ray).t.numpy()[0] == pytest.approx(4)
    params.update()
    hit = scene.intersect(ray)
    assert hit.t.numpy()[0] == pytest.approx(2.5)
    np.testing.assert_allclose(scene.interact(ray, hit).p.numpy().ravel(), [0, 0, 2.5], atol=1e-6)
    assert np.array(scene.description.shapes[-1].to_world)[2, 3] == 0.5  # type: ignore[attr-defined]


def test_normals_follow_vertices_as_in_mitsuba() -> None:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    scene = scenes.scene(b={"type": "cube"})
    theirs = mi.traverse(loaded := mi.load_dict(scene))
    vertices = np.array(theirs["b.vertex_positions"]).reshape(-1, 3)
    vertices[:, 2] += 0.3 * vertices[:, 0] ** 2 + 0.2 * vertices[:, 1]
    theirs["b.vertex_positions"] = mi.Float(vertices.ravel())
    theirs.update()
    ours = rt.load_dict(scene)
    params = rt.traverse(ours)
    params["b.vertex_positions"] = vertices.ravel()
    params.update()
    shading = ours.traced().structure.geometry.shading
    _ = ours.traced().slots
    ours.traced()
    first = shading.first_vertex[-1] * 4
    normals = shading.normals.numpy()[first:].reshape(-1, 4)[:, :3]
    np.testing.assert_allclose(normals, np.array(theirs["b.vertex_normals"]).reshape(-1, 3), atol=1e-6)
    assert loaded is not None


def test_updates_compile_nothing() -> None:
    scene = rt.load_dict(scenes.everything())
    params = rt.traverse(scene)
    t = types("float32")

    def step(k: int) -> int:
        by = 1 + 0.01 * k
        for key, value in params:
            if "to_world" in key or "to_uv" in key:
                matrix = value.numpy()[..., 0].copy()
                matrix[0, -1] += 0.01 * k if "sky" not in key else 0
                params[key] = matrix
            else:
                params[key] = value * dr.opaque(t.Float, by if "positions" in key or k % 2 else 1 / by)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            params.update()
            dr.eval(rt.render(scene, spp=1, accel="bvh"))
            history = dr.kernel_history([dr.KernelType.JIT])
        return sum(not kernel["cache_hit"] for kernel in history)

    counts = [step(k) for k in range(1, 8)]
    assert counts[2:] == [0] * 5


def test_optimisers_drive_parameters() -> None:
    scene = rt.load_dict(scenes.scene())
    params = rt.traverse(scene)
    keys = ("floor.bsdf.reflectance.data", "lamp.intensity.value", "lamp.position")
    opt = dr.opt.Adam(lr=0.1, params={key: params[key] for key in keys})
    params.update(opt)
    values = scene.traced().live_values()
    loss = sum(dr.sum(value) for value in values)
    dr.backward(loss)
    opt.step()
    assert sorted(params.update(opt)) == sorted(keys)
    np.testing.assert_allclose(params["lamp.intensity.value"].numpy().ravel(), [4.9, 5.9, 6.9], rtol=1e-5)


def test_what_is_handed_out_may_be_changed_in_place() -> None:
    scene = rt.load_dict(scenes.scene())
    params = rt.traverse(scene)
    assert params.update() == []
    params["lamp.intensity.value"] *= 0
    assert params.update() == ["lamp.intensity.value"]
    assert rendered(scene).max() == 0
    assert params.update() == []
    value = rt.traverse(scene, "float64")["lamp.intensity.value"]
    assert dr.type_v(value) == dr.VarType.Float64 and (value.numpy() == 0).all()


def test_derivatives_may_be_asked_for_after_an_update() -> None:
    scene = rt.load_dict(scenes.scene())
    params = rt.traverse(scene)
    params["lamp.position"] = [0, 0, 4]
    assert params.with_derivatives() == []
    dr.enable_grad(params["lamp.intensity.value"])
    assert params.with_derivatives() == params.with_derivatives() == ["lamp.intensity.value"]
    changed = scene.store.clock
    assert rt.traverse(scene, "float64").with_derivatives() == ["lamp.intensity.value"] and scene.store.clock == changed
    # What was assigned waits for its update.
    assert sorted(entry.key for entry in scene.store.entries.values()) == ["lamp.intensity.value"]
    assert "lamp.position" in params.update()
    params["lamp.intensity.value"] = dr.detach(params["lamp.intensity.value"])
    params.update()
    assert params.with_derivatives() == []


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("floor.bsdf.reflectance.data", np.zeros((2, 2, 3)), r"floor\.bsdf\.reflectance\.data must have the shape"),
        ("floor.bsdf.reflectance.data", np.full((5, 6, 3), np.nan), "not finite"),
        ("lamp.intensity.value", [1, 2], "lamp.intensity.value must be a colour"),
        ("lamp.intensity.value", "red", "must be a colour"),
        ("lamp.position", [np.inf, 0, 0], "not finite"),
        ("floor.to_world", np.zeros((4, 4)), "affine"),
        ("floor.to_world", np.diag([1.0, 0, 1, 1]), "singular"),
        ("floor.to_world", np.eye(3), "4x4"),
        ("sensor.x_fov", 180.0, "between 0 and 180"),
        ("sensor.to_world", np.diag([2.0, 1, 1, 1]), "scales"),
        ("ball.to_world", np.diag([2.0, 1, 1, 1]), "evenly"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(key: str, value: Any, message: str) -> None:
    scene = rt.load_dict(scenes.scene(ball={"type": "sphere", "radius": 0.3}))
    before = rendered(scene)
    params = rt.traverse(scene)
    with pytest.raises(ValueError, match=message):
        params[key] = value
        params.update()
    np.testing.assert_array_equal(rendered(scene), before)
    params["lamp.intensity.value"] = [0, 0, 0]
    params.update()
    assert rendered(scene).max() == 0


def test_a_changed_scene_is_not_compared() -> None:
    scene = rt.load_dict(scenes.scene())
    params = rt.traverse(scene)
    params["lamp.position"] = [0, 0, 4]
    params.update()
    with pytest.raises(rt.RayTraceError, match="lamp.position changed"):
        rt.compare(scene, spp=16)
