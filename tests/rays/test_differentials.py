"""Ways to carry ray differentials against each other, their flags, their extremes and their cost."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from differential_chain import MIRROR, Stop, chain, look, perspective, places
from render_cases import camera as camera_dict
from render_cases import rgb, scene

import raytrace2 as rt
from raytrace2.rays.differentials.choose import DIFFERENTIALS
from raytrace2.rays.differentials.trust import FOLDED, LONGEST, SEAM, SILHOUETTE, TOTAL_REFLECTION
from raytrace2.scene.description import (
    BitmapTexture,
    Bsdf,
    BumpMapBsdf,
    ConductorBsdf,
    DielectricBsdf,
    DiffuseBsdf,
    Film,
    Integrator,
    MaskBsdf,
    NormalMapBsdf,
    OrthographicCamera,
    ThinDielectricBsdf,
    ThinLensCamera,
    TwoSidedBsdf,
)

EYE, TARGET = (0.2, -6.0, 1.0), (0.1, 0.0, 0.3)
FILM = Film(64, 64, crop_width=64, crop_height=64)
CAMERAS = {
    "perspective": perspective(EYE, TARGET),
    "thinlens": ThinLensCamera(
        to_world=look(EYE, TARGET), film=FILM, x_fov=40, aperture_radius=0.2, focus_distance=5.0
    ),
    "orthographic": OrthographicCamera(to_world=look(EYE, TARGET) @ np.diag([2.2, 2.2, 2.2, 1.0]), film=FILM),
}
BSDFS: dict[str, tuple[Bsdf, float]] = {
    "mirror": (MIRROR, 0.0),
    "glass, reflected": (DielectricBsdf(1.5, 1.0), 0.0),
    "glass, refracted": (DielectricBsdf(1.5, 1.0), 0.9999),
    "pane, reflected": (ThinDielectricBsdf(1.5, 1.0), 0.0),
    "pane, passed": (ThinDielectricBsdf(1.5, 1.0), 0.9999),
    "mask": (MaskBsdf(ConductorBsdf()), 0.9),
    "two sides": (TwoSidedBsdf(ConductorBsdf(), ConductorBsdf()), 0.0),
    "diffuse": (DiffuseBsdf(), 0.5),
}


def turned(x: float, y: float, z: float, angle: float, *scale: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[c, 0, s], [0.3 * s, 1, 0], [-s, 0, c]]) @ np.diag(scale)
    matrix[:3, 3] = x, y, z
    return matrix


def blob(normals: bool = True) -> rt.TriangleMesh:
    """An octahedron whose normals are a ball's, with skewed uv."""
    v = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    f = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    uv = np.array([[0, 0], [1, 0.2], [0.3, 1], [0.7, 0.1], [0.2, 0.6], [0.9, 0.9]])
    return rt.TriangleMesh(v * 0.8 + [0, 0, 0.4], f, uv=uv, normals=v if normals else None)


def everything(precision: str) -> list[Any]:
    """Each kind of surface, by itself and in an instance that stretches and mirrors it."""
    alone = [
        rt.Sphere.at((-1.2, 0.5, 0.9), 0.5, flip_normals=True),
        rt.Cylinder(turned(1.3, 0.4, 0.2, 0.3, 0.4, 0.6, 0.9)),
        rt.Disk(turned(0.6, -0.6, 1.4, 1.2, 0.4, 0.4, 0.4)),
        rt.Rectangle(turned(0, 6, 0, 0.1, 60, 60, 1) @ np.diag([1, 1, 1, 1.0])),
        blob(),
    ]
    group = rt.accel.build(
        [rt.Sphere.at((0, 0, 0), 0.5), rt.Cylinder(turned(0.9, 0, -0.4, 0.2, 0.3, 0.3, 0.8)), blob(False)],
        "brute_force", precision=precision,
    )  # fmt: skip
    stretch = turned(-0.4, 1.8, -0.5, 0.4, 1.4, 0.7, -0.9)
    return [*alone, rt.Instance(group, stretch)]


@pytest.mark.parametrize("camera", CAMERAS)
def test_autodiff_equals_analytic_for_every_camera(camera: str) -> None:
    agree("analytic", CAMERAS[camera], "glass, refracted")


