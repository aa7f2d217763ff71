"""Gradients by every parameter against central differences of renders with the same samples.

Differences at fixed samples see how often what is chosen, and where lights are sampled, change too, which derivatives
leave out or weigh by the chance: chances and sampling tables stay as they are here, and have tests of their own.
"""

from __future__ import annotations

import os
from typing import Any

import drjit as dr
import numpy as np
import pytest
from gradient_grammar import Spec, direction

import raytrace2 as rt
from raytrace2.lights import area_live, area_mesh, envmap_live
from raytrace2.materials import dielectric, mask, thin_dielectric

#: Few, for kernels that move everything take long to compile.
SPECS = [
    Spec((("smooth", "mask"),), ("point",)),
    Spec((("instance", "texture"),), ("spot",), "orthographic", "direct", "ewa"),
]
#: The rest of the grammar, which takes minutes: with RAYTRACE2_ALL_GRADIENTS=1.
MORE = [
    Spec((("flat", "conductor"),), ("point",)),
    Spec((("flat", "diffuse"), ("smooth", "mask")), ("point", "area_rectangle"), filter="trilinear"),
    Spec((("sphere", "dielectric"),), ("area_disk",), "thinlens"),
    Spec((("sphere", "dielectric"),), ("area_disk",), "thinlens", "direct"),
    Spec((("instance", "beckmann"),), ("envmap",), "orthographic", "direct"),
    Spec((("disk", "normalmap"), ("cylinder", "checker")), ("spot",), integrator="direct", filter="ewa"),
    Spec((("smooth", "texture"), ("smooth", "mask")), ("area_rectangle",)),
    Spec((("sphere", "beckmann"),), ("spot",)),
    Spec((("rectangle", "bumpmap"),), ("directional", "constant")),
    Spec((("disk", "normalmap"),), ("area_sphere",)),
    Spec((("cylinder", "ggx"),), ("envmap",)),
    Spec((("instance", "twosided"),), ("area_disk",)),
    Spec((("sphere", "dielectric"),), ("area_cylinder",), "thinlens"),
    Spec((("faces", "allnormals"),), ("area_smooth",), "orthographic"),
    Spec((("flat", "checker"), ("rectangle", "thindielectric")), ("area_flat",), integrator="direct"),
    Spec((("smooth", "thindielectric"),), ("area_faces", "point")),
    Spec((("sphere", "texture"),), ("directional",), filter="nearest"),
    Spec((("sphere", "texture"),), ("point",), filter="trilinear"),
    Spec((("smooth", "mask"),), ("spot",), filter="ewa"),
    Spec((("instance", "dielectric"),), ("area_rectangle",), filter="probes"),
    Spec((("sphere", "conductor"),), ("point",), "thinlens", filter="exact"),
    Spec((("cylinder", "texture"),), ("point",), "orthographic", filter="exact"),
    Spec((("instance", "ggx"),), ("envmap",), filter="ewa"),
    Spec((("cylinder", "normalmap"),), ("point",), filter="ewa"),
    Spec((("disk", "bumpmap"),), ("constant",), filter="trilinear"),
    Spec((("sphere", "thindielectric"),), ("area_rectangle",), "thinlens", filter="ewa"),
    Spec((("smooth", "dielectric"),), ("constant",), filter="ewa"),
    Spec((("smooth", "texture"),), ("point",), filter="bicubic"),
    Spec((("flat", "checker"),), ("point",), filter="mip_distance", differentials="analytic"),
    Spec((("faces", "texture"),), ("directional",), filter="trilinear_shorter"),
    Spec((("sphere", "texture"),), ("area_disk",), filter="probes:max_anisotropy=0"),
    Spec((("cylinder", "texture"),), ("point",), filter="exact2", differentials="autodiff2"),
    Spec((("disk", "ggx"),), ("envmap",), filter="exact"),
    Spec((("smooth", "mask"),), ("spot",), filter="exact"),
    Spec((("disk", "normalmap"),), ("point",), filter="exact"),
    Spec((("instance", "normalmap"),), ("area_sphere",), filter="probes"),
    Spec((("rectangle", "bumpmap"),), ("area_smooth",), filter="ewa"),
    Spec((("cylinder", "bumpmap"),), ("area_faces",), filter="exact"),
    Spec((("sphere", "twosided"), ("disk", "normalmap")), ("area_flat",), "orthographic", filter="ewa"),
]
if os.environ.get("RAYTRACE2_ALL_GRADIENTS"):
    SPECS += MORE

#: Steps of the differences: a sample that crosses an edge within the one may not within the other.
STEPS = (1e-7, 3e-8)


