"""One light at a time, as a description and as Mitsuba's dict."""

from __future__ import annotations

from typing import Any

import numpy as np

from raytrace2.lights import LightTable
from raytrace2.scene import description as d
from raytrace2.textures.table import TextureTable
from raytrace2.types import types

BOUNDS = (np.array([-3.0, -2.0, -4.0]), np.array([3.0, 2.0, 4.0]))
CENTER, RADIUS = np.zeros(3), float(np.sqrt(29.0))


def build(lights: Any = (), area: Any = (), precision: str = "float32", bounds: Any = BOUNDS) -> LightTable:
    textures = TextureTable(types(precision))
    table = LightTable.build(lights, list(enumerate(area)), textures, bounds, types(precision))
    textures.finish()
    return table


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def transform(linear: Any = None, translate: Any = (0, 0, 0)) -> np.ndarray:
    matrix = np.eye(4)
    if linear is not None:
        matrix[:3, :3] = linear
    matrix[:3, 3] = translate
    return matrix


def grid_mesh(n: int = 4, smooth: bool = True) -> d.MeshShape:
    """A wavy sheet whose triangles differ in size, one of zero area among them."""
    x, y = np.meshgrid(np.linspace(0, 1, n) ** 2 * 2 - 1, np.linspace(-1, 1, n))
    z = 2 + 0.3 * np.sin(2 * x) * np.cos(y)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    # Wound so that the sheet faces down, towards the origin.
    faces = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1), [[0, 0, 1]]])
    uv = np.stack([x, y], axis=-1).reshape(-1, 2) * 0.5 + 0.5
    tilted = np.tile([0.1, 0.05, -1.0], (len(vertices), 1))
    normals = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return d.MeshShape(
        id="sheet",
        vertices=vertices,
        faces=faces.astype(np.uint32),
        uv=uv,
        normals=normals if smooth else None,
        emitter=d.AreaLight(d.ConstantTexture((1, 2, 3))),
    )


def emissive(kind: Any, to_world: np.ndarray, flip: bool = False, texture: Any = None) -> Any:
    return kind(
        id=kind.__name__,
        to_world=to_world,
        flip_normals=flip,
        emitter=d.AreaLight(texture or d.ConstantTexture((1.0, 2.0, 3.0))),
    )


PLUGINS = {d.SphereShape: "sphere", d.RectangleShape: "rectangle", d.DiskShape: "disk", d.CylinderShape: "cylinder"}


def mitsuba_shape(mi: Any, shape: Any) -> Any:
    radiance = {"type": "rgb", "value": list(shape.emitter.radiance.value)}
    emitter = {"type": "area", "radiance": radiance}
    if isinstance(shape, d.MeshShape):
        props = mi.Properties()
        props["emitter"] = mi.load_dict(emitter)
        mesh = mi.Mesh(
            "m",
            len(shape.vertices),
            len(shape.faces),
            props=props,
            has_vertex_normals=shape.normals is not None,
            has_vertex_texcoords=shape.uv is not None,
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = shape.vertices.astype(np.float32).ravel()
        parameters["faces"] = shape.faces.ravel()
        if shape.normals is not None:
            parameters["vertex_normals"] = shape.normals.astype(np.float32).ravel()
        if shape.uv is not None:
            parameters["vertex_texcoords"] = shape.uv.astype(np.float32).ravel()
        parameters.update()
        return mesh
    return {
        "type": PLUGINS[type(shape)],
        "to_world": mi.ScalarTransform4f(shape.to_world),
        # The description counts a mirror among a sphere's flips, Mitsuba's property does not.
        "flip_normals": shape.flip_normals != (isinstance(shape, d.SphereShape) and np.linalg.det(shape.to_world) < 0),
        "emitter": emitter,
    }


def shapes() -> dict[str, Any]:
    """Every kind of emissive shape, away from the origin, transformed, on its emitting side as seen from there."""
    turn = rotation(1)
    down = np.diag([1.0, -1.0, -1.0])
    return {
        "sphere": emissive(d.SphereShape, transform(0.7 * turn, (1, 0.5, 2))),
        "rectangle": emissive(d.RectangleShape, transform(down @ np.diag([0.8, 0.5, 1]), (0.3, -0.2, 2))),
        "disk": emissive(d.DiskShape, transform(down @ np.diag([0.8, 1.1, 1]), (0.2, 0.4, 1.5))),
        "cylinder": emissive(d.CylinderShape, transform(turn @ np.diag([0.4, 0.4, 1.5]), (1, 1, 1))),
        "mesh": grid_mesh(smooth=False),
    }


def samples(count: int, precision: str = "float32", seed: int = 0) -> Any:
    """``count`` Array2f samples."""
    u = np.random.default_rng(seed).random((2, count)).astype(types(precision).numpy)
    return types(precision).Array2f(np.minimum(u, 1 - 2 * types(precision).epsilon))


def interaction(si: Any, kind: Any) -> Any:
    """Mitsuba's surface interaction as ours."""
    from raytrace2.surfaces.frame import Frame
    from raytrace2.surfaces.interaction import SurfaceInteraction

    v, f = kind.Array3f, si.sh_frame
    return SurfaceInteraction(
        kind.Bool(si.is_valid()),
        kind.Float(si.t),
        v(si.p),
        v(si.n),
        Frame(v(f.s), v(f.t), v(f.n)),
        kind.Array2f(si.uv),
        v(si.dp_du),
        v(si.dp_dv),
        kind.Array2f(si.uv),
        v(si.wi),
        kind.UInt(si.prim_index),
        kind.UInt(0),
        kind.UInt(0xFFFFFFFF),
    )
