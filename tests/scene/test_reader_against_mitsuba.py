"""What is read, against the live objects that Mitsuba makes of the same scene."""

from __future__ import annotations

import importlib
import os
from pathlib import Path

import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.scene.description import BitmapTexture, CheckerboardTexture, MeshShape
from raytrace2.scene.reader import describe_dict, describe_file, describe_string

mi = importlib.import_module("mitsuba")  # after raytrace2, which chooses libLLVM
T = importlib.import_module("mitsuba.llvm_ad_rgb").ScalarTransform4f


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant("llvm_ad_rgb")


def live(scene: dict) -> dict:
    found = mi.traverse(mi.load_dict(scene, optimize=False))
    return {key: np.array(found[key]).ravel() for key, _ in found}


SPECTRA = [
    0.25,
    {"type": "rgb", "value": [0.1, 0.5, 0.9]},
    {"type": "spectrum", "value": 0.3},
    {"type": "spectrum", "value": [(400, 0.1), (500, 0.2), (650, 0.9), (700, 0.4)]},
    {"type": "spectrum", "value": [(360, 0.1), (600, 0.8), (830, 0.3)]},
    {"type": "spectrum", "value": [(400, 0.9), (410, 0.9), (420, 0.9)]},
    {"type": "uniform", "value": 0.7},
    {"type": "d65", "scale": 0.2},
    {"type": "rawconstant", "value": 0.6},
]


@pytest.mark.parametrize("value", SPECTRA)
@pytest.mark.parametrize(
    ("plugin", "name"),
    [("diffuse", "reflectance"), ("conductor", "eta"), ("conductor", "k"), ("point", "intensity"),
     ("constant", "radiance"), ("directional", "irradiance"), ("spot", "intensity")],
)  # fmt: skip
def test_spectra_become_the_same_rgb(plugin, name, value):
    entry = {"type": plugin, name: value}
    wrapped = {"type": "disk", "b": entry} if plugin in ("diffuse", "conductor") else entry
    description = describe_dict({"type": "scene", "s": wrapped})
    ours = description.shapes[0].bsdf if description.shapes else description.lights[0]
    ours = getattr(ours, name)
    ours = np.array(getattr(ours, "value", ours), np.float32)
    theirs = next(values for key, values in live(entry).items() if key.startswith(f"{name}.value"))
    np.testing.assert_array_equal(ours, np.broadcast_to(theirs.astype(np.float32), 3))


def test_area_light_radiance_and_more_than_one():
    radiance = {"type": "spectrum", "value": [(400, 0), (500, 8), (600, 15.6), (700, 18.4)]}
    entry = {"type": "disk", "e": {"type": "area", "radiance": radiance}}
    ours = describe_dict({"type": "scene", "s": entry}).shapes[0].emitter.radiance.value
    np.testing.assert_array_equal(np.float32(ours), live(entry)["emitter.radiance.value"].astype(np.float32))


@pytest.mark.parametrize("material", ["Al", "Au", "Cu", "Ag", "none"])
def test_materials_of_conductors(material):
    entry = {"type": "conductor", "material": material}
    bsdf = describe_dict({"type": "scene", "s": {"type": "disk", "b": entry}}).shapes[0].bsdf
    theirs = live(entry)
    for ours, name in ((bsdf.eta, "eta.value"), (bsdf.k, "k.value")):
        np.testing.assert_array_equal(np.float32(ours.value), np.broadcast_to(theirs[name].astype(np.float32), 3))


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize("size", [(640, 480), (300, 400), (100, 100)])
def test_fov_axis(axis, size):
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "crop_width": 50}
    entry = {"type": "perspective", "fov": 37.5, "fov_axis": axis, "film": film}
    ours = describe_dict({"type": "scene", "c": entry}).cameras[0]
    assert ours.x_fov == pytest.approx(float(live(entry)["x_fov"][0]), rel=1e-6)


@pytest.mark.parametrize("entry", [{}, {"focal_length": "35mm"}, {"focal_length": "85"}])
def test_focal_length(entry):
    entry = {"type": "thinlens", "aperture_radius": 0.1, **entry}
    ours = describe_dict({"type": "scene", "c": entry}).cameras[0]
    theirs = live(entry)
    assert ours.x_fov == pytest.approx(float(theirs["x_fov"][0]), rel=1e-6)
    assert ours.focus_distance == pytest.approx(float(theirs["focus_distance"][0]))


def test_transforms_multiply_in_written_order():
    xml = """<scene version="3.0.0"><shape type="rectangle"><transform name="to_world">
        <scale x="2" y="3"/><rotate y="1" angle="30"/><translate x="1" y="2" z="3"/></transform></shape>
        <sensor type="orthographic"><transform name="to_world"><lookat origin="1,2,3" target="0,0,0" up="0,1,0"/>
        </transform></sensor></scene>"""
    ours = describe_string(xml)
    theirs = mi.load_string(xml, optimize=False)
    expected = T().translate([1, 2, 3]).rotate([0, 1, 0], 30).scale([2, 3, 1]).matrix
    np.testing.assert_allclose(ours.shapes[0].to_world, np.array(expected), atol=1e-6)
    camera = np.array(theirs.sensors()[0].world_transform().matrix).reshape(4, 4)
    np.testing.assert_allclose(ours.cameras[0].to_world, camera, atol=1e-6)


