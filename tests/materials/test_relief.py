"""Bump and normal maps: frames and images as Mitsuba's, derivatives of rays through them, and maps over footprints."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from render_cases import ball, both, corner, diffuse, lamp, mitsuba, ours, rgb, same_share, scene, theirs

import raytrace2 as rt
from raytrace2.materials import MaterialTable
from raytrace2.materials.bump import Heights
from raytrace2.materials.relief_moments import WIDE, _tiled, gradients, moments, slopes
from raytrace2.materials.spread import Spread
from raytrace2.rays.camera import make_camera
from raytrace2.rays.differentials import make_differentials
from raytrace2.scene.color import linear_pixels
from raytrace2.scene.description import BitmapTexture, BumpMapBsdf, DiffuseBsdf, MaskBsdf, NormalMapBsdf
from raytrace2.types import types

RNG = np.random.default_rng(1)
HEIGHTS = RNG.random((16, 12, 1)).astype(np.float32)
NORMALS = np.concatenate([RNG.uniform(0.2, 0.8, (9, 11, 2)), RNG.uniform(0.7, 1, (9, 11, 1))], axis=2).astype(
    np.float32
)
ROUGH = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4, "distribution": "ggx", "material": "Au"}


def bitmap(pixels: np.ndarray, scale: Any, **more: Any) -> dict[str, Any]:
    mi = mitsuba()
    to_uv = mi.ScalarTransform4f().scale(scale)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "to_uv": to_uv, **more}


def bump(nested: Any, **more: Any) -> dict[str, Any]:
    return {"type": "bumpmap", "height": bitmap(HEIGHTS, [2, 3, 1]), "scale": 0.05, "nested": nested, **more}


def normal_map(nested: Any, **more: Any) -> dict[str, Any]:
    return {"type": "normalmap", "normalmap": bitmap(NORMALS, 2, wrap_mode="mirror"), "nested": nested, **more}


def two(*sides: Any) -> dict[str, Any]:
    return {"type": "twosided", **{f"side{k}": side for k, side in enumerate(sides)}}


def mask(nested: Any) -> dict[str, Any]:
    return {"type": "mask", "opacity": 0.6, "nested": nested}


def panel(bsdf: Any, angle: float = 30) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": mitsuba().ScalarTransform4f().rotate([0, 1, 0], angle), "bsdf": bsdf}


IMAGES: dict[str, Any] = {
    "bump on a ball": lambda: ball(bump(diffuse(0.5))),
    "normals on a ball": lambda: ball(normal_map(diffuse(0.5))),
    "flags": lambda: panel(normal_map(diffuse(0.5), use_shadowing_function=False, flip_invalid_normals=False)),
    "mirror": lambda: panel(bump({"type": "conductor"})),
    "glass": lambda: ball(normal_map({"type": "dielectric"})),
    "rough": lambda: panel(bump(ROUGH)),
    "both sides": lambda: panel(two(bump(diffuse(0.5)), normal_map(ROUGH)), 150),
    "around two sides": lambda: panel(bump(two(diffuse(0.5), ROUGH)), 150),
    "masked": lambda: panel(mask(normal_map(two(ROUGH))), 150),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images_are_mitsubas_sample_for_sample(name: str) -> None:
    a, b = both(scene(**corner(lamp=lamp(), thing=IMAGES[name]())))
    assert np.isfinite(a).all()
    assert same_share(a, b) > 0.9
    assert abs(a - b).mean() < 2e-3 * b.mean()


@pytest.mark.parametrize("around", [bump, normal_map])
@pytest.mark.parametrize("shape", [ball, panel])
def test_shading_normals_are_mitsubas(around: Any, shape: Any) -> None:
    source = scene(
        thing=shape(around(diffuse(0.5))), integrator={"type": "aov", "aovs": "n:sh_normal,d:dp_du,g:geo_normal"}
    )
    source["sensor"]["sampler"] = {"type": "stratified", "jitter": False, "sample_count": 1}
    found, expected = ours(source, spp=1), theirs(source, spp=1)
    n, dp_du, n_g = (expected[..., k : k + 3] for k in (0, 3, 6))
    if around is bump:  # Mitsuba gives it in the shading frame; that of these shapes has the geometric normal
        s = dp_du - n_g * (n_g * dp_du).sum(axis=-1, keepdims=True)
        s /= np.maximum(np.linalg.norm(s, axis=-1, keepdims=True), 1e-20)
        n = s * n[..., :1] + np.cross(n_g, s) * n[..., 1:2] + n_g * n[..., 2:]
    assert np.abs(found[..., :3] - n).max() < 1e-5


@pytest.mark.parametrize("material", ["conductor", "dielectric"])
@pytest.mark.parametrize("around", [bump, normal_map])
@pytest.mark.parametrize("shape", [ball, panel])
def test_differentials_bend_with_the_normals(shape: Any, around: Any, material: str) -> None:
    """Where no edge of texels is near, derivatives of what leaves are differences of rays beside it."""
    t, h = types("float64"), 1e-6
    loaded = rt.load_dict(scene(thing=shape(around({"type": material}, flip_invalid_normals=False))))
    traced = loaded.traced(None, "float64")
    traced.prepare_shading()
    camera = make_camera(loaded.description.cameras[0], t)
    at = np.random.default_rng(0).random((2, 1000)) * 0.4 + 0.3

    def leaving(name: str, at: np.ndarray) -> tuple[Any, Any, Any]:
        way = make_differentials(name, (t.Float(h), t.Float(h)), 1.0)
        ray, state = way.start(camera, t.Array2f(at), None)
        meeting = way.meet(traced.structure, ray, state, traced.structure.intersect(ray, True))
        si, scatter = meeting.si, meeting.scatter
        sample = traced.materials.sample(scatter, traced.material(si, si.valid), t.Float(0.9), t.Array2f(0.5), si.valid)
        onward = scatter.spawn_ray(scatter.to_world(sample.wo))
        return np.array(si.valid), np.array(onward.d), way.leave(meeting, sample, onward, state)

    valid, _, state = leaving("autodiff", at)
    step = np.array([[h], [0]])
    expected = (leaving("none", at + step)[1] - leaving("none", at - step)[1]) / 2
    found = np.array(state.d_dx)
    error = np.abs(found - expected).max(axis=0) / (np.abs(expected).max(axis=0) + 1e-12)
    assert valid.sum() > 300
    assert np.median(error[valid]) < 1e-6


def test_a_flat_map_changes_nothing() -> None:
    flat = np.full((4, 4, 3), [0.5, 0.5, 1.0], np.float32)
    mapped = {"type": "normalmap", "normalmap": bitmap(flat, 1), "nested": diffuse(0.5)}
    things = [corner(lamp=lamp(), thing=panel(b)) for b in (mapped, diffuse(0.5))]
    a, b = (ours(scene(**t), spp=4) for t in things)
    assert np.allclose(a, b, rtol=1e-4, atol=1e-6)
    filtered = ours(scene(**things[0]), spp=4, filter="trilinear", differentials="analytic")
    assert np.allclose(filtered, b, rtol=1e-4, atol=1e-6)


def _moments(image: BitmapTexture, values: Any) -> np.ndarray:
    pixels = WIDE.TensorXf(np.ascontiguousarray(linear_pixels(image), np.float64))
    return np.concatenate([m.numpy() for m in moments(pixels, image.wrap_mode, values)], axis=-1)


def test_moments_are_those_of_the_interpolated_map() -> None:
    """Means over the whole image of moments by texel are those of a fine sampling of the map itself."""
    u, v = np.meshgrid(*((np.arange(16 * n) + 0.5) / 16 for n in (12, 16)))
    x, y = u - 0.5, v - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    h = linear_pixels(BitmapTexture(HEIGHTS))
    corners = [[h[(j + b) % 16, (i + a) % 12, 0]] for b in (0, 1) for a in (0, 1)]
    gx, gy = gradients(corners, x - i, y - j, 12, 16)
    expected = [np.mean(m) for m in (gx, gy, gx * gy, gx * gx, gy * gy)]
    found = _moments(BitmapTexture(HEIGHTS, raw=True), gradients).mean(axis=(0, 1))
    scale = expected[3]
    assert np.allclose(found[:5], expected, atol=2e-3 * scale)
    one = np.full((2, 2, 3), [0.5 + 0.3, 0.5, 0.5 + 0.4], np.float32)
    assert np.allclose(_moments(BitmapTexture(one, raw=True), slopes)[0, 0], [-0.75, 0, 0, 0.5625, 0, 0], atol=1e-6)


def test_a_mirrored_map_has_mirrored_gradients() -> None:
    """Laid out with its mirror images, a mirrored height map repeats: the same gradients everywhere."""
    t = types("float64")
    source = BitmapTexture(
        HEIGHTS, wrap_mode="mirror", raw=True, to_uv=np.array([[1.5, 0.2, 0.1], [0.3, 2, 0], [0, 0, 1]])
    )
    uv = np.random.default_rng(3).uniform(-2, 3, (2, 500))
    found = [
        np.array(Heights([m], t).gradient(t.UInt(0), t.Array2f(uv), t.Bool(True))) for m in (source, _tiled(source))
    ]
    assert np.allclose(found[0], found[1], atol=1e-6 * np.abs(found[0]).max())


@pytest.mark.parametrize("xy", [0.0, 1e-7, -1e-5, 1e-3])
def test_axes_of_a_spread_keep_their_digits(xy: float) -> None:
    found = []
    for precision in ("float32", "float64"):
        t = types(precision)
        b = t.Float(xy)
        dr.enable_grad(b)
        first, second, c, s = Spread(t.Float(0.02), b, t.Float(0.05)).roughened(t.Float(0.01), t.Float(0.02))
        dr.forward(b)
        found.append([float(x[0]) for x in (first, second, c, s, dr.grad(c))])
    assert found[0] == pytest.approx(found[1], rel=1e-5)


@pytest.mark.parametrize(("unlike", "xy"), [(1e-4, 1e-6), (1e-5, 1e-7), (1e-6, 1e-5)])
def test_derivatives_of_spreads_that_are_nearly_round(unlike: float, xy: float) -> None:
    """Put together again, axes are the covariance that they are the axes of, and so are their derivatives."""
    t = types("float32")
    for entry, expected in enumerate([(2, 0, 0), (0, 2, 0), (0, 0, 2)]):
        given = [t.Float(0.02 + unlike), t.Float(xy), t.Float(0.02)]
        dr.enable_grad(given)
        first, second, c, s = Spread(*given).roughened(t.Float(0.1), t.Float(0.1))
        u, v = first * first, second * second
        dr.backward((u * c * c + v * s * s, (u - v) * c * s, u * s * s + v * c * c)[entry])
        assert [float(dr.grad(g)[0]) for g in given] == pytest.approx(expected, abs=0.02)


def test_spread_adds_covariances() -> None:
    t = types("float64")
    spread = Spread(t.Float(0.02), t.Float(0.01), t.Float(0.05))
    first, second, c, s = (float(x[0]) for x in spread.roughened(t.Float(0.1), t.Float(0.3)))
    axes = np.array([[c, -s], [s, c]])
    found = axes @ np.diag([first**2, second**2]) @ axes.T
    assert np.allclose(found, [[0.01 + 0.04, 0.02], [0.02, 0.09 + 0.1]])
    none = Spread(t.Float(0), t.Float(0), t.Float(0))
    assert [float(x[0]) for x in none.roughened(t.Float(0.1), t.Float(0.3))][:2] == pytest.approx([0.3, 0.1])
    slope = np.random.default_rng(0).multivariate_normal([0, 0], [[0.02, 0.01], [0.01, 0.05]], 200_000)
    normal = np.column_stack([-slope, np.ones(len(slope))]) / np.sqrt(1 + (slope**2).sum(axis=1, keepdims=True))
    for wo in ([0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.995, 0.0999]):
        mean = np.maximum(normal @ np.array(wo), 0).mean()
        assert float(spread.cosine(t.Array3f(*wo))[0]) == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize(
    "nested", [diffuse(0.8), {"type": "roughconductor", "alpha": 0.3}, {"type": "conductor"}, {"type": "dielectric"}]
)
def test_distant_maps_keep_their_shading(nested: dict[str, Any]) -> None:
    """A map of which each pixel sees many texels: filtered at one sample, the mean is that of many samples without."""
    mi = mitsuba()
    T = mi.ScalarTransform4f()
    rng = np.random.default_rng(2)
    normals = np.concatenate([rng.uniform(0.35, 0.65, (32, 32, 2)), np.full((32, 32, 1), 0.97)], axis=2).astype(
        np.float32
    )
    mapped = {"type": "normalmap", "normalmap": bitmap(normals, 16), "nested": nested}
    source = scene(
        floor={"type": "rectangle", "bsdf": mapped, "to_world": T.rotate([1, 0, 0], -30).scale(6)},
        sky={
            "type": "envmap",
            "bitmap": mi.Bitmap(np.linspace(0, 1, 16 * 32 * 3).reshape(16, 32, 3).astype(np.float32)),
        },
        integrator={"type": "direct"},
    )
    truth = ours(source, spp=256, filter="bilinear")
    found = ours(source, spp=1, filter="trilinear", differentials="analytic")
    assert found.mean(axis=(0, 1)) == pytest.approx(truth.mean(axis=(0, 1)), rel=0.06)


def test_scenes_without_maps_pay_nothing(interaction: Any) -> None:
    t = types("float32")

    def operations(*bsdfs: Any) -> int:
        table = MaterialTable.build(list(bsdfs), t)
        si = interaction(t, np.tile([[0.0], [0.6], [0.8]], (1, 100)))
        result = table.sample(si, t.UInt(table.indices[0]), t.Float(0.5), t.Array2f(0.3))
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.eval(result)
            return sum(k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT]))

    plain = DiffuseBsdf()
    assert operations(plain) < 60
    assert operations(plain) < operations(BumpMapBsdf(plain, BitmapTexture(HEIGHTS)))


def test_what_cannot_be_is_refused() -> None:
    t = types("float32")
    normals = BitmapTexture(NORMALS)
    with pytest.raises(ValueError, match="put the mask around the map"):
        MaterialTable.build([NormalMapBsdf(MaskBsdf(DiffuseBsdf()), normals)], t)
    with pytest.raises(ValueError, match="merge the two maps"):
        MaterialTable.build([BumpMapBsdf(NormalMapBsdf(DiffuseBsdf(), normals), BitmapTexture(HEIGHTS))], t)
    for bsdf, message in (
        (bump(mask(diffuse(0.5))), "put the mask around it"),
        (bump(normal_map(diffuse(0.5))), "merge the two maps"),
        (two(bump({"type": "dielectric"})), "transmits"),
        ({"type": "normalmap", "normalmap": bitmap(HEIGHTS, 1), "b": diffuse(0.5)}, "three channels"),
        ({"type": "bumpmap", "t": {"type": "checkerboard"}, "b": diffuse(0.5)}, "has no gradient"),
        ({"type": "roughconductor", "alpha_u": 0.1}, "both 'alpha_u' and 'alpha_v'"),
        (
            {"type": "bumpmap", "t": bitmap(HEIGHTS, 1), "b": {"type": "diffuse", "reflectance": rgb(0.5)}, "x": 1.0},
            "'x'",
        ),
    ):
        with pytest.raises(rt.SceneError, match=message):
            rt.load_dict(scene(thing=ball(bsdf)))
