"""References rendered by Mitsuba: what they hold, and the cache."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.reference.mitsuba_render import Reference, render_reference

mi = pytest.importorskip("mitsuba")

SCENE = """<scene version="3.0.0">
  <default name="spp" value="4"/>
  <integrator type="path"><integer name="max_depth" value="4"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="20"/></film>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
  </sensor>
  <emitter type="constant"/>
  <shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="$colour"/></bsdf></shape>
</scene>"""


def _render(tmp_path: Path, source: Any = SCENE, **settings: Any) -> Reference:
    settings = {"spp": 8, "batches": 4, "cache_dir": tmp_path / "cache", "parameters": {"colour": "0.5"}} | settings
    return render_reference(source, **settings)


def _dict() -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 16, "height": 8, "pixel_format": "luminance"}
    return {
        "type": "scene",
        "integrator": {"type": "direct"},
        "light": {"type": "constant"},
        "sensor": {"type": "perspective", "film": film},
        "ball": {"type": "sphere", "center": [0, 0, 4]},
    }


def test_batches_are_independent_and_average_to_the_image(tmp_path: Path) -> None:
    r = _render(tmp_path)
    assert r.batch_means.shape == (4, 20, 40, 3) and r.batch_means.dtype == np.float32
    assert r.spp == 8 and not r.from_cache
    assert len({batch.tobytes() for batch in r.batch_means}) == 4
    np.testing.assert_allclose(r.image, r.batch_means.mean(axis=0), rtol=1e-6)
    assert r.variance.shape == (20, 40, 3) and r.variance.max() > 0.0
    assert r.seconds_first >= r.seconds_best > 0.0 and r.seconds == pytest.approx(4 * r.seconds_best)


def test_the_second_time_comes_from_the_cache(tmp_path: Path) -> None:
    first, second = _render(tmp_path), _render(tmp_path)
    assert second.from_cache and second.seconds == first.seconds and second.settings == first.settings
    np.testing.assert_array_equal(second.batch_means, first.batch_means)
    for change in (
        {"seed": 1},
        {"spp": 16},
        {"batches": 2},
        {"size": (20, 10)},
        {"parameters": {"colour": "0.6"}},
        {"integrator": {"type": "path", "max_depth": 2}},
        {"sampler": "stratified"},
    ):
        assert not _render(tmp_path, **change).from_cache, change
    assert not [f for f in os.listdir(tmp_path / "cache") if not f.endswith(".npz")]


@pytest.mark.parametrize("damage", ["empty", "truncated", "flipped", "text", "other"])
def test_a_damaged_cache_file_is_rendered_anew(tmp_path: Path, damage: str) -> None:
    first = _render(tmp_path)
    (file,) = (tmp_path / "cache").iterdir()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 255
    if damage == "other":
        with file.open("wb") as stream:
            np.savez(stream, something=np.zeros(3))
    else:
        damaged = {"empty": b"", "truncated": whole[: len(whole) // 2], "flipped": bytes(flipped), "text": b"no"}
        file.write_bytes(damaged[damage])
    again = _render(tmp_path)
    assert not again.from_cache
    # Mitsuba's films add samples in an order that varies from run to run.
    np.testing.assert_allclose(again.batch_means, first.batch_means, rtol=1e-4)
    assert _render(tmp_path).from_cache


def test_the_users_variant_and_search_path_are_restored(tmp_path: Path) -> None:
    before = mi.variant()
    try:
        mi.set_variant("scalar_rgb")
        paths = str(mi.file_resolver())
        _render(tmp_path)
        with pytest.raises(SceneError):
            _render(tmp_path, "<scene version='3.0.0'><sensor type='nothing'/></scene>", parameters={})
        assert mi.variant() == "scalar_rgb" and str(mi.file_resolver()) == paths
    finally:
        mi.set_variant(before or "llvm_ad_rgb")


def test_film_size_and_crop_window(tmp_path: Path) -> None:
    assert _render(tmp_path, resolution_scale=0.25).image.shape == (5, 10, 3)
    assert _render(tmp_path, size=(7, 3)).image.shape == (3, 7, 3)
    crop = '<integer name="crop_offset_x" value="20"/><integer name="crop_width" value="12"/></film>'
    cropped = _render(tmp_path, SCENE.replace("</film>", crop), resolution_scale=0.5)
    assert cropped.image.shape == (10, 6, 3)
    assert cropped.settings["width"] == 6


def test_an_integrator_takes_the_place_of_the_scenes(tmp_path: Path) -> None:
    path = _render(tmp_path).image
    emitters_only = _render(tmp_path, integrator={"type": "path", "max_depth": 1}).image
    assert emitters_only[10, 20].max() == 0.0 < path[10, 20].min()


def test_dicts_files_and_luminance(tmp_path: Path) -> None:
    grey = _render(tmp_path, _dict(), parameters=None)
    assert grey.image.shape == (8, 16, 3) and (grey.image[..., 0] == grey.image[..., 2]).all()
    assert _render(tmp_path, _dict(), parameters=None).from_cache
    file = tmp_path / "scene.xml"
    file.write_text(SCENE)
    np.testing.assert_allclose(_render(tmp_path, file).batch_means, _render(tmp_path).batch_means, rtol=1e-4)


def test_content_of_files_and_bitmaps_decides(tmp_path: Path) -> None:
    def textured(value: float) -> dict[str, Any]:
        mi.set_variant("llvm_ad_rgb")
        bitmap = mi.Bitmap(np.full((2, 2, 3), value, dtype=np.float32))
        return _dict() | {
            "ball": {
                "type": "sphere",
                "center": [0, 0, 4],
                "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": bitmap, "raw": True}},
            }
        }

    keys = [_render(tmp_path, textured(v), parameters=None).key for v in (0.2, 0.4, 0.2)]
    assert keys[0] == keys[2] != keys[1] and all(keys)
    mesh = tmp_path / "mesh.obj"
    scene = _dict() | {"ball": {"type": "obj", "filename": str(mesh)}}
    mesh.write_text("v 0 0 4\nv 1 0 4\nv 0 1 4\nf 1 2 3\n")
    first = _render(tmp_path, scene, parameters=None)
    mesh.write_text("v 0 0 4\nv 2 0 4\nv 0 2 4\nf 1 2 3\n")
    assert not _render(tmp_path, scene, parameters=None).from_cache and first.key


def test_live_objects_are_rendered_every_time(tmp_path: Path) -> None:
    mi.set_variant("llvm_ad_rgb")
    scene = _dict() | {"ball": {"type": "sphere", "bsdf": mi.load_dict({"type": "diffuse"})}}
    assert _render(tmp_path, scene, parameters=None).key == ""
    assert not _render(tmp_path, scene, parameters=None).from_cache


def test_a_cache_that_cannot_be_written_costs_a_warning_only(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where the folder should be")
    with pytest.warns(UserWarning, match="could not be cached"):
        assert _render(tmp_path).image.shape == (20, 40, 3)


def test_errors_name_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(SCENE)
    with pytest.raises(SceneError, match=r"scene\.xml:11: .*colour") as caught:
        _render(tmp_path, file, parameters={})
    assert "\n" not in str(caught.value)
    with pytest.raises(SceneError, match="no such scene file"):
        _render(tmp_path, tmp_path / "absent.xml")
    for wrong in ({"spp": 9}, {"batches": 0}, {"sensor": 1}, {"size": (0, 4)}, {"resolution_scale": 0.0}):
        with pytest.raises(ValueError):
            _render(tmp_path, **wrong)


@pytest.mark.skipif("RAYTRACE2_MITSUBA_DATA" not in os.environ, reason="RAYTRACE2_MITSUBA_DATA is not set")
@pytest.mark.parametrize("name", ["sensor_thinlens", "integrator_aov", "variants_cbox_rgb"])
def test_mitsubas_own_scenes_at_a_quarter_of_the_resolution(tmp_path: Path, name: str) -> None:
    source = Path(os.environ["RAYTRACE2_MITSUBA_DATA"]) / "docs" / "scenes" / f"{name}.xml"
    r = _render(tmp_path, source, spp=2, batches=2, resolution_scale=0.25, parameters={"spp": 4})
    assert np.isfinite(r.image).all() and max(r.image.shape) <= 250