TRANSFORMS = {
    "plain": T().rotate([2 / 3, 1 / 3, -2 / 3], 50).translate([1, 0, -2]),
    "scaled": T().rotate([2 / 3, 1 / 3, -2 / 3], 50).scale(2.5),
    "mirror": T().rotate([0.6, 0, 0.8], 20).scale([-1.5, 1.5, 1.5]),
    "point": T().scale(-2.0),
}


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_sphere_and_cylinder_fold_their_parameters(name, flip):
    common = {"to_world": TRANSFORMS[name], "flip_normals": flip}
    sphere = {"type": "sphere", "center": [1, 2, 3], "radius": 0.5, **common}
    cylinder = {"type": "cylinder", "p0": [1, 2, 3], "p1": [0, 1, 5], "radius": 0.5, **common}
    for entry in (sphere, cylinder):
        theirs = mi.load_dict({"type": "scene", "s": entry}, optimize=False)
        (ours,) = describe_dict({"type": "scene", "s": entry}).shapes
        to_world = np.array(mi.traverse(theirs)["s.to_world"].matrix).reshape(4, 4)
        np.testing.assert_allclose(ours.to_world, to_world, atol=2e-6)
        # The normal, by our description: away from the axis or centre unless flipped
        target = ours.to_world @ ([1, 0, 0, 1] if entry is sphere else [1, 0, 0.5, 1])
        middle = ours.to_world @ ([0, 0, 0, 1] if entry is sphere else [0, 0, 0.5, 1])
        outward = (target - middle)[:3] / np.linalg.norm((target - middle)[:3])
        ray = mi.Ray3f((target[:3] + outward).tolist(), (-outward).tolist())
        normal = np.array(theirs.ray_intersect(ray).n).ravel()
        np.testing.assert_allclose(normal, -outward if ours.flip_normals else outward, atol=1e-4)


def assert_same_mesh(ours: MeshShape, theirs, flipped: bool = False) -> None:
    np.testing.assert_allclose(ours.vertices.ravel(), np.array(theirs.vertex_positions_buffer()), rtol=1e-5, atol=1e-5)
    faces = np.array(theirs.faces_buffer()).reshape(-1, 3)
    np.testing.assert_array_equal(ours.faces, faces[:, [0, 2, 1]] if flipped else faces)
    assert theirs.has_flipped_normals() == flipped
    if ours.normals is None:
        assert not theirs.has_vertex_normals()
    else:
        sign = -1 if flipped else 1
        np.testing.assert_allclose(sign * ours.normals.ravel(), np.array(theirs.vertex_normals_buffer()), atol=2e-4)
    if ours.uv is None:
        assert not theirs.has_vertex_texcoords()
    else:
        np.testing.assert_allclose(ours.uv.ravel(), np.array(theirs.vertex_texcoords_buffer()), atol=1e-6)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_cube(name, flip):
    entry = {"type": "cube", "to_world": TRANSFORMS[name] @ T().scale([1, 2, 3]), "flip_normals": flip}
    (ours,) = describe_dict({"type": "scene", "s": entry}).shapes
    assert_same_mesh(ours, mi.load_dict(entry), flip)


@pytest.mark.parametrize("face_normals", [False, True])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_obj_under_transforms(name, face_normals, tmp_path):
    (tmp_path / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nv 0 0 2\nvt 0 0\nvt 1 0\nvt 1 1\n"
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/2\nf 1/1 2/2 5/3\n"
    )
    entry = {
        "type": "obj", "filename": str(tmp_path / "m.obj"), "face_normals": face_normals,
        "to_world": TRANSFORMS[name] @ T().scale([1, 2, 3]),
    }  # fmt: skip
    (ours,) = describe_dict({"type": "scene", "s": entry}).shapes
    assert_same_mesh(ours, mi.load_dict(entry))


def test_a_live_mesh():
    mesh = mi.load_dict({"type": "cube", "flip_normals": True, "to_world": TRANSFORMS["plain"]})
    (ours,) = describe_dict({"type": "scene", "s": mesh}).shapes
    assert_same_mesh(ours, mesh, True)
    assert ours.bsdf.reflectance.value == (0.5, 0.5, 0.5)
    coloured = mi.load_dict({"type": "cube", "b": {"type": "dielectric"}})
    with pytest.raises(SceneError, match="live mesh 's' has a BSDF"):
        describe_dict({"type": "scene", "s": coloured})


