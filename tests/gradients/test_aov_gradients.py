"""Derivatives of aovs against central differences of renders with the same samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
from gradient_grammar import Spec, direction, mitsuba, scene_dict

import raytrace2 as rt
from raytrace2.integrators.aov import CHANNELS
from raytrace2.scene.description import Integrator

KINDS = [kind for kind in CHANNELS if not kind.startswith("accel.")]
EVERYTHING = Integrator("aov", aovs=tuple((kind, kind) for kind in KINDS))
#: What is counted, and so has derivative zero.
STILL = {"footprint_flags", "prim_index", "shape_index"}
#: Steps of the differences: a sample that crosses an edge within the one may not within the other.
STEPS = (1e-6, 1e-7)

SPECS = {
    "shapes": Spec((("smooth", "texture"), ("sphere", "checker"), ("rectangle", "diffuse")), ("point",)),
    "lens": Spec((("cylinder", "texture"), ("disk", "texture"), ("flat", "diffuse")), ("point",), "thinlens"),
    "instances": Spec((("instance", "texture"), ("faces", "checker")), ("point",), "orthographic"),
    "reliefs": Spec((("smooth", "bumpmap"), ("sphere", "normalmap")), ("point",)),
}
#: With these, footprints of their own, or found with neighbouring rays.
HOW = {"shapes": {"filter": "ewa"}, "lens": {}, "instances": {}, "reliefs": {"filter": "ewa"}}


def flat(value: Any) -> np.ndarray:
    """A parameter, or its gradient, as it may be assigned."""
    array = np.array(value.numpy())
    return array[..., 0] if dr.is_matrix_v(value) else array


class Case:
    """A scene whose parameters may all change, and the aovs that it is rendered to."""

    def __init__(self, spec: Spec, precision: str, settings: Integrator, **how: Any) -> None:
        self.scene = rt.load_dict(scene_dict(spec))
        self.params = rt.traverse(self.scene, precision)
        self.how = {"integrator": settings, "spp": 1, "accel": "brute_force", "seed": 1, **how}
        self.start = {key: flat(self.params[key]) for key in self.params.keys()}
        self.assign(self.start)

    def assign(self, values: dict[str, np.ndarray]) -> None:
        """Gives parameters other values."""
        for key, value in values.items():
            self.params[key] = value
        self.params.update()

    def render(self, **more: Any) -> Any:
        return rt.render(self.scene, self.params, seed_grad=1, **self.how, **more)

    def tangent(self, key: str, change: np.ndarray, **more: Any) -> np.ndarray:
        """How the image changes along ``change``, by forward mode."""
        self.assign(self.start)
        value = self.params[key]
        dr.enable_grad(value)
        entries = [float(x) for x in change.ravel()] if dr.is_matrix_v(value) else [change]
        dr.set_grad(value, type(value)(*entries))
        found = dr.forward_to(self.render(**more), flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad).numpy()
        dr.disable_grad(value)
        return np.array(found)

    def gradients(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Those of the image times ``weights``, by reverse mode."""
        self.assign(self.start)
        for key in self.start:
            dr.enable_grad(self.params[key])
        image = self.render()
        dr.backward(dr.sum(image * type(image)(weights.astype(self.params.types.numpy)), axis=None))
        return {key: flat(dr.grad(self.params[key])) for key in self.start}

    def difference(self, key: str, change: np.ndarray, step: float) -> np.ndarray:
        """How the image changes along ``change``."""
        ends = []
        for sign in (-step, step):
            self.assign({key: self.start[key] + sign * change})
            ends.append(rt.render(self.scene, precision="float64", **self.how).numpy())
        self.assign({key: self.start[key]})
        return (ends[1] - ends[0]) / (2 * step)


def by_kind(image: np.ndarray, settings: Integrator = EVERYTHING) -> dict[str, np.ndarray]:
    """The channels of each aov."""
    ends = np.cumsum([len(CHANNELS[kind]) for _, kind in settings.aovs])
    parts = np.split(image, ends[:-1], axis=2)
    return {kind: part for (_, kind), part in zip(settings.aovs, parts, strict=True)}


@pytest.mark.parametrize("name", SPECS)
def test_forward_mode_against_differences(name: str) -> None:
    rng = np.random.default_rng(5)
    case, single = (Case(SPECS[name], precision, EVERYTHING, **HOW[name]) for precision in ("float64", "float32"))
    seen: set[str] = set()
    for key in case.start:
        change = direction(key, case.params[key], rng)
        tangents, narrow = by_kind(case.tangent(key, change)), by_kind(single.tangent(key, change))
        differences: list[dict[str, np.ndarray]] = []
        for kind, tangent in tangents.items():
            size = float(np.abs(tangent).max())
            assert np.abs(narrow[kind] - tangent).max() <= 1e-3 * size, (key, kind)
            if not key.startswith("light"):
                # Of each pixel those of the step that does not cross an edge.
                differences = differences or [by_kind(case.difference(key, change, step)) for step in STEPS]
                error = np.min([np.abs(d[kind] - tangent).max(axis=2) for d in differences], axis=0)
                assert error.max() <= 1e-6 * max(size, 1e-2), (key, kind)
            if size > 0:
                seen.add(kind)
    assert seen == set(KINDS) - STILL


