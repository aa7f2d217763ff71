from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from raytrace2.scene.description import (
    BitmapTexture,
    CheckerboardTexture,
    ConstantTexture,
    MeshAttributeTexture,
    MeshShape,
    Texture,
)
from raytrace2.textures import TextureParameter, TextureTable
from raytrace2.types import Types, types

T32 = types("float32")
PIXELS = np.random.default_rng(0).random((6, 6, 3)).astype(np.float32)
A, B = ConstantTexture((0.1, 0.2, 0.6)), ConstantTexture((0.7, 0.8, 0.9))


@pytest.fixture(scope="module")
def mi() -> Any:
    module = pytest.importorskip("mitsuba")
    module.set_variant("llvm_ad_rgb")
    return module


def operations(value: Any) -> tuple[int, Any]:
    """Operations in the kernel that computes ``value``, and the kernel's hash."""
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.eval(value)
        (kernel,) = dr.kernel_history([dr.KernelType.JIT])
    return kernel["operation_count"], kernel["hash"]


def opaque_uv(t: Types = T32, n: int = 64) -> Any:
    return t.Array2f(np.random.default_rng(5).random((2, n)).astype(t.numpy))


def test_nested_checkerboards_agree_with_mitsuba(mi: Any, interaction: Any) -> None:
    uv = np.random.default_rng(1).uniform(-3, 3, (2, 5000)).astype(np.float32)
    scale = np.diag([3.0, 5.0, 1.0])
    inner = CheckerboardTexture(A, BitmapTexture(PIXELS), to_uv=scale)
    outer = CheckerboardTexture(inner, B)
    rgb = [{"type": "rgb", "value": list(c.value)} for c in (A, B)]
    reference = mi.load_dict(
        {
            "type": "checkerboard", "color1": rgb[1],
            "color0": {
                "type": "checkerboard", "color0": rgb[0], "color1": {"type": "bitmap", "bitmap": mi.Bitmap(PIXELS)},
                "to_uv": mi.ScalarTransform4f().scale([3, 5, 1]),
            },
        }
    )  # fmt: skip
    theirs = dr.zeros(mi.SurfaceInteraction3f, uv.shape[1])
    theirs.uv = mi.Point2f(uv)
    table = TextureTable.build([inner, outer], T32)
    si = interaction(T32, uv)
    for index in (table.add(outer), T32.UInt(table.add(outer))):
        assert np.allclose(table.eval(index, si), reference.eval(theirs), atol=1e-5)
        assert np.allclose(table.eval_1(index, si), reference.eval_1(theirs), atol=1e-5)


def mesh() -> MeshShape:
    rng = np.random.default_rng(2)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    return MeshShape(
        id="quad",
        vertices=vertices,
        faces=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
        attributes={
            "vertex_color": rng.random((4, 3)),
            "face_color": rng.random((2, 3)),
            "vertex_grey": rng.random((4, 1)),
        },
    )


def test_mesh_attributes_agree_with_mitsuba(mi: Any, interaction: Any) -> None:
    shape = mesh()
    theirs = mi.Mesh("quad", 4, 2)
    parameters = mi.traverse(theirs)
    parameters["vertex_positions"] = shape.vertices.astype(np.float32).ravel()
    parameters["faces"] = shape.faces.ravel()
    parameters.update()
    for name, values in shape.attributes.items():
        theirs.add_attribute(name, values.shape[1], values.astype(np.float32).ravel())
    scene = mi.load_dict({"type": "scene", "quad": theirs})
    x, y = np.random.default_rng(3).random((2, 1000)).astype(np.float32)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 1), mi.Vector3f(0, 0, -1)))
    assert dr.all(hit.is_valid())
    si = interaction(T32, np.array(hit.uv), prim=np.array(hit.prim_index), prim_uv=np.array(hit.uv), surface=3)
    for name in shape.attributes:
        scale = 2.0 if name == "vertex_color" else 1.0
        reference = mi.load_dict({"type": "mesh_attribute", "name": name, "scale": scale})
        texture = MeshAttributeTexture(name, scale)
        table = TextureTable.build([texture], T32, attributes={3: shape})
        assert np.allclose(table.eval(table.add(texture), si), reference.eval(hit), atol=1e-6)


def test_surfaces_without_the_attribute_are_black(interaction: Any) -> None:
    texture = MeshAttributeTexture("vertex_color")
    bare = MeshShape(id="bare", vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]))
    table = TextureTable.build([texture], T32, attributes={0: mesh(), 1: bare})
    si = interaction(T32, np.zeros((2, 4)), surface=np.array([0, 1, 2, 4000000000], dtype=np.uint32))
    value = np.array(table.eval(table.add(texture), si))
    assert value[:, 0].all() and not value[:, 1:].any()


