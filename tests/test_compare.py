"""Comparisons: what they say of scenes that are right, of one that is not, and what they take."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from render_cases import ball, camera, cornell_box, corner, diffuse, lamp, scene

import raytrace2 as rt
from raytrace2.scene.reader import describe_dict


def compare(source: dict[str, Any], tmp_path: Path, **settings: Any) -> rt.Comparison:
    return rt.compare(rt.load_dict(source), cache_dir=tmp_path, progress=False, **settings)


def test_a_cornell_box_is_consistent_and_reports_itself(tmp_path: Path) -> None:
    box = cornell_box(32)
    found = compare(box, tmp_path, spp=64)
    assert found.consistent, found.noise.reasons
    assert found.ours.shape == found.reference.shape == (32, 32, 3)
    assert found.rmse > 0 and found.seconds > 0 and found.reference_seconds > 0
    page = found.report(tmp_path / "page.html")
    assert "raytrace2" in Path(page).read_text()
    assert "noise" in found._repr_html_()
    # The reference is cached, ours is rendered anew with the same numbers.
    again = compare(box, tmp_path, spp=64)
    np.testing.assert_array_equal(again.reference, found.reference)
    np.testing.assert_array_equal(again.ours, found.ours)


def test_the_two_sides_draw_different_numbers(tmp_path: Path) -> None:
    """With the same numbers they would look alike to the bit, and the noise test would not test anything."""
    box = cornell_box(16, max_depth=2)
    found = compare(box, tmp_path, spp=16)
    assert np.abs(found.ours - found.reference).mean() > 0.01 * found.reference.mean()


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("accel", ["bvh", "brute_force"])
def test_every_precision_and_structure_is_consistent(precision: str, accel: str, tmp_path: Path) -> None:
    glass = {"type": "dielectric"}
    sky = {"type": "constant", "radiance": 0.2}
    source = scene(sensor=camera((24, 18)), **corner(lamp=lamp(), ball=ball(glass), sky=sky))
    found = compare(source, tmp_path, spp=32, precision=precision, accel=accel)
    assert found.consistent, found.noise.reasons


def test_a_wrong_albedo_is_found(tmp_path: Path) -> None:
    def room(albedo: float) -> dict[str, Any]:
        return scene(sky={"type": "constant"}, ball=ball(diffuse(albedo)))

    loaded = rt.load_dict(room(0.5))
    wrong = rt.Scene(describe_dict(room(0.52)), loaded.origin)
    found = rt.compare(wrong, spp=64, cache_dir=tmp_path, progress=False)
    assert found.consistent is False and found.noise.reasons


def test_crop_windows_sizes_and_more_reference_samples(tmp_path: Path) -> None:
    film = {"crop_offset_x": 10, "crop_offset_y": 4, "crop_width": 24, "crop_height": 20}
    source = scene(sensor=camera((48, 32), film=film), **corner(lamp=lamp(), ball=ball()))
    found = compare(source, tmp_path, spp=16, reference_spp=64)
    assert found.ours.shape == (20, 24, 3) and found.consistent, found.noise.reasons
    half = compare(source, tmp_path, spp=16, size=(24, 16))
    assert half.ours.shape == (10, 12, 3) and half.consistent, half.noise.reasons


def test_another_size_keeps_the_field_of_view_of_its_axis(tmp_path: Path) -> None:
    for axis in ("x", "y", "smaller", "larger", "diagonal"):
        source = scene(
            integrator={"type": "direct"}, sensor=camera((40, 20), fov_axis=axis),
            **corner(light={"type": "directional", "direction": [-1, -1, -1]}, ball=ball()),
        )  # fmt: skip
        found = compare(source, tmp_path, spp=16, size=(18, 27))
        assert found.consistent, (axis, found.noise.reasons)


def test_luminance_and_aovs_are_compared_by_their_image(tmp_path: Path) -> None:
    source = cornell_box(16, max_depth=3)
    source["integrator"] = {"type": "aov", "aovs": "d:depth", "image": source["integrator"]}
    source["sensor"]["film"]["pixel_format"] = "luminance"
    found = compare(source, tmp_path, spp=16)
    assert found.ours.shape == (16, 16, 3) and found.consistent, found.noise.reasons


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    source = cornell_box(16)
    with pytest.raises(rt.RayTraceError, match="nested"):
        compare({**source, "integrator": {"type": "aov", "aovs": "d:depth"}}, tmp_path)
    with pytest.raises(rt.RayTraceError, match="not loaded"):
        rt.compare(rt.Scene(describe_dict(source)), cache_dir=tmp_path)