def test_textures_and_to_uv():
    uv = mi.ScalarTransform4f().translate([0.5, 0.25, 0]).scale([2, 3, 1])
    board = {"type": "checkerboard", "color0": 0.1, "to_uv": uv}
    pixels = np.linspace(0, 1, 12, dtype=np.float32).reshape(2, 2, 3)
    image = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "filter_type": "nearest", "wrap_mode": "mirror"}
    shapes = {
        "a": {"type": "disk", "b": {"type": "diffuse", "reflectance": board}},
        "c": {"type": "disk", "b": {"type": "diffuse", "reflectance": image}},
    }
    ours = [shape.bsdf.reflectance for shape in describe_dict({"type": "scene", **shapes}).shapes]
    assert isinstance(ours[0], CheckerboardTexture) and isinstance(ours[1], BitmapTexture)
    np.testing.assert_allclose(ours[0].to_uv, [[2, 0, 0.5], [0, 3, 0.25], [0, 0, 1]])
    assert ours[0].color1.value == pytest.approx((0.2, 0.2, 0.2))
    assert (ours[1].filter_type, ours[1].wrap_mode, ours[1].pixels.dtype) == ("nearest", "mirror", np.float32)
    np.testing.assert_array_equal(ours[1].pixels, pixels)
    assert not ours[1].pixels.flags.writeable


def test_eight_bit_images_keep_their_bytes():
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels)}
    for raw in (False, True):
        shape = {"type": "disk", "b": {"type": "diffuse", "reflectance": {**texture, "raw": raw}}}
        ours = describe_dict({"type": "scene", "s": shape}).shapes[0].bsdf.reflectance
        np.testing.assert_array_equal(ours.pixels, pixels[:, :, :3])
        assert ours.raw == raw


def test_parameters_includes_paths_references_and_settings(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "part.xml").write_text(
        '<scene version="3.0.0"><bsdf type="diffuse" id="b"><rgb name="reflectance" value="$shade"/></bsdf></scene>'
    )
    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><path value="meshes"/><default name="shade" value="0.5"/>'
        '<default name="raytrace2.accel" value="kdtree:leaf_size=8"/>'
        '<!-- <default name="raytrace2.filter" value="ewa"/> -->'
        '<include filename="part.xml"/><shape type="obj" id="one"><string name="filename" value="m.obj"/><ref id="b"/>'
        '</shape><shape type="disk"><ref id="b"/></shape></scene>'
    )
    mi.load_file(str(tmp_path / "s.xml"))
    before = mi.variant(), str(mi.file_resolver())
    plain = describe_file(tmp_path / "s.xml")
    given = describe_file(str(tmp_path / "s.xml"), shade=0.25)
    assert (mi.variant(), str(mi.file_resolver())) == before
    assert plain.settings == {"accel": "kdtree:leaf_size=8"}
    assert describe_file(tmp_path / "s.xml", **{"raytrace2.accel": "bvh"}).settings == {"accel": "bvh"}
    assert plain.shapes[0].bsdf is plain.shapes[1].bsdf
    assert plain.shapes[0].bsdf.reflectance.value == (0.5, 0.5, 0.5)
    assert given.shapes[0].bsdf.reflectance.value == (0.25, 0.25, 0.25)
    assert [shape.id for shape in plain.shapes] == ["one", "shape_0"]
    assert plain.hash != given.hash and plain.hash == describe_file(tmp_path / "s.xml").hash
    (tmp_path / "meshes" / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n")
    assert describe_file(tmp_path / "s.xml").hash != plain.hash


def test_instances_share_their_group():
    group = {"type": "shapegroup", "id": "g", "a": {"type": "sphere"}, "b": {"type": "cube"}}
    ref = {"type": "ref", "id": "g"}
    ours = describe_dict({
        "type": "scene", "g": group, "i": {"type": "instance", "r": ref},
        "j": {"type": "instance", "r": ref, "to_world": T().translate([1, 0, 0])},
    }).shapes  # fmt: skip
    assert len(ours) == 2 and ours[0].group is ours[1].group and len(ours[0].group.shapes) == 2
    assert ours[1].to_world[0, 3] == 1.0


def test_lights_and_integrators():
    ours = describe_dict({
        "type": "scene", "p": {"type": "point", "to_world": T().translate([1, 2, 3])},
        "d": {"type": "directional", "direction": [0, 0, -2]}, "s": {"type": "spot", "cutoff_angle": 40},
        "i": {"type": "aov", "aovs": "d:depth, n:sh_normal", "n": {"type": "direct", "shading_samples": 3}},
    })  # fmt: skip
    assert ours.lights[0].position == (1.0, 2.0, 3.0) and ours.lights[1].direction == (0.0, 0.0, -1.0)
    assert ours.lights[2].beam_width == pytest.approx(30.0)
    assert ours.integrator.aovs == (("d", "depth"), ("n", "sh_normal"))
    assert (ours.integrator.nested.emitter_samples, ours.integrator.nested.bsdf_samples) == (3, 3)


@pytest.mark.skipif("RAYTRACE2_MITSUBA_DATA" not in os.environ, reason="RAYTRACE2_MITSUBA_DATA is not set")
def test_scenes_of_mitsubas_documentation():
    files = sorted((Path(os.environ["RAYTRACE2_MITSUBA_DATA"]) / "docs" / "scenes").glob("*.xml"))
    refused = []
    for file in files:
        parameters = {"spp": 4} if file.name.startswith("sensor_") else {}
        try:
            describe_file(file, **parameters)
        except SceneError as error:
            assert all("is not supported" in str(problem) for problem in error.problems)
            refused.append(file.name)
    assert len(files) - len(refused) >= 29, refused
