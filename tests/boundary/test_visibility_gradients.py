"""Derivatives of images in which edges move: closed forms, and differences of renders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import raytrace2 as rt
from raytrace2.boundary.mesh_edges import NO_VERTEX, mesh_edges, welded

SIZE = 16
FILM = f"""<film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
    <rfilter type="box"/></film>"""
ABOVE = f"""<sensor type="orthographic"><transform name="to_world">
    <lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>{FILM}</sensor>"""
ASIDE = f"""<sensor type="orthographic"><transform name="to_world">
    <lookat origin="-5,0,5" target="0,0,0" up="0,1,0"/></transform>{FILM}</sensor>"""
NEAR = f"""<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
    <lookat origin="0.2,0.1,4" target="0,0,0" up="0,1,0"/></transform>{FILM}</sensor>"""
GLOW = '<emitter type="area"><rgb name="radiance" value="2"/></emitter>'
FLOOR = '<shape type="rectangle"><transform name="to_world"><scale value="5"/></transform></shape>'


def load(*parts: str, integrator: str = "path") -> rt.Scene:
    return rt.load_string(
        f'<scene version="3.0.0"><integrator type="{integrator}"><integer name="max_depth" value="2"/></integrator>'
        f"{''.join(parts)}</scene>".replace('<integer name="max_depth" value="2"/>', "" if integrator == "direct" else
        '<integer name="max_depth" value="2"/>')
    )  # fmt: skip


def gradient(scene: rt.Scene, key: str, *, spp: int = 64, precision: str = "float64", weights: Any = None,
             **how: Any) -> np.ndarray:  # fmt: skip
    """The derivatives of the (weighted) sum of the image."""
    params = rt.traverse(scene, precision)
    params[key] = dr.detach(params[key])
    dr.enable_grad(params[key])
    params.update()
    image = rt.render(scene, params, spp=spp, **({"visibility_gradients": True} | how))
    if weights is not None:
        image = image * params.types.TensorXf(weights)
    dr.backward(dr.sum(image.array))
    return np.array(dr.grad(params[key]).numpy(), np.float64).squeeze()


def triangle_file(folder: Path) -> str:
    path = folder / "triangle.obj"
    path.write_text("v -.7 -.5 0\nv .8 -.6 .3\nv .1 .9 -.2\nf 1 2 3\n")
    return str(path)


def test_area_of_a_triangle(tmp_path: Path) -> None:
    shape = f'<shape type="obj" id="m"><string name="filename" value="{triangle_file(tmp_path)}"/>{GLOW}</shape>'
    scene = load(ABOVE, shape)
    x = np.array(rt.traverse(scene, "float64")["m.vertex_positions"].numpy()).reshape(3, 3)
    found = gradient(scene, "m.vertex_positions").reshape(3, 3)
    after, before = np.roll(x, -1, 0), np.roll(x, 1, 0)
    wanted = np.column_stack([after[:, 1] - before[:, 1], before[:, 0] - after[:, 0], np.zeros(3)]) / 2
    np.testing.assert_allclose(found, wanted * 2 * 3 * (SIZE / 2) ** 2, atol=0.5)
    without = gradient(scene, "m.vertex_positions", visibility_gradients=False)
    assert np.abs(without).max() < 1e-6


def test_meshes_that_join(tmp_path: Path) -> None:
    """Flat, of their own light each: what one mesh wins the other loses."""
    corners = {"a": "v -.7 0 0\nv 0 -.6 0\nv .1 .6 0", "b": "v .7 0 0\nv .1 .6 0\nv 0 -.6 0"}
    shapes = ""
    for name, radiance in (("a", 1), ("b", 3)):
        (tmp_path / name).with_suffix(".obj").write_text(corners[name] + "\nf 1 2 3\n")
        shapes += f"""<shape type="obj" id="{name}"><string name="filename" value="{tmp_path / name}.obj"/>
            {GLOW.replace('"2"', f'"{radiance}"')}</shape>"""
    params = rt.traverse(scene := load(ABOVE, shapes), "float64")
    for name in "ab":
        key = f"{name}.vertex_positions"
        x = np.array(params[key].numpy()).reshape(-1, 3)
        params[key] = x.ravel()
        dr.enable_grad(params[key])
        moved = np.column_stack([np.abs(x[:, 1]) > 0.3, np.zeros((3, 2))])
        dr.set_grad(params[key], type(params[key])(moved.ravel()))
    params.update()
    image = rt.render(scene, params, spp=64, visibility_gradients=True)
    dr.forward_to(image)
    assert np.array(dr.grad(image)).sum() == pytest.approx((1 - 3) * 0.6 * 3 * (SIZE / 2) ** 2, rel=5e-3)


@pytest.mark.parametrize("kind, precision", [("disk", "float32"), ("sphere", "float64")])
def test_radius(kind: str, precision: str) -> None:
    shape = f"""<shape type="{kind}" id="m"><transform name="to_world"><scale value="0.6"/>
        <translate x="0.1" y="-0.05"/></transform>{GLOW}</shape>"""
    found = gradient(load(ABOVE, shape), "m.to_world", precision=precision)
    # On the film the area is that of the image of the unit circle.
    grown = found[0, 0] + found[1, 1] + found[2, 2]
    assert grown == pytest.approx(2 * np.pi * 0.6 * 2 * 3 * (SIZE / 2) ** 2, rel=2e-3)
    assert abs(found[0, 3]) < 0.01 * grown and abs(found[1, 3]) < 0.01 * grown


@pytest.mark.parametrize("kind, precision", [("sphere", "float32"), ("disk", "float64")])
def test_area_of_a_shadow(kind: str, precision: str) -> None:
    shape = f"""<shape type="{kind}" id="m"><transform name="to_world"><scale value="0.4"/><translate z="3"/>
        </transform></shape>"""
    sun = '<emitter type="directional"><vector name="direction" value="0,0,-1"/></emitter>'
    found = gradient(load(ASIDE, FLOOR, shape, sun), "m.to_world", precision=precision)
    radiance = 0.5 / np.pi * 3
    wanted = -2 * np.pi * 0.4 * radiance * (SIZE / 2) ** 2 * np.sqrt(0.5)
    assert found[0, 0] + found[1, 1] + found[2, 2] == pytest.approx(wanted, rel=5e-3)
    assert abs(found[2, 3]) < 1e-2 * abs(wanted)


def difference(scene: rt.Scene, key: str, step: np.ndarray, weights: np.ndarray, seeds: int) -> np.ndarray:
    """Central differences of the weighted sum, one a seed."""
    params = rt.traverse(scene, "float64")
    start = np.array(params[key].numpy())

    def total(value: np.ndarray, seed: int) -> float:
        params[key] = value
        params.update()
        return float((np.array(rt.render(scene, params, seed=seed, spp=1024)) * weights).sum())

    found = [(total(start + step, s) - total(start - step, s)) / 2 for s in range(seeds)]
    params[key] = start
    params.update()
    return np.array(found)


@pytest.mark.parametrize(
    "light",
    [
        f"""<shape type="rectangle"><transform name="to_world"><scale value="0.7"/>
            <lookat origin="1.5,2,3" target="0,0,0" up="0,1,0"/></transform>{GLOW}</shape>""",
    ],
    ids=["rectangle"],
)
def test_cube_over_a_floor(light: str) -> None:
    """Silhouettes, creases and shadows at once, against differences."""
    cube = """<shape type="cube" id="m"><boolean name="face_normals" value="true"/><transform name="to_world">
        <scale value="0.5"/><rotate x="0.6" y="0.8" angle="40"/></transform></shape>"""
    wall = FLOOR.replace('<scale value="5"/>', '<scale value="5"/><translate z="-1.2"/>')
    scene = load(NEAR, cube, wall, light)
    rng = np.random.default_rng(2)
    weights = rng.random((SIZE, SIZE, 3))
    count = dr.width(rt.traverse(scene)["m.vertex_positions"])
    corners = np.array(rt.traverse(scene, "float64")["m.vertex_positions"].numpy()).reshape(-1, 3)
    # Vertices of one place go one way.
    turn = rng.normal(size=(3, 3)) * 0.02
    step = (corners @ turn.T + [0.01, 0.015, 0]).ravel()
    assert len(step) == count
    wanted = difference(scene, "m.vertex_positions", step, weights, 5)
    found = np.array([
        gradient(scene, "m.vertex_positions", weights=weights, seed_grad=s) @ step for s in range(5)
    ])  # fmt: skip
    spread = np.sqrt((wanted.var(ddof=1) + found.var(ddof=1)) / 5)
    assert abs(found.mean() - wanted.mean()) < 5 * spread
    assert spread < 0.2 * np.abs(wanted.mean())


def test_forward_and_reverse_agree() -> None:
    shape = f'<shape type="sphere" id="m"><float name="radius" value="0.5"/>{GLOW}</shape>'
    scene = load(NEAR.replace('"box"', '"gaussian"'), shape)
    weights = np.random.default_rng(1).random((SIZE, SIZE, 3))
    found = gradient(scene, "sensor.to_world" if "sensor.to_world" in rt.traverse(scene) else _camera(scene), spp=4,
                     weights=weights, seed_grad=9)  # fmt: skip
    params = rt.traverse(scene, "float64")
    key = _camera(scene)
    params[key] = dr.detach(params[key])
    dr.enable_grad(params[key])
    step = np.zeros((4, 4))
    step[:3] = np.random.default_rng(4).normal(size=(3, 4))
    dr.set_grad(params[key], params.types.Matrix4f(step))
    params.update()
    image = rt.render(scene, params, spp=4, seed_grad=9, visibility_gradients=True)
    dr.forward_to(image)
    forward = (np.array(dr.grad(image)) * weights).sum()
    assert forward == pytest.approx((found * step).sum(), rel=1e-10)
    assert abs(forward) > 1


def _camera(scene: rt.Scene) -> str:
    return next(k for k in rt.traverse(scene).keys() if k.endswith("to_world") and not k.startswith("m."))


def test_what_is_hidden_has_none() -> None:
    front = '<shape type="rectangle"><transform name="to_world"><translate z="1"/></transform></shape>'
    shape = f'<shape type="disk" id="m"><transform name="to_world"><scale value="0.5"/></transform>{GLOW}</shape>'
    assert np.abs(gradient(load(ABOVE, front, shape), "m.to_world", spp=16)).max() < 1e-9


def test_instances_are_refused() -> None:
    scene = load(ABOVE, """<shape type="shapegroup" id="g"><shape type="sphere"/></shape>
        <shape type="instance" id="m"><ref id="g"/></shape>""")  # fmt: skip
    with pytest.raises(rt.SettingError, match="instances"):
        gradient(scene, "m.to_world")


def test_samples_are_counted() -> None:
    scene = load(ABOVE, f'<shape type="disk" id="m">{GLOW}</shape>')
    assert np.isfinite(gradient(scene, "m.to_world", visibility_gradients=100)).all()
    with pytest.raises(rt.SettingError, match="visibility_gradients"):
        gradient(scene, "m.to_world", visibility_gradients=-1)


def test_edges_of_meshes() -> None:
    apart = np.arange(6, dtype=np.uint64)
    two, copies = mesh_edges(np.array([[0, 1, 2], [2, 1, 3]], np.uint32), apart)
    assert len(two) == 5 and (copies == 1).all()
    (shared,) = two[two[:, 3] != NO_VERTEX].tolist()
    assert shared[:2] == [1, 2] and sorted(shared[2:]) == [0, 3]
    fan, _ = mesh_edges(np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.uint32), apart)
    assert (fan[:, 3] == NO_VERTEX).all() and len(fan) == 7
    assert len(mesh_edges(np.array([[1, 1, 1]], np.uint32), apart)[0]) == 0


def test_seams_of_meshes_are_closed() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
    edges, copies = mesh_edges(np.array([[0, 1, 2], [4, 3, 5]], np.uint32), welded(corners))
    seam = edges[copies == 2]
    assert sorted(map(sorted, seam[:, :2].tolist())) == [[1, 2], [3, 4]]
    assert sorted(seam[:, 2:].tolist()) == [[0, 5], [5, 0]] and len(edges) == 6