def test_attributes_that_do_not_fit_are_refused() -> None:
    shape = MeshShape(
        id="m", vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]), attributes={"face_a": np.zeros(3)}
    )
    with pytest.raises(ValueError, match="'m'.*face_a"):
        TextureTable.build([MeshAttributeTexture("face_a")], T32, attributes={0: shape})
    with pytest.raises(ValueError, match="must begin with"):
        TextureTable.build([MeshAttributeTexture("colour")], T32)


def test_the_same_texture_is_held_once() -> None:
    bitmap = BitmapTexture(PIXELS)
    table = TextureTable.build([A, bitmap], T32)
    assert table.add(ConstantTexture(A.value)) == table.add(A)
    assert table.add(bitmap) == table.add(bitmap) != table.add(BitmapTexture(PIXELS))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_every_kind_in_one_table_within_a_symbolic_loop(interaction: Any, precision: str) -> None:
    t = types(precision)
    textures: list[Texture] = [
        A, B, BitmapTexture(PIXELS), BitmapTexture((PIXELS * 255).astype(np.uint8)), CheckerboardTexture(A, B),
        BitmapTexture(PIXELS.astype(np.float16), wrap_mode="clamp"), MeshAttributeTexture("face_color"),
        MeshAttributeTexture("vertex_color", 0.5), BitmapTexture(PIXELS[..., :1], filter_type="nearest"),
    ]  # fmt: skip
    table = TextureTable.build(textures, t, attributes={0: mesh()})
    indices = t.UInt(np.array([table.add(x) for x in textures], dtype=np.uint32))
    si = interaction(t, np.random.default_rng(4).random((2, 64)), prim_uv=np.full((2, 64), 0.25))

    def body(i: Any, total: Any) -> tuple[Any, Any]:
        return i + 1, total + table.eval(dr.gather(t.UInt, indices, i), si)

    start = (dr.zeros(t.UInt, 64), dr.zeros(t.Array3f, 64))
    _, total = dr.while_loop(start, lambda i, total: i < len(textures), body)
    expected = sum(np.array(table.eval(table.add(x), si)) for x in textures)
    assert np.allclose(np.array(total), expected, rtol=1e-5 if precision == "float32" else 1e-13)


def test_kernels_hold_only_the_kinds_that_occur() -> None:
    bitmap = BitmapTexture(PIXELS)
    alone = TextureTable.build([A, B], T32)
    both = TextureTable.build([A, B, bitmap], T32)
    uv, index = opaque_uv(), T32.UInt(np.zeros(64, dtype=np.uint32))
    few, many = operations(alone.eval_uv(index, uv))[0], operations(both.eval_uv(index, uv))[0]
    assert few < 20 < many
    assert operations(both.eval_uv(index, uv, reach=both.reach([both.add(A), both.add(B)])))[0] == few
    single = TextureTable.build([bitmap], T32)
    two = TextureTable.build([bitmap, BitmapTexture(PIXELS, wrap_mode="clamp")], T32)
    index = T32.UInt(np.full(64, single.add(bitmap), dtype=np.uint32))
    assert operations(single.eval_uv(index, uv))[0] < operations(two.eval_uv(index, uv))[0] < 300


def test_other_values_make_no_other_kernel() -> None:
    def kernel(color: tuple[float, float, float], texel: float, tile: float) -> Any:
        c = ConstantTexture(color)
        b = BitmapTexture(np.full((3, 4, 3), texel, np.float32), to_uv=np.diag([tile, 2.0, 1.0]))
        table = TextureTable.build([c, b], T32)
        uv = opaque_uv()
        return operations(table.eval_uv(table.add(c), uv) + table.eval_uv(table.add(b), uv))[1]

    assert kernel((0.1, 0.2, 0.3), 0.5, 3.0) == kernel((0.9, 0.8, 0.7), 0.25, 4.0)


def test_parameter_of_ones_is_no_look_up(interaction: Any) -> None:
    table = TextureTable(T32)
    white = TextureParameter([ConstantTexture((1, 1, 1)), None], table)
    assert white.always_one
    mixed = TextureParameter([None, A, BitmapTexture(PIXELS), B], table)
    si = interaction(T32, np.full((2, 4), 0.3))
    value = np.array(mixed.eval(T32.UInt([0, 1, 2, 3]), si)).T
    assert np.allclose(value[[0, 1, 3]], [(1, 1, 1), A.value, B.value])
    assert np.array(mixed.eval_1(T32.UInt([1]), interaction(T32, np.zeros((2, 1)))))[0] == pytest.approx(0.3)