@pytest.mark.parametrize("bsdf", [b for b in BSDFS if b != "glass, refracted"])
def test_autodiff_equals_analytic_for_every_material(bsdf: str) -> None:
    agree("analytic", CAMERAS["perspective"], bsdf)


@pytest.mark.parametrize("bsdf", ["glass, refracted"])
def test_first_order_of_autodiff2_is_that_of_autodiff(bsdf: str) -> None:
    agree("autodiff2", CAMERAS["thinlens"], bsdf)


def agree(name: str, camera: Any, bsdf: str) -> None:
    material, lobe = BSDFS[bsdf]
    found = [chain(everything("float64"), camera, way, bsdf=material, lobe=lobe, stops=3) for way in ("autodiff", name)]
    seen = 0
    for a, b in zip(*found, strict=True):
        seen += int(a.valid.sum())
        size = np.hypot(np.linalg.norm(a.dx, axis=1), np.linalg.norm(a.dy, axis=1))
        for one, other in ((a.dx, b.dx), (a.dy, b.dy)):
            off = np.linalg.norm(one - other, axis=1)
            assert (off <= 1e-9 * np.maximum(size, 1e-12))[a.valid].all()
        assert (a.flags == b.flags).mean() > 0.999
    assert seen > 300
    assert len({tuple(k) for k in found[0][0].met[found[0][0].valid]}) >= 7


@pytest.mark.parametrize("bsdf", ["mirror", "glass, refracted"])
def test_autodiff_is_what_small_differences_go_to(bsdf: str) -> None:
    material, lobe = BSDFS[bsdf]
    step = 1e-6
    near, far = (
        chain(everything("float64"), CAMERAS["perspective"], way, bsdf=material, lobe=lobe, stops=3, step=step)
        for way in ("finite", "autodiff")
    )
    for a, b in zip(near, far, strict=True):
        plain = b.valid & (b.flags == 0)
        size = np.hypot(np.linalg.norm(b.dx, axis=1), np.linalg.norm(b.dy, axis=1))
        off = np.hypot(np.linalg.norm(a.dx - b.dx, axis=1), np.linalg.norm(a.dy - b.dy, axis=1))
        assert np.median((off / np.maximum(size, 1e-30))[plain]) < 1e-4
        assert np.quantile((off / np.maximum(size, 1e-30))[plain], 0.98) < 1e-2


def test_second_order_is_what_differences_of_the_first_go_to() -> None:
    """Through a ball of glass onto a wall: everything curved at once."""
    camera, glass = CAMERAS["perspective"], DielectricBsdf(1.5, 1.0)
    surfaces = [rt.Sphere.at((0.1, 0, 0.3), 0.9), rt.Rectangle(turned(0, 0, -3, 0, 90, 90, 1))]
    x, y = np.meshgrid(np.linspace(0.42, 0.58, 8), np.linspace(0.45, 0.6, 8))
    x, y = x.ravel(), y.ravel()  # type: ignore[assignment]
    h = 1e-5

    def run(dx: float, dy: float, name: str) -> Stop:
        return chain(surfaces, camera, name, bsdf=glass, stops=3, where=(x + dx, y + dy))[2]

    right, left, here = run(h, 0, "autodiff"), run(-h, 0, "autodiff"), run(0, 0, "autodiff2")
    plain = here.valid & (here.flags == 0) & (right.flags == 0) & (left.flags == 0)
    assert plain.sum() >= 20
    for found, a, b in ((here.second[0], right.dx, left.dx), (here.second[1], right.dy, left.dy)):
        expected = ((a - b) / (2 * h) / 64)[plain]
        off = np.linalg.norm(found[plain] - expected, axis=1) / np.linalg.norm(expected, axis=1)
        assert np.median(off) < 1e-6


