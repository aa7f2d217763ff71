from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from scipy import stats

from raytrace2.materials import MaterialTable
from raytrace2.scene.description import (
    BitmapTexture,
    Bsdf,
    CheckerboardTexture,
    ConductorBsdf,
    ConstantTexture,
    DielectricBsdf,
    DiffuseBsdf,
    MaskBsdf,
    ThinDielectricBsdf,
    TwoSidedBsdf,
)
from raytrace2.types import types

T32 = types("float32")
N = 20000
C = ConstantTexture
PIXELS = np.random.default_rng(0).random((6, 6, 3)).astype(np.float32)
CHECKER = CheckerboardTexture(C((0.1, 0.2, 0.3)), BitmapTexture(PIXELS))
DIFFUSE = DiffuseBsdf(C((0.2, 0.4, 0.6)))
TEXTURED = DiffuseBsdf(CHECKER)
COPPER = ConductorBsdf(C((0.2, 0.9, 1.1)), C((3.9, 2.4, 2.2)), C((0.9, 0.8, 0.7)))
GLASS = DielectricBsdf(1.5, 1.0, C((0.9, 0.8, 0.7)), C((0.5, 0.6, 1.0)))
BSDFS: dict[str, Bsdf] = {
    "diffuse": DIFFUSE,
    "textured": TEXTURED,
    "copper": COPPER,
    "mirror": ConductorBsdf(),
    "glass": GLASS,
    "bubble": DielectricBsdf(1.2, 1.33),
    "pane": ThinDielectricBsdf(1.5, 1.0, specular_transmittance=C((0.5, 0.6, 1.0))),
    "two": TwoSidedBsdf(TEXTURED, TEXTURED),
    "front_back": TwoSidedBsdf(DIFFUSE, COPPER),
    "mask": MaskBsdf(DIFFUSE, CHECKER),
    "mask_two": MaskBsdf(TwoSidedBsdf(DIFFUSE, TEXTURED), C((0.3, 0.3, 0.3))),
    "mask_glass": MaskBsdf(GLASS, C((0.6, 0.6, 0.6))),
    "mask_mask": MaskBsdf(MaskBsdf(DIFFUSE, C((0.5, 0.5, 0.5))), C((0.6, 0.6, 0.6))),
}


@pytest.fixture(scope="module")
def mi() -> Any:
    module = pytest.importorskip("mitsuba")
    module.set_variant("llvm_ad_rgb")
    return module


def mitsuba_dict(mi: Any, x: Any) -> dict[str, Any]:
    """The Mitsuba plugin that a description stands for."""
    match x:
        case ConstantTexture():
            return {"type": "rgb", "value": list(x.value)}
        case BitmapTexture():
            return {"type": "bitmap", "bitmap": mi.Bitmap(x.pixels)}
        case CheckerboardTexture():
            return {"type": "checkerboard", "color0": mitsuba_dict(mi, x.color0), "color1": mitsuba_dict(mi, x.color1)}
        case DiffuseBsdf():
            return {"type": "diffuse", "reflectance": mitsuba_dict(mi, x.reflectance)}
        case ConductorBsdf():
            if x.eta.value == (0, 0, 0):  # type: ignore[union-attr]
                return {"type": "conductor"}
            names = ("eta", "k", "specular_reflectance")
            return {"type": "conductor"} | {n: mitsuba_dict(mi, getattr(x, n)) for n in names}
        case DielectricBsdf() | ThinDielectricBsdf():
            kind = "dielectric" if isinstance(x, DielectricBsdf) else "thindielectric"
            names = ("specular_reflectance", "specular_transmittance")
            colors = {n: mitsuba_dict(mi, getattr(x, n)) for n in names}
            return {"type": kind, "int_ior": x.int_ior, "ext_ior": x.ext_ior} | colors
        case TwoSidedBsdf():
            same = {} if x.front is x.back else {"b": mitsuba_dict(mi, x.back)}
            return {"type": "twosided", "a": mitsuba_dict(mi, x.front)} | same
        case MaskBsdf():
            opacity = mitsuba_dict(mi, x.opacity)
            if isinstance(x.opacity, ConstantTexture):
                opacity = x.opacity.value[0]  # type: ignore[assignment]
            return {"type": "mask", "opacity": opacity, "nested": mitsuba_dict(mi, x.nested)}
    raise TypeError(x)


def directions(n: int, seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(3, n))
    return (d / np.linalg.norm(d, axis=0)).astype(np.float32)