@pytest.mark.parametrize(("nested", "how"), [(None, {"filter": "ewa"}), ("path", {}), ("direct", {})])
def test_both_modes_agree(nested: str | None, how: dict[str, Any]) -> None:
    rng = np.random.default_rng(6)
    inner = None if nested is None else Integrator(nested, max_depth=3)  # type: ignore[arg-type]
    case = Case(SPECS["shapes"], "float64", Integrator("aov", aovs=EVERYTHING.aovs, nested=inner), **how)
    image = case.render()
    weights = rng.normal(size=image.shape)
    gradients = case.gradients(weights)
    for key in ("floor.bsdf.reflectance.data", "thing0.vertex_positions", "thing1.to_world", "sensor.to_world"):
        change = direction(key, case.params[key], rng)
        along = float((gradients[key] * change).sum())
        parts = case.tangent(key, change) * weights
        assert along == pytest.approx(float(parts.sum()), rel=1e-9, abs=1e-9 * np.abs(parts).sum()), key
        assert np.abs(parts).max() > 0


def test_colours_beside_aovs_have_the_derivatives_that_they_have_alone() -> None:
    rng = np.random.default_rng(7)
    inner = Integrator("path", max_depth=3)
    beside = Case(SPECS["shapes"], "float64", Integrator("aov", aovs=EVERYTHING.aovs, nested=inner))
    alone = Case(SPECS["shapes"], "float64", inner)
    for key in ("thing0.vertex_positions", "sensor.to_world"):
        change = direction(key, alone.params[key], rng)
        expected = alone.tangent(key, change)
        np.testing.assert_allclose(beside.tangent(key, change)[..., :3], expected, atol=1e-12 * np.abs(expected).max())


def test_footprints_may_count_as_constant() -> None:
    change = np.zeros((4, 4))
    change[:3, 3] = 0.3, 0.2, 0.1
    for how in ({}, {"filter": "ewa"}):
        case = Case(SPECS["shapes"], "float64", EVERYTHING, **how)
        constant = by_kind(case.tangent("sensor.to_world", change, footprint_gradients=False))
        free = by_kind(case.tangent("sensor.to_world", change))
        for kind in KINDS:
            assert np.abs(free[kind]).any() == (kind not in STILL)
            if kind in ("duv_dx", "duv_dy"):
                assert not constant[kind].any()
            elif kind != "albedo":
                np.testing.assert_array_equal(constant[kind], free[kind])


def test_counts_have_no_derivatives() -> None:
    counted = Integrator("aov", aovs=(("a", "accel.nodes"), ("b", "prim_index")))
    case = Case(SPECS["shapes"], "float32", counted, accel="bvh")
    gradients = case.gradients(np.ones(case.render().shape))
    assert not any(gradient.any() for gradient in gradients.values())


@pytest.mark.parametrize("key", ["ball.to_world", "sensor.to_world"])
def test_edges_move(key: str) -> None:
    """Against differences of images of many samples."""
    scene = rt.load_dict(ball_before_a_wall())
    params = rt.traverse(scene, "float64")
    nested = Integrator("direct", bsdf_samples=0)
    kinds = ("depth", "position", "shape_index", "prim_index")
    how: dict[str, Any] = {"integrator": Integrator("aov", aovs=tuple((k, k) for k in kinds), nested=nested)}
    start, change, step, ends = flat(params[key]), np.zeros((4, 4)), 0.05, []
    change[:3, 3] = 0.5, 0.3, 0.2
    for sign in (-1, 1):
        params[key] = start + sign * step * change
        params.update()
        ends.append(rt.render(scene, precision="float64", spp=4096, seed=3, **how).numpy())
    params[key] = start
    params.update()
    dr.enable_grad(params[key])
    dr.set_grad(params[key], type(params[key])(*(float(x) for x in change.ravel())))
    image = rt.render(scene, params, spp=1, spp_grad=2048, seed=5, visibility_gradients=True, **how)
    found, expected = dr.forward_to(image).numpy(), (ends[1] - ends[0]) / (2 * step)
    for channels in (slice(0, 3), slice(3, 4), slice(4, 7), slice(7, 8)):
        a, b = found[..., channels], expected[..., channels]
        assert np.linalg.norm(a - b) < 0.04 * np.linalg.norm(b)
    assert not found[..., 8].any()