@pytest.mark.parametrize("kind", [BumpMapBsdf, NormalMapBsdf])
def test_autodiff_knows_how_maps_bend_normals(kind: Any) -> None:
    """A mirror ball with a relief: its footprints are what small differences of uv go to."""
    v, u = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    waves = np.stack([np.sin(0.8 * u), np.cos(0.8 * v), 0 * u + 9.0], axis=2) * 0.05 + 0.5
    image = BitmapTexture(waves if kind is NormalMapBsdf else waves[:, :, :1] * 0.3, raw=True)
    surfaces = [rt.Sphere.at((0.1, 0, 0.3), 1.4), rt.Rectangle(turned(0, 0, -3, 0, 90, 90, 1))]
    x, y = places(16)
    h = 1e-7

    def run(dx: float, dy: float) -> Stop:
        where = x + dx, y + dy
        return chain(surfaces, CAMERAS["perspective"], "autodiff", bsdf=kind(MIRROR, image), lobe=0.0, where=where)[1]

    here, right, left, down, up = (run(*d) for d in ((0, 0), (h, 0), (-h, 0), (0, h), (0, -h)))
    plain = here.valid & (here.flags == 0) & (here.met[:, 0] == 1)
    for other in (right, left, down, up):
        plain &= other.valid & (other.met == here.met).all(axis=1)
    assert plain.sum() > 30
    dx, dy = (right.uv - left.uv) / (2 * h * 64), (down.uv - up.uv) / (2 * h * 64)
    size = np.hypot(np.linalg.norm(dx, axis=1), np.linalg.norm(dy, axis=1))
    off = np.hypot(np.linalg.norm(here.dx - dx, axis=1), np.linalg.norm(here.dy - dy, axis=1)) / size
    assert np.median(off[plain]) < 1e-6


@pytest.mark.parametrize("name", [n for n in DIFFERENTIALS if n != "none"])
@pytest.mark.parametrize("bsdf", ["mirror", "matched", "glass, refracted"])
def test_footprints_are_finite_at_the_extremes(name: str, bsdf: str) -> None:
    """Grazing rays, poles, the critical angle, an index ratio next to one, singular uv, misses; in float32."""
    glass = DielectricBsdf(np.nextafter(np.float32(1), np.float32(2)), 1.0)
    material, lobe = (glass, 0.9999) if bsdf == "matched" else BSDFS[bsdf]
    flat = rt.TriangleMesh([[-9, 3, -9], [9, 3, -9], [0, 3, 9]], [[0, 1, 2]], uv=[[0.5, 0.5]] * 3)
    surfaces = [
        rt.Rectangle(turned(0, 0, 0, 0, 1e3, 1e3, 1)),
        rt.Sphere.at((0, 0, 1), 1.0),
        rt.Disk(turned(0, -2, 0, 0, 0.3, 0.3, 0.3)),
        rt.Sphere.at((0.5, -1, 1e-3), 1e-3),
        flat,
    ]
    x, y = np.meshgrid([0.0, 0.25, 0.5, 0.500001, 0.75, 1.0], np.concatenate([np.linspace(0.49, 0.51, 41), [0.2, 0.8]]))
    camera = perspective((0, -6, 1), (0, 0, 1))
    stops = chain(
        surfaces, camera, name, bsdf=material, lobe=lobe, stops=4, precision="float32", where=(x.ravel(), y.ravel())
    )
    for stop in stops:
        for v in (stop.dx, stop.dy, *stop.second):
            assert np.isfinite(v).all()
        assert (np.abs(stop.dx) <= LONGEST).all() and (np.abs(stop.dy) <= LONGEST).all()
        assert (stop.dx[~stop.valid] == 0).all()


def flags_at(bit: int, name: str, surfaces: list[Any], where: Any, stop: int = 0, **setting: Any) -> list[bool]:
    camera = perspective((0, -4, 0), (0, 0, 0))
    x, y = (np.array(v, float) for v in zip(*where, strict=True))
    found = chain(surfaces, camera, name, stops=stop + 1, where=(x, y), **setting)[stop]
    return [bool(f & bit) for f in found.flags]