WI, WO = directions(N, 1), directions(N, 2)
UV = np.random.default_rng(3).uniform(-3, 4, (2, N)).astype(np.float32)
S1 = np.random.default_rng(4).random(N).astype(np.float32)
S2 = np.random.default_rng(5).random((2, N)).astype(np.float32)


def wide(x: Any) -> np.ndarray:
    array = np.array(x)
    return np.broadcast_to(array, (*array.shape[:-1], N))


def check_against(mi: Any, table: MaterialTable, index: Any, lanes: np.ndarray, name: str, interaction: Any) -> None:
    bsdf = mi.load_dict(mitsuba_dict(mi, BSDFS[name]))
    theirs = dr.zeros(mi.SurfaceInteraction3f, N)
    theirs.uv, theirs.wi = mi.Point2f(UV), mi.Vector3f(WI)
    si = interaction(T32, WI, UV)
    ours = table.sample(si, index, T32.Float(S1), T32.Array2f(S2))
    reference, weight = bsdf.sample(mi.BSDFContext(), theirs, mi.Float(S1), mi.Point2f(S2))
    weight = np.array(weight)
    assert np.allclose(wide(ours.weight)[:, lanes], weight[:, lanes], atol=1e-5)
    lit = lanes & (weight.max(axis=0) > 0)
    assert lit.sum() > 0.3 * lanes.sum()
    kinds = wide(reference.sampled_type)
    assert np.allclose(wide(ours.wo)[:, lit], wide(reference.wo)[:, lit], atol=1e-5)
    if name != "mask_mask":  # Mitsuba gives the probability of one of the two masks' null lobes
        assert np.allclose(wide(ours.pdf)[lit], wide(reference.pdf)[lit], atol=1e-5)
    assert np.allclose(wide(ours.eta)[lit], wide(reference.eta)[lit], atol=1e-6)
    assert np.array_equal(wide(ours.delta)[lit], (kinds & int(mi.BSDFFlags.Delta) != 0)[lit])
    assert np.array_equal(wide(ours.null)[lit], (kinds & int(mi.BSDFFlags.Null) != 0)[lit])
    value, pdf = table.eval_pdf(si, index, T32.Array3f(WO))
    expected, expected_pdf = bsdf.eval_pdf(mi.BSDFContext(), theirs, mi.Vector3f(WO))
    assert np.allclose(wide(value)[:, lanes], wide(expected)[:, lanes], atol=1e-6)
    assert np.allclose(wide(pdf)[lanes], wide(expected_pdf)[lanes], atol=1e-6)
    albedo = bsdf.eval_diffuse_reflectance(theirs)
    assert np.allclose(wide(table.albedo(si, index))[:, lanes], wide(albedo)[:, lanes], atol=1e-6)
    assert (wide(table.has_smooth(index))[lanes] == mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)).all()


@pytest.mark.parametrize("name", BSDFS)
def test_each_agrees_with_mitsuba(mi: Any, interaction: Any, name: str) -> None:
    table = MaterialTable.build([BSDFS[name]], T32)
    check_against(mi, table, T32.UInt(table.indices[0]), np.ones(N, bool), name, interaction)


@pytest.mark.parametrize("names", [list(BSDFS), list(BSDFS)[:7], ["two", "front_back", "diffuse"], ["mask", "copper"]])
def test_mixed_tables_agree_with_mitsuba(mi: Any, interaction: Any, names: list[str]) -> None:
    table = MaterialTable.build([BSDFS[k] for k in names], T32)
    which = np.random.default_rng(6).integers(0, len(names), N)
    index = T32.UInt(np.array(table.indices, dtype=np.uint32)[which])
    for i, name in enumerate(names):
        assert table.indices[i] == table.index_of(BSDFS[name])
        check_against(mi, table, index, which == i, name, interaction)


@pytest.mark.parametrize("name", BSDFS)
def test_double_precision_does_the_same(interaction: Any, name: str) -> None:
    results = []
    for precision in ("float32", "float64"):
        t = types(precision)
        table = MaterialTable.build([BSDFS[name]], t)
        si = interaction(t, WI, UV)
        sample = table.sample(si, t.UInt(table.indices[0]), t.Float(S1), t.Array2f(S2))
        results.append((wide(sample.wo), wide(sample.weight), wide(sample.pdf)))
    # A sample1 within round-off of a threshold may choose the other lobe.
    same = np.abs(results[0][0] - results[1][0]).max(axis=0) < 1e-3
    assert same.mean() > 0.999
    for single, double in zip(*results, strict=True):
        assert np.allclose(single[..., same], double[..., same], atol=1e-3)