def test_creases_move(tmp_path: Path) -> None:
    """Those of a roof, smooth or not: faces jump where normals that are interpolated do not."""
    corners = ["-.7 -.6 0", ".03 -.6 .4", ".03 .6 .4", "-.7 .6 0", ".7 -.6 0", ".7 .6 0"]
    faces = ["1//1 2//1 3//1", "1//1 3//1 4//1", "2//1 5//1 6//1", "2//1 6//1 3//1"]
    rows = [*(f"v {c}" for c in corners), "vn 0 0 1", *(f"f {f}" for f in faces)]
    (tmp_path / "roof.obj").write_text("\n".join(rows) + "\n")
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    look = mitsuba().ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    scene = rt.load_dict({
        "type": "scene",
        "sensor": {"type": "orthographic", "to_world": look, "film": film},
        "roof": {"type": "obj", "filename": str(tmp_path / "roof.obj")},
    })  # fmt: skip
    params, key, step, ends = rt.traverse(scene, "float64"), "roof.vertex_positions", 0.02, []
    start, how = flat(params[key]), "aov:geo_normal,sh_normal,depth"
    change = np.tile([1.0, 0.0, 0.0], len(start) // 3)
    for sign in (-1, 1):
        params[key] = start + sign * step * change
        params.update()
        ends.append(rt.render(scene, params, integrator=how, spp=4096, seed=1).numpy())
    params[key] = start
    dr.enable_grad(params[key])
    dr.set_grad(params[key], type(params[key])(change))
    params.update()
    image = rt.render(scene, params, integrator=how, spp=1, spp_grad=1024, seed=5, visibility_gradients=True)
    found, expected = dr.forward_to(image).numpy(), (ends[1] - ends[0]) / (2 * step)
    for channels in (slice(0, 3), slice(3, 6), slice(6, 7)):
        a, b = found[..., channels], expected[..., channels]
        assert np.linalg.norm(a - b) < 0.05 * np.linalg.norm(b)


def ball_before_a_wall() -> dict[str, Any]:
    """Both in full view."""
    T = mitsuba().ScalarTransform4f
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    look = T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    sampler = {"type": "multijitter", "sample_count": 4096}
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film, "sampler": sampler},
        "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -2]).scale([8, 8, 1])},
        "ball": {"type": "sphere", "to_world": T().translate([-0.6, 0.2, 0]).scale(0.8)},
        "lamp": {"type": "point", "position": [2, 2, 5], "intensity": {"type": "rgb", "value": 40.0}},
    }


def test_a_pose_is_found_from_depth() -> None:
    scene = rt.load_dict(scene_dict(SPECS["shapes"]))
    how: dict[str, Any] = {"integrator": Integrator("aov", aovs=(("z", "depth"),)), "spp": 4, "seed_grad": 0}
    params = rt.traverse(scene)
    key = "sensor.to_world"
    base = params[key].numpy()[..., 0]
    truth = rt.render(scene, **how)
    opt = dr.opt.Adam(lr=0.02, params={"moved": params.types.Array3f(0.2, -0.15, 0.2)})
    for _ in range(60):
        entries = [list(map(params.types.Float, map(float, row))) for row in base]
        for k in range(3):
            entries[k][3] = entries[k][3] + opt["moved"][k]
        params[key] = params.types.Matrix4f(*(x for row in entries for x in row))
        params.update()
        difference = rt.render(scene, params, **how) - truth
        # Pixels across an edge say nothing of how far off the camera is.
        dr.backward(dr.mean(dr.select(dr.abs(difference) < 0.5, dr.square(difference), 0), axis=None))
        opt.step()
    assert np.abs(opt["moved"].numpy()).max() < 0.01


@pytest.mark.parametrize("nested", [None, "path", "direct"])
def test_texels_that_are_drawn_at_random_have_the_derivatives_of_the_whole_filter(nested: str | None) -> None:
    inner = None if nested is None else Integrator(nested, max_depth=2)  # type: ignore[arg-type]
    settings = Integrator("aov", aovs=(("albedo", "albedo"),), nested=inner)
    key = "floor.bsdf.reflectance.data"
    found = []
    for name in ("trilinear", "stochastic:of=trilinear"):
        case = Case(SPECS["shapes"], "float64", settings, filter=name)
        found.append(case.tangent(key, np.random.default_rng(8).random(case.start[key].shape)))
    assert np.abs(found[0]).max() > 0
    np.testing.assert_allclose(found[1][..., -3:], found[0][..., -3:], atol=1e-12)
