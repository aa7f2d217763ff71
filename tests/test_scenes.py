"""The scenes that travel with the program: both renderers read them, and show the same."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raytrace2 as rt
from raytrace2.scene.description import BitmapTexture, ConductorBsdf, DielectricBsdf, DiffuseBsdf

SCENES = Path(__file__).parent.parent / "scenes"
NAMES = sorted(path.stem for path in SCENES.glob("*.xml"))


@pytest.mark.parametrize("name", NAMES)
def test_renders_at_the_size_asked_for(name):
    scene = rt.load_file(SCENES / f"{name}.xml", width=32, height=24, spp=4)
    image = np.array(rt.render(scene, spp=0))
    assert image.shape == (24, 32, 3)
    assert np.isfinite(image).all() and image.min() >= 0.0 and image.mean() > 0.05


@pytest.mark.parametrize("name", NAMES)
def test_defaults(name):
    camera = rt.load_file(SCENES / f"{name}.xml").description.cameras[0]
    assert (camera.film.width, camera.film.height, camera.sampler.sample_count) == (256, 256, 64)
    assert camera.film.rfilter.name == "box"


@pytest.mark.parametrize("name", NAMES)
def test_mitsuba_renders_the_same(name, tmp_path):
    scene = rt.load_file(SCENES / f"{name}.xml")
    result = rt.compare(scene, spp=64, size=(32, 32), cache_dir=tmp_path, progress=False)
    assert result.consistent, result.noise.reasons


def test_the_room_has_what_ray_differentials_are_for():
    shapes = {shape.id: shape for shape in rt.load_file(SCENES / "igehy_room.xml").description.shapes}
    assert isinstance(shapes["mirror_ball"].bsdf, ConductorBsdf)
    assert isinstance(shapes["glass_ball"].bsdf, DielectricBsdf)
    for name in ("floor", "globe", "left_wall", "right_wall"):
        bsdf = shapes[name].bsdf
        assert isinstance(bsdf, DiffuseBsdf) and isinstance(bsdf.reflectance, BitmapTexture)


def test_the_room_aliases_more_than_it_is_noisy():
    """Far floor at one sample a pixel: the scatter of pixels that see checks against that of plain sky."""
    scene = rt.load_file(SCENES / "igehy_room.xml", width=128, height=128)
    image = np.array(rt.render(scene, spp=1))[..., 1]
    floor, sky = image[76:84, 50:54], image[4:24, 48:80]
    assert floor.std() / floor.mean() > 3.0 * sky.std() / sky.mean()


def test_the_grazing_floor_is_the_mean_of_its_checks_at_the_horizon():
    scene = rt.load_file(SCENES / "grazing_floor.xml", width=64, height=64)
    image = np.array(rt.render(scene, spp=256))
    assert image[:24].max() == 0.0
    assert image[28:30].mean() == pytest.approx(0.5, abs=0.02)
    assert image[-12:].min() < 0.05 and image[-12:].max() > 0.95


def test_textures_are_those_that_the_script_draws():
    spec = importlib.util.spec_from_file_location("make_textures", SCENES / "make_textures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kept = {path.name for path in (SCENES / "textures").iterdir()}
    assert kept == set(module.TEXTURES)
    for name, draw in module.TEXTURES.items():
        with Image.open(SCENES / "textures" / name) as file:
            pixels = np.asarray(file)
        drawn = draw()
        assert pixels.shape == drawn.shape
        # Another mathematics library may round a sine at the edge of a shape the other way.
        assert np.mean(pixels != drawn) < 1e-4, name


def test_textures_are_small():
    assert sum(path.stat().st_size for path in (SCENES / "textures").iterdir()) < 100_000