def test_flags_tell_what_can_be_left_out() -> None:
    def flags(*names: str) -> tuple[bool, bool, bool, bool]:
        table = MaterialTable.build([BSDFS[k] for k in names], T32)
        return table.has_smooth_any, table.has_delta, table.has_null, table.has_transmission

    assert flags("diffuse", "two") == (True, False, False, False)
    assert flags("copper") == (False, True, False, False)
    assert flags("diffuse", "glass") == (True, True, False, True)
    assert flags("pane") == (False, True, True, True)
    assert flags("mask") == (True, True, True, True)


@pytest.mark.parametrize("name", ["diffuse", "two", "mask_two"])
def test_sampled_directions_follow_the_density(interaction: Any, name: str) -> None:
    n, cells = 200_000, (8, 16)
    rng = np.random.default_rng(7)
    t = types("float64")
    table = MaterialTable.build([BSDFS[name]], t)
    index = t.UInt(table.indices[0])
    si = interaction(t, np.tile([[0.3], [0.4], [-np.sqrt(0.75) if name != "diffuse" else np.sqrt(0.75)]], (1, n)))
    s = table.sample(si, index, t.Float(rng.random(n)), t.Array2f(rng.random((2, n))))
    solid = ~np.broadcast_to(np.array(s.delta), n)
    wo = np.array(s.wo)[:, solid]
    ranges = [(-1, 1), (-np.pi, np.pi)]
    observed = np.histogram2d(wo[2], np.arctan2(wo[1], wo[0]), cells, ranges)[0]
    z, phi = (np.linspace(*r, 40 * c + 1) for r, c in zip(ranges, cells, strict=True))
    z, phi = np.meshgrid(0.5 * (z[1:] + z[:-1]), 0.5 * (phi[1:] + phi[:-1]), indexing="ij")
    r = np.sqrt(1 - z**2)
    grid = t.Array3f(*(t.Float(c.ravel()) for c in (r * np.cos(phi), r * np.sin(phi), z)))
    one = interaction(t, t.Array3f(*(t.Float([float(si.wi[i][0])]) for i in range(3))))
    density = np.broadcast_to(np.array(table.eval_pdf(one, index, grid)[1]), z.size).reshape(z.shape)
    mass = density.reshape(cells[0], 40, cells[1], 40).sum(axis=(1, 3)) * (4 * np.pi / z.size)
    assert mass.sum() == pytest.approx(solid.mean(), abs=5e-3)
    expected = mass[mass > 0] / mass.sum() * solid.sum()
    assert observed[mass == 0].sum() == 0
    assert stats.chisquare(observed[mass > 0], expected).pvalue > 1e-3


@pytest.mark.parametrize("name", BSDFS)
def test_no_energy_is_made(interaction: Any, name: str) -> None:
    """The mean weight, without the 1 / eta^2 of radiance, is at most one, and one for a pane of white glass."""
    table = MaterialTable.build([BSDFS[name], GLASS, DielectricBsdf()], T32)
    si = interaction(T32, WI, UV)
    s = table.sample(si, T32.UInt(table.indices[0]), T32.Float(S1), T32.Array2f(S2))
    weight = wide(s.weight) * wide(s.eta) ** 2
    assert weight.max() <= 1.00001 and weight.min() >= 0
    s = table.sample(si, T32.UInt(table.indices[2]), T32.Float(S1), T32.Array2f(S2))
    assert np.allclose(wide(s.weight) * wide(s.eta) ** 2, 1, atol=1e-5)