@pytest.mark.parametrize("name", ["finite", "analytic", "autodiff", "autodiff2"])
def test_flags_are_where_they_belong(name: str) -> None:
    ball = [rt.Sphere.at((0, 0, 0), 1.0)]
    # The edge of the ball, on the film: tan(asin(1 / 4)) over that of half the field of view.
    edge = 0.5 + 0.5 * np.tan(np.arcsin(0.25)) / np.tan(np.radians(20))
    assert flags_at(SILHOUETTE, name, ball, [(0.5, 0.52), (edge - 1e-4, 0.5)]) == [False, True]
    # The azimuth starts again at +x; the poles are on top.
    assert flags_at(SEAM, name, [rt.Sphere(turned(0, 0, 0, 0.0, 1, 1, 1))], [(0.5, 0.5)]) == [False]
    pole = rt.Sphere(np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
    assert flags_at(SEAM, name, [pole], [(0.501, 0.501), (0.62, 0.58)]) == [True, False]
    if name != "finite":
        # A beam from afar has its focus at the back of a ball of index 2, and beyond one of index 1.5.
        setting: dict[str, Any] = {"bsdf": DielectricBsdf(1.5, 1.0), "stop": 1}
        assert flags_at(FOLDED, name, ball, [(0.501, 0.501)], **setting) == [False]
        far = perspective((0, -4000, 0), (0, 0, 0), fov=0.04)
        found = chain(
            ball, far, name, bsdf=DielectricBsdf(2.0, 1.0), stops=2, where=(np.array([0.501]), np.array([0.501]))
        )
        assert found[1].flags[0] & FOLDED
    # From inside glass, refraction ends at asin(1 / 1.5).
    prism = np.eye(4)
    critical = np.arcsin(1 / 1.5)
    c, s = np.cos(critical - 0.001), np.sin(critical - 0.001)
    # A face whose normal points along the ray, turned by just under the critical angle.
    prism[:3, :3] = np.array([[c, 0, s], [-s, 0, c], [0, -1, 0]]).reshape(3, 3) * 9
    setting = {"bsdf": DielectricBsdf(1.5, 1.0), "stop": 1, "lobe": 0.99999}
    wall = rt.Rectangle(np.array([[90, 0, 0, 0], [0, 0, -1, 9], [0, 90, 0, 0], [0, 0, 0, 1.0]]))
    assert flags_at(TOTAL_REFLECTION, name, [rt.Rectangle(prism), wall], [(0.5, 0.5)], **setting) == [True]


@pytest.mark.parametrize("integrator", ["path", "direct"])
@pytest.mark.parametrize("name", DIFFERENTIALS)
def test_integrators_carry_every_way(name: str, integrator: str) -> None:
    """Without filters the image is the same to the bit, whatever travels with the rays."""
    things: dict[str, Any] = {"ball": {"type": "sphere", "bsdf": {"type": "dielectric"}}, "light": {"type": "constant"}}
    loaded = rt.load_dict(scene(sensor=camera_dict((6, 6)), **things))
    image = rt.render(loaded, integrator=integrator, differentials=name, filter="bilinear", spp=2)
    plain = rt.render(loaded, integrator=integrator, filter="bilinear", spp=2)
    assert np.isfinite(np.array(image)).all() and np.array_equal(np.array(image), np.array(plain))


def test_flags_are_an_aov() -> None:
    settings = Integrator("aov", aovs=(("why", "footprint_flags"),))
    loaded = rt.load_dict(scene(sensor=camera_dict((32, 32)), ball={"type": "sphere"}))
    flags = np.array(rt.render(loaded, integrator=settings, differentials="autodiff", spp=1)).ravel().astype(int)
    assert (flags & SILHOUETTE).any() and (flags & SEAM).any() and (flags == 0).any()
    assert not np.array(rt.render(loaded, integrator=settings, spp=1)).any()


def test_a_scene_whose_textures_do_not_filter_pays_nothing() -> None:
    """The kernel holds as many operations with differentials as without."""
    things: dict[str, Any] = {
        "ball": {"type": "sphere", "bsdf": {"type": "dielectric"}},
        "light": {"type": "constant"},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": rgb(0.5)}},
    }
    loaded = rt.load_dict(scene(sensor=camera_dict((8, 8)), **things))
    counts = {}
    for name in DIFFERENTIALS:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            dr.eval(rt.render(loaded, differentials=name, spp=1))
            counts[name] = max(k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT]))
    assert len(set(counts.values())) == 1, counts