@pytest.fixture(autouse=True)
def nothing_but_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chances have no weights, and tables by which lights are sampled stay what they were at first."""
    for module in (dielectric, mask, thin_dielectric, area_mesh):
        monkeypatch.setattr(module, "by_choice", lambda weight, chance: weight)
    monkeypatch.setattr(area_live, "_chances", lambda base, values, moved: base)
    density, known = envmap_live._Sky._density, {}

    def first_density(sky: Any, values: Any) -> Any:
        key = sky.height, sky.width, sky._types.precision
        if key not in known:
            known[key] = density(sky, values)
        return known[key]

    monkeypatch.setattr(envmap_live._Sky, "_density", first_density)


def flat(value: Any) -> np.ndarray:
    """A parameter, or its gradient, as it may be assigned."""
    array = value.numpy()
    return array[..., 0] if dr.is_matrix_v(value) else array


class Case:
    """A scene whose parameters may all change."""

    def __init__(self, spec: Spec, precision: str) -> None:
        self.spec, self.scene = spec, spec.load()
        self.params = rt.traverse(self.scene, precision)
        self.start = {key: flat(self.params[key]) for key in self.params.keys()}
        self.assign(self.start)

    def assign(self, values: dict[str, np.ndarray]) -> None:
        """Gives parameters other values."""
        for key, value in values.items():
            self.params[key] = value
        self.params.update()

    def render(self) -> Any:
        return rt.render(self.scene, self.params, seed=1, seed_grad=1, **self.spec.how())

    def reverse(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """The gradients of the image times ``weights``."""
        self.assign(self.start)
        for key in self.start:
            dr.enable_grad(self.params[key])
        image = self.render()
        dr.backward(dr.sum(image * type(image)(weights.astype(self.params.types.numpy)), axis=None))
        return {key: flat(dr.grad(self.params[key])) for key in self.start}

    def forward(self, directions: dict[str, np.ndarray]) -> np.ndarray:
        """How the image changes along all ``directions`` at once."""
        for key, change in directions.items():
            value = self.params[key]
            dr.enable_grad(value)
            entries = [float(x) for x in change.ravel()] if dr.is_matrix_v(value) else [change]
            dr.set_grad(value, type(value)(*entries))
        found: np.ndarray = dr.forward_to(self.render()).numpy()
        return found

    def difference(self, key: str, change: np.ndarray, step: float) -> np.ndarray:
        """How the image changes along ``change``."""
        ends = []
        for sign in (-step, step):
            self.assign({key: self.start[key] + sign * change})
            ends.append(rt.render(self.scene, seed=1, precision="float64", **self.spec.how()).numpy())
        self.assign({key: self.start[key]})
        return (ends[1] - ends[0]) / (2 * step)


def errors(spec: Spec) -> dict[str, tuple[float, float, float]]:
    """By parameter: the error of the derivative in float64 and the gradient's in float32, both relative, and how much
    the image depends on it."""
    rng = np.random.default_rng(5)
    case = Case(spec, "float64")
    image = case.render().numpy()
    weights = rng.normal(size=image.shape)
    gradients, single = case.reverse(weights), Case(spec, "float32").reverse(weights)
    case.assign(case.start)
    found = {}
    for key, gradient in gradients.items():
        assert np.isfinite(gradient).all() and np.isfinite(single[key]).all(), key
        change = direction(key, case.params[key], rng)
        along = float((gradient * change).sum())
        wide = []
        for step in STEPS:
            parts = case.difference(key, change, step) * weights
            # Rounding of the images is no error of the derivatives.
            size = max(float(np.abs(parts).sum()), 1e-3 * float(np.abs(image * weights).sum()))
            wide.append(abs(along - float(parts.sum())) / size)
        # A gradient of one number may be small for being a difference of large ones.
        least = max(np.linalg.norm(gradient), size / np.linalg.norm(change), 1e-3)
        narrow = np.linalg.norm(single[key] - gradient) / least
        found[key] = min(wide), float(narrow), size
    return found


@pytest.mark.parametrize("spec", SPECS, ids=str)
def test_reverse_mode(spec: Spec) -> None:
    for key, (wide, narrow, _) in errors(spec).items():
        # How footprints change from pixel to pixel counts as constant.
        assert wide < (2e-3 if spec.differentials == "autodiff2" else 1e-6), key
        assert narrow < 1e-3, key


@pytest.mark.parametrize("spec", SPECS[:1], ids=str)
def test_forward_mode_agrees_with_reverse_mode(spec: Spec) -> None:
    rng = np.random.default_rng(6)
    case = Case(spec, "float64")
    directions = {key: direction(key, case.params[key], rng) for key in case.start}
    changes = case.forward(directions)
    weights = rng.normal(size=changes.shape)
    gradients = case.reverse(weights)
    along = sum(float((gradients[key] * directions[key]).sum()) for key in directions)
    assert along == pytest.approx(float((changes * weights).sum()), rel=1e-9, abs=1e-9 * np.abs(changes).sum())


@pytest.mark.parametrize("integrator", ["path", "direct"])
def test_black_has_derivatives(integrator: str) -> None:
    spec = Spec((("smooth", "texture"),), ("area_rectangle", "constant"), integrator=integrator)
    scene = spec.load()
    params = rt.traverse(scene, "float64")
    key = "thing0.bsdf.reflectance.data"
    change = np.random.default_rng(7).random(params[key].shape)
    step, ends = 1e-7, []
    for value in (step * change, 0 * change):
        params[key] = value
        params.update()
        ends.append(rt.render(scene, params, seed=1, **spec.how()).numpy())
    dr.enable_grad(params[key])
    image = rt.render(scene, params, seed=1, seed_grad=1, **spec.how())
    dr.backward(dr.sum(image, axis=None))
    expected = (ends[0] - ends[1]).sum() / step
    assert expected > 1
    assert float((dr.grad(params[key]).numpy() * change).sum()) == pytest.approx(expected, rel=1e-6)
