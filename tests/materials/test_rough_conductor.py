"""Microfacets of conductors against Mitsuba's, and their sampling against their density."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from raytrace2.materials import MaterialTable
from raytrace2.scene.description import ConstantTexture, RoughConductorBsdf
from raytrace2.types import types

N = 20000
ALPHA = ConstantTexture((0.3, 0.3, 0.3))
COPPER = ConstantTexture((0.2, 0.9, 1.1)), ConstantTexture((3.9, 2.4, 2.2))
BSDFS = {
    "ggx": RoughConductorBsdf("ggx", ConstantTexture((0.2,) * 3), ConstantTexture((0.5,) * 3), True, *COPPER),
    "beckmann": RoughConductorBsdf(
        "beckmann", ALPHA, ALPHA, True, specular_reflectance=ConstantTexture((0.9, 0.8, 0.7))
    ),
    "all_ggx": RoughConductorBsdf("ggx", ALPHA, ALPHA, False),
    "all_beckmann": RoughConductorBsdf("beckmann", ALPHA, ConstantTexture((0.6,) * 3), False),
}


def directions(seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(3, N))
    return d / np.linalg.norm(d, axis=0)


def plugin(b: RoughConductorBsdf) -> dict[str, Any]:
    def rgb(texture: Any) -> dict[str, Any]:
        return {"type": "rgb", "value": list(texture.value)}

    colors = {name: rgb(getattr(b, name)) for name in ("eta", "k", "specular_reflectance")}
    alphas = {name: getattr(b, name).value[0] for name in ("alpha_u", "alpha_v")}
    return {
        "type": "roughconductor",
        "distribution": b.distribution,
        "sample_visible": b.sample_visible,
        **alphas,
        **colors,
    }


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("name", BSDFS)
def test_values_and_samples_are_mitsubas(interaction: Any, name: str, mixed: bool) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    t = types("float32")
    table = MaterialTable.build(list(BSDFS.values()) if mixed else [BSDFS[name]], t)
    index = t.UInt(table.index_of(BSDFS[name]))
    wi, wo = (directions(seed).astype(np.float32) for seed in (1, 2))
    wi[2] = np.abs(wi[2])
    u = np.random.default_rng(3).random((2, N)).astype(np.float32)
    bsdf, theirs = mi.load_dict(plugin(BSDFS[name])), dr.zeros(mi.SurfaceInteraction3f, N)
    theirs.wi = mi.Vector3f(wi)
    si = interaction(t, wi)
    value, pdf = table.eval_pdf(si, index, t.Array3f(wo))
    expected, expected_pdf = bsdf.eval_pdf(mi.BSDFContext(), theirs, mi.Vector3f(wo))
    assert np.allclose(np.array(value), np.array(expected), rtol=1e-4, atol=1e-7)
    assert np.allclose(np.array(pdf), np.array(expected_pdf), rtol=1e-4, atol=1e-7)
    sample = table.sample(si, index, t.Float(0.5), t.Array2f(u))
    reference, weight = bsdf.sample(mi.BSDFContext(), theirs, mi.Float(0.5), mi.Point2f(u))
    # Grazing directions magnify round-off: a few lanes of a thousand may differ.
    lit = np.array(weight).max(axis=0) > 0
    assert lit.sum() > 0.5 * N
    pairs = ((sample.wo, reference.wo), (sample.weight, weight), (sample.pdf, reference.pdf))
    for ours, other in pairs:
        same = np.isclose(np.array(ours), np.array(other), rtol=2e-3, atol=1e-4)
        assert same[..., lit].mean() > 0.997
    assert not np.array(sample.delta).any()


@pytest.mark.parametrize("name", BSDFS)
def test_density_is_that_of_the_samples(interaction: Any, name: str) -> None:
    t = types("float64")
    table = MaterialTable.build([BSDFS[name]], t)
    wi = np.tile([[0.5], [0.3], [np.sqrt(1 - 0.34)]], (1, 100_000))
    si = interaction(t, wi)
    u = np.random.default_rng(4).random((2, wi.shape[1]))
    sample = table.sample(si, t.UInt(table.indices[0]), t.Float(0.5), t.Array2f(u))
    wo, live = np.array(sample.wo), np.array(sample.pdf) > 0
    grid = np.random.default_rng(5).random((2, wi.shape[1]))
    z, phi = grid[0], 2 * np.pi * grid[1]
    uniform = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
    density = np.array(table.eval_pdf(si, t.UInt(table.indices[0]), t.Array3f(uniform))[1]) * 2 * np.pi
    for test in (np.ones(3), np.array([1.0, -0.5, 0.3]), np.array([-0.6, 0.9, 0.1])):
        inside = [(test @ d > 0.2).astype(float) for d in (wo, uniform)]
        assert (inside[0] * live).mean() == pytest.approx((inside[1] * density).mean(), abs=0.02)


def test_a_white_one_loses_little(interaction: Any) -> None:
    t = types("float64")
    table = MaterialTable.build(
        [RoughConductorBsdf("ggx", ConstantTexture((0.1,) * 3), ConstantTexture((0.1,) * 3))], t
    )
    wi = np.tile([[0.6], [0.0], [0.8]], (1, N))
    u = np.random.default_rng(4).random((2, N))
    sample = table.sample(interaction(t, wi), t.UInt(table.indices[0]), t.Float(0.5), t.Array2f(u))
    weight = np.array(sample.weight)
    assert weight.max() <= 1 + 1e-9 and 0.97 < weight.mean() <= 1
