# ruff: noqa: E501 -- a scene a line
"""Scenes that must be refused: in one line each, with file and line, all at once, and without a crash."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.scene.mitsuba_messages import problem_from_message
from raytrace2.scene.reader import describe_dict, describe_file, describe_string


def scene(body: str) -> str:
    return f'<scene version="3.0.0">\n{body}\n</scene>'


def problems(body: str, whole: bool = False, **parameters) -> list[str]:
    with pytest.raises(SceneError) as caught:
        describe_string(body if whole else scene(body), **parameters)
    lines = str(caught.value).split("\n")
    assert len(lines) == len(caught.value.problems), "one line a problem"
    assert not any("parser.cpp" in line for line in lines)
    return lines


@pytest.mark.parametrize(
    ("body", "place", "words"),
    [
        ('<shape type="sphere"><bsdf type="roughplastic"/></shape>', ":2:", "'roughplastic' (bsdf) is not supported"),
        ('<shape type="shpere"/>', ":2:", "'shpere' (shape) is not supported"),
        ('<bsdf type="difuse" id="unused"/>', ":2:", "no such bsdf"),
        ('<shape type="obj"><string name="filename" value="no.obj"/></shape>', ":2:", "file 'no.obj' not found"),
        ('<shape type="sphere">\n</shap>', ":3:", "mismatch"),
        ('<shape type="sphere">\n<float name="radius" value="big"/></shape>', ":3:", "floating point value"),
        ('<shape type="sphere">\n<float name="radius" value="nan"/></shape>', ":2:", "'radius' must be a finite"),
        ('<shape type="sphere"><float name="radius" value="-1"/></shape>', ":2:", "'radius' must be greater than 0"),
        ('<shape type="sphere"><float name="radius" value="1e999"/></shape>', ":2:", "'radius' must be a finite"),
        ('<shape type="sphere"><integer name="sides" value="3"/></shape>', ":2:", "'sides' is not supported"),
        ('<shape type="sphere"><medium type="homogeneous" name="interior"/></shape>', ":2:", "a medium"),
        ('\n<shape type="sphere"><ref id="x"/></shape>', ":3:", 'refers to "x"'),
        ('<integrator type="$kind"/>', ":2:", "undefined parameter: $kind"),
        ('<include filename="absent.xml"/>', ":2:", "not found"),
        ('<path value="absent_folder"/>', ":2:", "not found"),
        ('<sensor type="perspective"><float name="fov" value="180"/></sensor>', ":2:", "'fov'"),
        ('<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="0"/></film></sensor>', ":2:", "'width'"),
        ('<sensor type="perspective"><film type="hdrfilm"><integer name="crop_offset_x" value="9999"/></film></sensor>',
         ":2:", "crop window"),
        ('<sensor type="perspective"><film type="hdrfilm"><string name="pixel_format" value="rgba"/></film></sensor>',
         ":2:", "'rgba' is not supported"),
        ('<sensor type="perspective"><transform name="to_world"><scale value="2"/></transform></sensor>', ":2:", "scale"),
        ('<sensor type="perspective"><transform name="to_world"><lookat origin="1,1,1" target="1,1,1" up="0,1,0"/>'
         "</transform></sensor>", ":2:", "lookat"),
        ('<shape type="sphere"><transform name="to_world"><scale x="0"/></transform></shape>', ":2:", "invertible"),
        ('<shape type="sphere"><transform name="to_world"><scale x="2"/></transform></shape>', ":2:", "along its axes"),
        ('<shape type="cylinder"><transform name="to_world"><scale x="2"/></transform></shape>', ":2:", "no circle"),
        ('<shape type="disk"><transform name="to_world"><rotate x="1" y="1" angle="30"/></transform></shape>', ":2:", "unit length"),
        ('<shape type="cylinder"><point name="p1" value="0 0 0"/></shape>', ":2:", "different points"),
        ('<shape type="disk"><bsdf type="diffuse"><rgb name="reflectance" value="-1 0 0"/></bsdf></shape>', ":2:", "between 0 and 1"),
        ('<shape type="disk"><bsdf type="diffuse"><rgb name="reflectance" value="2"/></bsdf></shape>', ":2:", "between 0 and 1"),
        ('<shape type="disk"><bsdf type="dielectric"><float name="int_ior" value="0"/></bsdf></shape>', ":2:", "'int_ior'"),
        ('<shape type="disk"><bsdf type="dielectric"><string name="int_ior" value="jelly"/></bsdf></shape>', ":2:", "'jelly'"),
        ('<shape type="disk"><bsdf type="conductor"><string name="material" value="Xx"/></bsdf></shape>', ":2:", "'Xx'"),
        ('<shape type="disk"><bsdf type="twosided"><bsdf type="dielectric"/></bsdf></shape>', ":2:", "transmits"),
        ('<shape type="disk"><bsdf type="twosided"/></shape>', ":2:", "one or two nested"),
        ('<shape type="disk"><bsdf type="mask"/></shape>', ":2:", "needs a child"),
        ('<shape type="disk"><emitter type="point"/></shape>', ":2:", "'point' (emitter) is not supported"),
        ('<shape type="instance"/>', ":2:", "needs a child"),
        ('<shape type="instance"><shape type="sphere"/></shape>', ":2:", "needs a shapegroup"),
        ('<shape type="instance"><shape type="shapegroup"><shape type="sphere"><emitter type="area"/></shape></shape></shape>',
         ":2:", "cannot emit"),
        ('<emitter type="constant"/>\n<emitter type="constant"/>', ":3:", "second environment"),
        ('<integrator type="path"/>\n<integrator type="path"/>', ":3:", "second integrator"),
        ('<integrator type="path"><integer name="max_depth" value="-2"/></integrator>', ":2:", "'max_depth'"),
        ('<integrator type="aov"><string name="aovs" value="a:nothing"/></integrator>', ":2:", "'a:nothing'"),
        ('<emitter type="spot"><float name="beam_width" value="30"/></emitter>', ":2:", "beam_width"),
        ('<emitter type="point"><spectrum type="blackbody" name="intensity"/></emitter>', ":2:", "'blackbody'"),
        ('<emitter type="point"><texture type="checkerboard" name="intensity"/></emitter>', ":2:", "must not vary"),
    ],
)  # fmt: skip
def test_one_problem_one_line(body, place, words):
    (line,) = problems(body)
    assert line.startswith(f"<string>{place}"), line
    assert words in line, line


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        ("", "No document element"),
        ("<scene><a/></scene>", "version"),
        ('<bsdf version="3.0.0" type="diffuse"/>', "the root is a bsdf"),
        ('<scene version="3.0.0"><vector name="a" value="1 2"/></scene>', "exactly 1 or 3"),
    ],
)
def test_a_text_that_is_no_scene(xml, words):
    (line,) = problems(xml, whole=True)
    assert words in line


def test_all_problems_at_once_in_the_order_of_the_file():
    lines = problems(
        '<bsdf type="roughplastic" id="p"/>\n<shape type="sphere"><ref id="p"/></shape>\n'
        '<shape type="hair"/>\n<shape type="sphere"><ref id="p"/><float name="radius" value="0"/></shape>\n'
        '<emitter type="sunsky"/>\n<integrator type="volpath"/>\n<sensor type="fisheye"/>'
    )
    assert [line.split(":")[1] for line in lines] == ["2", "4", "5", "6", "7", "8"]
    assert "roughplastic" in lines[0] and "supported are: bumpmap, conductor, dielectric" in lines[0]


def test_unresolved_references_are_all_named():
    assert len(problems('<shape type="sphere"><ref id="a"/></shape>\n<shape type="sphere"><ref id="b"/></shape>')) == 2


def test_circular_references_name_the_circle():
    body = '<bsdf type="twosided" id="a"><ref id="b"/></bsdf>\n<bsdf type="mask" id="b"><ref id="a"/></bsdf>'
    (line,) = problems(body)
    assert "circular reference: a -> b -> a" in line


def test_what_nothing_refers_to_is_not_refused():
    description = describe_string(
        scene('<bsdf type="plastic"/><texture type="volume"/><shape type="shapegroup"><shape type="hair"/></shape>')
    )
    assert description.shapes == ()


def test_unused_parameters_are_refused():
    (line,) = problems('<shape type="sphere"/>', samples=3)
    assert "samples=3" in line


def test_entities_do_not_expand():
    xml = (
        '<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>\n'
        '<scene version="3.0.0"><shape type="obj"><string name="filename" value="&b;"/></shape></scene>'
    )
    (line,) = problems(xml, whole=True)
    assert "'&b;' not found" in line


def test_include_cycles_end(tmp_path):
    (tmp_path / "a.xml").write_text('<scene version="3.0.0">\n<include filename="b.xml"/></scene>')
    (tmp_path / "b.xml").write_text('<scene version="3.0.0">\n<include filename="a.xml"/></scene>')
    with pytest.raises(SceneError, match="recursion") as caught:
        describe_file(tmp_path / "a.xml")
    assert "\n" not in str(caught.value) and ".xml:2:" in str(caught.value)


def test_errors_in_included_files_name_those(tmp_path):
    (tmp_path / "a.xml").write_text('<scene version="3.0.0">\n\n<include filename="sub/b.xml"/></scene>')
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "b.xml").write_text('<scene version="3.0.0">\n\n\n<shape type="hair"/></scene>')
    with pytest.raises(SceneError) as caught:
        describe_file(tmp_path / "a.xml")
    assert str(caught.value).startswith(f"{tmp_path}/sub/b.xml:4: plugin 'hair'")
    (tmp_path / "sub" / "b.xml").write_text('<scene version="3.0.0">\n<float name="a" value="x"/></scene>')
    with pytest.raises(SceneError) as caught:
        describe_file(tmp_path / "a.xml")
    assert str(caught.value).startswith(f"{tmp_path}/sub/b.xml:2:")


def test_missing_file():
    with pytest.raises(SceneError, match="nowhere.xml: scene file not found"):
        describe_file("nowhere.xml")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "m.obj:4"),
        ("m.obj", b"v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", "finite"),
        ("m.obj", b"", "empty"),
        ("m.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n", "m.ply"),
        ("m.serialized", b"\x1c\x04\x04\x00", "m.serialized"),
    ],
)
def test_broken_mesh_files(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    kind = name.split(".")[1]
    xml = scene(f'<shape type="{kind}"><string name="filename" value="{name}"/></shape>')
    (tmp_path / "s.xml").write_text(xml)
    with pytest.raises(SceneError) as caught:
        describe_file(tmp_path / "s.xml")
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{tmp_path}/s.xml:2: plugin '{kind}'") and words in str(problem)


def test_broken_images(tmp_path):
    (tmp_path / "t.png").write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00")
    (tmp_path / "s.xml").write_text(scene(
        '<shape type="disk"><bsdf type="diffuse"><texture name="reflectance" type="bitmap">'
        '<string name="filename" value="t.png"/></texture></bsdf></shape>\n'
        '<emitter type="envmap"><string name="filename" value="t.png"/></emitter>'
    ))  # fmt: skip
    with pytest.raises(SceneError) as caught:
        describe_file(tmp_path / "s.xml")
    assert [problem.location.line for problem in caught.value.problems] == [2, 3]


@pytest.mark.parametrize(("dtype", "value"), [(np.float32, np.nan), (np.float32, np.inf), (np.float16, -0.5)])
def test_images_with_values_that_no_albedo_has(dtype, value):
    import mitsuba as mi

    pixels = np.full((2, 2, 3), value, dtype)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels)}
    shape = {"type": "disk", "bsdf": {"type": "diffuse", "reflectance": texture}}
    with pytest.raises(SceneError, match=r"<dict>\[s.bsdf.reflectance\]: plugin 'bitmap'.*(finite|negative)"):
        describe_dict({"type": "scene", "s": shape})


def test_dicts_that_would_overflow_the_stack():
    nested: dict = {"type": "diffuse"}
    for _ in range(100_000):
        nested = {"type": "twosided", "inner": nested}
    with pytest.raises(SceneError, match="deep"):
        describe_dict({"type": "scene", "s": nested})
    own: dict = {"type": "scene"}
    own["self"] = own
    with pytest.raises(SceneError, match="deep"):
        describe_dict(own)
    while "inner" in nested:  # the interpreter's own destructor recurses
        nested = nested.pop("inner")


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"type": "nonsense"}, "nonsense"),
        ({"kind": "sphere"}, "type"),
        ({"type": "sphere", "radius": "x"}, "'radius' must be a number"),
        ({"type": "sphere", "radius": True}, "'radius' must be a number"),
        ({"type": 3}, "s"),
        ({"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": "red"}}}, "color"),
    ],
)
def test_dict_errors(entry, words):
    with pytest.raises(SceneError) as caught:
        describe_dict({"type": "scene", "s": entry})
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert str(caught.value).startswith("<dict>")


DEEP = """
import sys
from raytrace2.errors import SceneError
from raytrace2.scene.reader import describe_string
def attempt(xml):
    try:
        describe_string(xml)
    except SceneError as error:
        print(len(str(error).splitlines()))
attempt('<scene version="3.0.0">' + '<shape type="sphere">' * 200000 + '</shape>' * 200000 + '</scene>')
links = "".join(f'<bsdf type="twosided" id="b{i}"><ref id="b{i + 1}"/></bsdf>' for i in range(20000))
end = '<bsdf type="diffuse" id="b20000"/><shape type="disk"><ref id="b0"/></shape></scene>'
attempt('<scene version="3.0.0">' + links + end)
"""


def test_deep_nesting_and_long_chains_do_not_crash():
    done = subprocess.run([sys.executable, "-c", DEEP], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.split()) == (0, ["1", "1"]), done.stderr[-500:]


def test_messages_of_other_shapes():
    problem = problem_from_message("something else\nover lines", "s.xml")
    assert str(problem) == "s.xml: something else over lines"
