"""Pictures of structures: what they draw is where it should be, whatever the camera is and wherever it stands."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raytrace2 as rt
from raytrace2.box_cuts import cut_pixels
from raytrace2.box_edges import CORNERS, Projection, edge_pixels, in_view
from raytrace2.cli import main
from raytrace2.rays.camera import make_camera
from raytrace2.scene.description import Film, OrthographicCamera, PerspectiveCamera
from raytrace2.scene.procedural.scene import View
from raytrace2.structure_pictures import as_sheet, look_at
from raytrace2.types import types

WIDTH, HEIGHT = 160, 120
FILM = Film(width=WIDTH, height=HEIGHT, crop_width=WIDTH, crop_height=HEIGHT)
VIEW = View((0.3, -4.0, 0.5), (0.0, 0.0, 0.0), 50.0)
CROPPED = Film(width=200, height=150, crop_offset_x=30, crop_offset_y=10, crop_width=80, crop_height=60)
CAMERAS = {
    "pinhole": VIEW.camera(WIDTH, HEIGHT),
    "shifted": PerspectiveCamera(
        to_world=VIEW.to_world, x_fov=60, film=FILM, principal_point_offset_x=0.1, principal_point_offset_y=-0.2
    ),
    "cropped": PerspectiveCamera(to_world=VIEW.to_world, x_fov=60, film=CROPPED),
    "orthographic": OrthographicCamera(to_world=VIEW.to_world @ np.diag([2.0, 2.0, 1, 1]), film=FILM),
    "orthographic, cropped": OrthographicCamera(to_world=VIEW.to_world, film=CROPPED),
}
UNIT = np.full((1, 3), -0.6), np.full((1, 3), 0.6)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_projection_is_the_inverse_of_the_camera(camera):
    """Points on rays land on the pixels that the rays went through, as deep as they are."""
    t = types("float64")
    u, v = np.random.default_rng(0).uniform(0, 1, (2, 100))
    ray = make_camera(camera, t).sample_ray(t.Array2f(u, v), t.Array2f(0.5))
    o, d = np.array(ray.o).T, np.array(ray.d).T
    points = o + np.random.default_rng(1).uniform(0, 5, (100, 1)) * d
    found = Projection.of(camera)(points)
    np.testing.assert_allclose(found[:, 0] / found[:, 2], u, atol=1e-9)
    np.testing.assert_allclose(found[:, 1] / found[:, 2], v, atol=1e-9)
    assert (np.sign(found[:, 3]) > 0).all()
    deeper = Projection.of(camera)(points + d)
    assert (deeper[:, 3] > found[:, 3]).all()


def test_segments_are_cut_to_the_view():
    rng = np.random.default_rng(2)
    projection = Projection.of(CAMERAS["pinhole"])
    ends = projection(rng.normal(size=(2, 2_000, 3)) * 4)
    begin, end, some = in_view(*ends, projection.near)
    assert 100 < len(some) < 2_000
    for p in (begin, end):
        assert (p[:, 3] >= projection.near - 1e-9).all()
        assert (p[:, :2] >= -1e-9).all() and (p[:, :2] <= p[:, 2:3] + 1e-9).all()
    # What is in the view of each segment is what is left of it.
    along = rng.uniform(size=(2_000, 200, 1))
    points = ends[0][:, None] + along * (ends[1] - ends[0])[:, None]
    seen = (points[..., 3] >= projection.near) & (points[..., :2] >= 0).all(-1)
    seen &= (points[..., :2] <= points[..., 2:3]).all(-1)
    kept = np.isin(np.arange(2_000), some)
    assert not seen[~kept].any()
    length = np.zeros(2_000)
    length[some] = np.linalg.norm(end - begin, axis=1) / np.linalg.norm((ends[1] - ends[0])[some], axis=1)
    assert np.abs(seen.mean(axis=1) - length).max() < 0.2


def test_an_edge_is_in_front_of_what_lies_behind_it():
    projection = Projection.of(CAMERAS["pinhole"])
    far, near = (np.full((HEIGHT, WIDTH), depth) for depth in (np.inf, 0.5))
    front, behind, seen = edge_pixels(projection, *UNIT, far)
    hidden_front, hidden_behind, _ = edge_pixels(projection, *UNIT, near)
    assert seen.all() and front.any() and not behind.any() and not hidden_front.any()
    np.testing.assert_array_equal(front, hidden_behind)
    # All corners are among the pixels, and the middles of edges.
    corner = np.where(CORNERS, *UNIT[::-1])
    at = projection(np.concatenate([corner, (corner[0] + corner[1:2]) / 2]))
    x, y = ((at[:, k] / at[:, 2] * size).astype(int) for k, size in ((0, WIDTH), (1, HEIGHT)))
    assert front[y, x].all()


def test_what_is_behind_the_camera_is_not_drawn():
    projection = Projection.of(CAMERAS["pinhole"])
    behind_it = tuple(corner - [0, 20, 0] for corner in UNIT)
    front, behind, seen = edge_pixels(projection, *behind_it, np.full((HEIGHT, WIDTH), np.inf))
    assert not (front.any() or behind.any() or seen.any())


def test_a_box_around_the_camera_shows_where_it_cuts_a_wall():
    """A wall at y = 0, and a box that ends within the view: its sides are lines on the wall, at the right places."""
    camera = dataclasses.replace(VIEW, eye=(0.0, -2.0, 0.0)).camera(WIDTH, HEIGHT)
    x = (0.5 - (np.arange(WIDTH) + 0.5) / WIDTH) * 2 * np.tan(np.radians(25)) * 2
    # Camera space has x to the left, the world's is to the right.
    points = np.zeros((HEIGHT, WIDTH, 3))
    points[..., 0] = -x
    depth = np.full((HEIGHT, WIDTH), 2.0)
    lo, hi = np.array([[-0.5, -3, -3]]), np.array([[0.25, 3.0, 3]])
    assert not edge_pixels(Projection.of(camera), lo, hi, depth)[0].any()
    cut, held = cut_pixels(Projection.of(camera), lo, hi, points, depth)
    assert held.all()
    columns = np.flatnonzero(cut.any(axis=0))
    np.testing.assert_array_equal(columns, [np.searchsorted(-x, side) - 1 for side in (-0.5, 0.25)])
    assert cut[:, columns].all()


@pytest.mark.parametrize("kind", rt.accel.names())
def test_every_structure_has_a_picture(kind):
    scene = rt.scenes.make("architecture", 400)
    structure = rt.accel.build(scene, kind)
    structure.prepare()
    view = look_at(structure, scene.view.camera(WIDTH, HEIGHT), kind)
    assert view.boxes.shape == (HEIGHT, WIDTH, 3)
    assert view.cost.max() > 0
    if kind != "brute_force":
        assert any(level.number > 0 for level in view.levels)
        assert all(0 < level.seen <= level.boxes for level in view.levels)
    sheet = as_sheet([view, view])
    assert sheet.dtype == np.uint8 and sheet.shape[1] == 2 * WIDTH and sheet.shape[0] > 2 * HEIGHT
    np.testing.assert_array_equal(sheet[:, :WIDTH][: 2 * HEIGHT], sheet[:, WIDTH:][: 2 * HEIGHT])


def test_over_nothing():
    structure = rt.accel.build([], "bvh")
    structure.prepare()
    view = look_at(structure, CAMERAS["pinhole"], "bvh")
    assert view.levels == () and not view.boxes.any()
    assert as_sheet([view]).shape[1] == WIDTH


def test_on_the_command_line(tmp_path, capsys):
    output = tmp_path / "room.png"
    room = Path(__file__).parent.parent / "scenes" / "igehy_room.xml"
    options = ["--accel", "bvh", "--accel", "grid", "--size", "96x72", "-o", str(output)]
    assert main(["accel", "show", str(room), *options]) == 0
    assert Image.open(output).width == 192
    assert main(["accel", "show", "balls:200", *options]) == 0
    assert "primitives a ray" in capsys.readouterr().out
    for wrong in ("balls:x", "no_such_scene"):
        assert main(["accel", "show", wrong, "-o", str(output)]) != 0


def test_a_fine_grid_is_drawn_where_it_cuts_surfaces():
    """All edges of its cells would hide everything."""
    scene = rt.scenes.make("mountain", 20_000)
    structure = rt.accel.build(scene, "grid")
    structure.prepare()
    level = look_at(structure, scene.view.camera(WIDTH, HEIGHT), "grid").levels[-1]
    assert level.number == 1 and level.dense and not level.behind.any()
    assert 0.05 < level.covered < 0.6 and 0 < level.seen < level.boxes
