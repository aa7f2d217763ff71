"""Procedural scenes have the size that was asked for, come out the same every time, and can be seen from their
views."""

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.scene import procedural
from raytrace2.scene.procedural.mesh_parts import boxes
from raytrace2.scene.procedural.teapot import teapot_mesh, teapot_patches
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Quadric, Sphere

NAMES = procedural.names()
OF_QUADRICS = {"balls", "shells", "lattice", "rings", "tree"}
WITHOUT_CHANCE = {"balls", "lattice", "stadium", "teapot", "tetra"}


def numbers(scene) -> np.ndarray:
    """Every coordinate in the scene."""
    parts = [s.vertices if isinstance(s, TriangleMesh) else s.to_world for s in scene]
    return np.concatenate([p.ravel() for p in parts])


@pytest.mark.parametrize("name", NAMES)
def test_sizes_are_about_what_was_asked_for(name):
    for size, least in ((100, 0.5), (1_000, 0.75), (3_000, 0.85), (40_000, 0.9)):
        if name not in OF_QUADRICS or size <= 3_000:
            count = procedural.make(name, size).primitive_count
            assert least * size <= count <= 1.25 * size, (size, count)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_arguments_give_the_same_scene(name):
    a, b, other = (numbers(procedural.make(name, 500, seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.isfinite(a).all()
    assert (len(a) == len(other) and (a == other).all()) == (name in WITHOUT_CHANCE)


@pytest.mark.parametrize("name", NAMES)
def test_views_see_the_scene(name):
    scene = procedural.make(name, 1_000)
    structure = accel.build(scene)
    hit = structure.intersect(Ray(*scene.view.rays(64, 48)))
    surfaces = hit.surface.numpy()[hit.valid.numpy()]
    assert 0.1 < hit.valid.numpy().mean()
    assert len(np.unique(hit.prim.numpy())) > 20 or len(np.unique(surfaces)) > 20
    lo, hi = structure.bounds()
    assert np.abs(lo).max() < 1e4 and (hi - lo > 0).all()


def test_scenes_of_quadrics_hold_quadrics():
    kinds = {name: {type(s) for s in procedural.make(name, 300)} for name in NAMES}
    assert {n for n, k in kinds.items() if any(issubclass(t, Quadric) for t in k)} == OF_QUADRICS | {"mountain"}
    assert kinds["balls"] == kinds["shells"] == {TriangleMesh, Sphere}
    assert kinds["lattice"] == {Sphere, Cylinder}


def test_scenes_are_sequences_of_surfaces():
    scene = procedural.make("teapot")
    assert len(scene) == 2 and scene[0].name == "teapot" and [s.name for s in scene[:]] == ["teapot", "table"]
    assert abs(scene.primitive_count - 10_000) < 1_000


def test_unknown_names_and_sizes_are_refused():
    with pytest.raises(ValueError, match="unknown scene 'dragon'; there are architecture, balls"):
        procedural.make("dragon")
    for size in (99, 0, -1, 1000.5, float("nan"), True):
        with pytest.raises(ValueError, match="size"):
            procedural.make("soup", size)


def test_the_middle_of_the_view_is_its_target():
    view = procedural.make("gears").view
    o, d = view.rays(3, 3)
    towards = np.array(view.target) - view.eye
    np.testing.assert_allclose(d[4] / np.linalg.norm(d[4]), towards / np.linalg.norm(towards), atol=1e-12)
    assert d[1, 2] > d[4, 2] > d[7, 2]
    right = np.cross(towards, view.up)
    assert d[5] @ right > 0 > d[3] @ right
    camera = view.camera(300, 200)
    np.testing.assert_array_equal(camera.to_world, view.to_world)
    assert (camera.film.width, camera.film.height, camera.x_fov) == (300, 200, view.x_fov)
    linear = view.to_world[:3, :3]
    np.testing.assert_allclose(linear.T @ linear, np.eye(3), atol=1e-12)
    assert np.linalg.det(linear) > 0


def test_rays_pass_through_the_middles_of_pixels():
    view = procedural.View((1.0, 2.0, 3.0), (0.0, -1.0, 0.5), x_fov=50.0)
    width, height = 6, 4
    _, d = view.rays(width, height)
    local = d @ np.linalg.inv(view.to_world[:3, :3]).T
    half = np.tan(np.radians(50.0 / 2))
    np.testing.assert_allclose(local[:, 2], 1)
    np.testing.assert_allclose(local[0, :2], (half * (1 - 1 / width), half * (1 - 1 / height) * height / width))


def test_patches_of_the_teapot_meet():
    patches = teapot_patches()
    assert patches.shape == (32, 4, 4, 3)
    for ring in patches[:24].reshape(6, 4, 4, 4, 3):
        for k in range(4):
            np.testing.assert_allclose(ring[k][:, 3], ring[(k + 1) % 4][:, 0], atol=1e-12)
    rim, body, foot, knob, lid, bottom = patches[0:24:4]
    for above, below in ((rim[3], body[0]), (body[3], foot[0]), (foot[3], bottom[3]), (knob[3], lid[0])):
        np.testing.assert_array_equal(above, below)
    for k in (24, 28):
        np.testing.assert_array_equal(patches[k][3], patches[k + 2][0])
        np.testing.assert_array_equal(patches[k][:, 0] * (1, -1, 1), patches[k + 1][:, 0])
    assert tuple(patches[..., 2].max(axis=(1, 2))[:4]) == (2.53125,) * 4 and patches[..., 0].max() == 3.525


def test_the_teapot_is_whole():
    vertices, faces = teapot_mesh(6)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert len(faces) == 32 * 72 - 8 * 6 and (area > 0).all()
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    welded = same.ravel()[faces]
    edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    # Open where the lid lies, at its own edge, at the tip of the spout, and where spout and handle enter the body.
    assert (counts == 1).sum() == 16 * 6 and counts.max() == 2
    assert np.ptp(vertices, axis=0).round(1).tolist() == [6.4, 4.0, 3.2]


def test_boxes_are_closed_and_turn():
    vertices, faces = boxes([(1.0, 2.0, 3.0)], (2.0, 4.0, 6.0), np.pi / 2)
    np.testing.assert_allclose(vertices.min(axis=0), (-1, 1, 0), atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), (3, 3, 6), atol=1e-12)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(48)
