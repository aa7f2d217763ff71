"""How rays meet triangles, chosen in Python, in a scene and on the command line."""

from __future__ import annotations

import numpy as np
import pytest

import raytrace2 as rt
from raytrace2 import cli
from raytrace2.errors import SettingError

SCENE = """<scene version="3.0.0">
    {setting}
    <default name="spp" value="4"/>
    <integrator type="direct"/>
    <sensor type="perspective"><transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform><film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler></sensor>
    <shape type="obj"><string name="filename" value="{mesh}"/></shape>
    <emitter type="constant"/>
</scene>"""


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene with a mesh, and ``raytrace2.intersection`` set to a value or not at all."""
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-1, 1, (60, 3))
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(20)]
    (tmp_path / "m.obj").write_text("\n".join(lines) + "\n")

    def write(value: str | None = None) -> str:
        setting = "" if value is None else f'<default name="raytrace2.intersection" value="{value}"/>'
        path = tmp_path / f"{value}.xml"
        path.write_text(SCENE.format(setting=setting, mesh=tmp_path / "m.obj"))
        return str(path)

    return write


def way(scene: rt.Scene, **options) -> str:
    """How rays meet the triangles of ``scene``."""
    return scene.traced(**options).structure.geometry.intersection


def test_a_scene_has_its_own_setting(scene_file) -> None:
    assert way(rt.load_file(scene_file())) == "watertight"
    fast = rt.load_file(scene_file("fast"))
    assert way(fast) == "fast"
    assert way(fast, intersection="watertight") == "watertight"
    assert way(rt.load_file(scene_file(), **{"raytrace2.intersection": "fast"})) == "fast"
    assert way(rt.load_file(scene_file()), intersection="fast") == "fast"
    assert way(rt.load_file(scene_file()), accel="bvh:intersection=fast") == "fast"


def test_both_ways_of_one_scene_are_kept_apart(scene_file) -> None:
    scene = rt.load_file(scene_file())
    safe, fast = scene.traced(intersection="watertight"), scene.traced(intersection="fast")
    assert safe is scene.traced()
    assert fast is scene.traced(intersection="fast")
    assert safe.structure is not fast.structure


def test_groups_of_instances_follow() -> None:
    triangle = {"type": "rectangle"}
    scene = rt.load_dict(
        {
            "type": "scene",
            "group": {"type": "shapegroup", "part": triangle},
            "one": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        },
        settings={"intersection": "fast"},
    )
    structure = scene.traced().structure
    assert structure.geometry.intersection == "fast"
    assert [i.structure.geometry.intersection for i in structure.geometry.instances] == ["fast"]


def test_renders_take_it(scene_file) -> None:
    scene = rt.load_file(scene_file())
    safe, fast = (np.array(rt.render(scene, spp=4, intersection=how)) for how in (None, "fast"))
    assert safe.max() > 0
    # A sample at the edge of a triangle may fall either way.
    assert (abs(safe - fast) > 1e-3).mean() < 0.02
    with pytest.raises(SettingError, match="intersection must be one of watertight, fast, not 'loose'"):
        rt.render(scene, intersection="loose")
    with pytest.raises(SettingError, match="intersection must be one of watertight, fast, not 'no'"):
        rt.render(rt.load_file(scene_file("no")))


def test_the_command_line_takes_it(scene_file, tmp_path, capsys, monkeypatch) -> None:
    seen = []
    from raytrace2.scene import scene as scenes

    build = scenes.build

    def watched(*args, **options):
        seen.append(options["intersection"])
        return build(*args, **options)

    monkeypatch.setattr(scenes, "build", watched)
    for flags in ([], ["--intersection", "fast"]):
        assert cli.main(["render", scene_file(), "-o", str(tmp_path / "out.exr"), *flags]) == 0
    assert seen == ["watertight", "fast"]
    with pytest.raises(SystemExit) as end:
        cli.main(["render", scene_file(), "--intersection", "loose"])
    assert end.value.code == 2
    assert "invalid choice: 'loose'" in capsys.readouterr().err


def test_every_command_that_renders_has_the_flag(capsys) -> None:
    for command in ("render", "compare", "bench"):
        with pytest.raises(SystemExit):
            cli.main([command, "--help"])
        assert "--intersection {watertight,fast}" in capsys.readouterr().out