def test_walk_within_a_symbolic_loop(interaction: Any) -> None:
    """Eight bounces with materials that change from one to the next: the loop does what the unrolled steps do."""
    names = ["diffuse", "glass", "mask_two", "front_back", "pane"]
    table = MaterialTable.build([BSDFS[k] for k in names], T32)
    indices = T32.UInt(np.array(table.indices, dtype=np.uint32))
    start = (dr.zeros(T32.UInt, N), dr.ones(T32.Array3f, N), T32.Array3f(WI), T32.PCG32(size=N))

    def step(i: Any, weight: Any, wi: Any, rng: Any) -> tuple[Any, Any, Any, Any]:
        samples = [rng.next_float32() for _ in range(3)]
        material = dr.gather(T32.UInt, indices, i % len(names))
        si = interaction(T32, wi)
        s = table.sample(si, material, samples[0], T32.Array2f(samples[1], samples[2]))
        value, pdf = table.eval_pdf(si, material, s.wo)
        ratio = dr.select(s.delta | (pdf <= 0), s.weight, value / pdf)
        return i + 1, weight * ratio, -s.wo, rng

    _, looped, wi, _ = dr.while_loop(start, lambda i, *_: i < 8, step)
    state = (dr.zeros(T32.UInt, N), dr.ones(T32.Array3f, N), T32.Array3f(WI), T32.PCG32(size=N))
    for _ in range(8):
        state = step(*state)
        dr.eval(state)
    assert np.allclose(looped, state[1], atol=1e-5)
    assert np.allclose(wi, state[2], atol=1e-4)


def test_kernels_hold_only_the_kinds_that_occur(interaction: Any) -> None:
    def operations(*names: str) -> int:
        table = MaterialTable.build([BSDFS[k] for k in names], T32)
        si = interaction(T32, WI, UV)
        index = T32.UInt(np.full(N, table.indices[0], dtype=np.uint32))
        result = table.sample(si, index, T32.Float(S1), T32.Array2f(S2)), table.eval_pdf(si, index, T32.Array3f(WO))
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.eval(result)
            return sum(k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT]))

    diffuse, mirror, glass = operations("diffuse"), operations("mirror"), operations("glass")
    assert mirror < operations("copper")
    assert mirror < 30
    assert max(diffuse, glass) < operations("diffuse", "glass") < operations("diffuse", "glass", "copper")
    assert diffuse < operations("two") < operations("mask_two")
    assert glass < operations("mask_glass")


def test_another_albedo_makes_no_other_kernel(interaction: Any) -> None:
    # The same arrays both times: whether memory of NumPy's is aligned shows in kernels, and is a matter of chance.
    si, s1, s2 = interaction(T32, WI, UV), T32.Float(S1), T32.Array2f(S2)
    odd = dr.arange(T32.UInt, N) % 2 == 1
    dr.eval(si, s1, s2, odd)

    def kernel(albedo: float, ior: float) -> Any:
        table = MaterialTable.build([DiffuseBsdf(C((albedo, 0.5, 0.5))), DielectricBsdf(ior, 1.0)], T32)
        first, second = (dr.opaque(T32.UInt, int(i)) for i in table.indices)
        s = table.sample(si, dr.select(odd, second, first), s1, s2)
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.eval(s)
            return [k["hash"] for k in dr.kernel_history([dr.KernelType.JIT])]

    assert kernel(0.1, 1.5) == kernel(0.9, 1.3)


def test_refraction_has_the_derivative_of_snells_law(interaction: Any) -> None:
    t = types("float64")
    table = MaterialTable.build([DielectricBsdf(1.5, 1.0)], t)

    def refracted(angle: Any) -> Any:
        si = interaction(t, t.Array3f(dr.sin(angle), 0, dr.cos(angle)))
        return table.sample(si, t.UInt(table.indices[0]), t.Float(0.9999), t.Array2f(0.5)).wo

    angle = t.Float(np.linspace(-1.2, 4.5, 40))
    dr.enable_grad(angle)
    wo = refracted(angle)
    tangent = dr.forward_to(wo, flags=dr.ADFlag.Default) if dr.forward_from(angle) else dr.grad(wo)
    step = 1e-6
    numeric = (refracted(dr.detach(angle) + step) - refracted(dr.detach(angle) - step)) / (2 * step)
    smooth = np.abs(np.array(numeric)).max(axis=0) < 5
    assert smooth.sum() > 20
    assert np.allclose(np.array(tangent)[:, smooth], np.array(numeric)[:, smooth], atol=1e-5)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="twosided"):
        MaterialTable.build([TwoSidedBsdf(GLASS, GLASS)], T32)
    with pytest.raises(ValueError, match="put the mask around"):
        MaterialTable.build([TwoSidedBsdf(MaskBsdf(DIFFUSE), DIFFUSE)], T32)
    with pytest.raises(ValueError, match="positive"):
        MaterialTable.build([DielectricBsdf(0.0, 1.0)], T32)
    with pytest.raises(ValueError, match="at least one"):
        MaterialTable.build([], T32)
    with pytest.raises(ValueError, match="not in the table"):
        MaterialTable.build([DIFFUSE], T32).index_of(GLASS)
