from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.film import Film
from raytrace2.rays.wavefront import Wavefront, split_passes
from raytrace2.scene.description import Film as FilmDescription
from raytrace2.scene.description import ReconstructionFilter
from raytrace2.types import types

mi = pytest.importorskip("mitsuba")
if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")

FILTERS = {
    "box": ReconstructionFilter("box"),
    "tent": ReconstructionFilter("tent"),
    "gaussian": ReconstructionFilter("gaussian"),
    "wide": ReconstructionFilter("gaussian", stddev=0.9),
    "mitchell": ReconstructionFilter("mitchell"),
    "catmullrom": ReconstructionFilter("catmullrom"),
    "lanczos": ReconstructionFilter("lanczos"),
}
CROPS = [(9, 7, 0, 0, 9, 7), (9, 7, 3, 2, 5, 4), (1, 1, 0, 0, 1, 1), (3, 2, 2, 0, 1, 2)]


def describe(filter, crop=CROPS[0], border=False, pixel_format="rgb"):
    return FilmDescription(*crop, FILTERS[filter], pixel_format, border)


def random_samples(t, n, channels, seed=0):
    rng = np.random.default_rng(seed)
    offset = t.Array2f(rng.random((2, n)).astype("float32").clip(0, 1 - 2**-24).astype(t.numpy))
    return offset, [t.Float(rng.normal(size=n).astype(t.numpy)) for _ in range(channels)]


def fill(film, passes, offset, values, total):
    """Give the film, pass by pass, samples that are numbered as one wavefront of `total` samples a pixel."""
    for wavefront in passes:
        pixel, sample = wavefront.pixel_and_sample()
        lane = pixel * total + sample
        film.add(wavefront, dr.gather(type(offset), offset, lane), [dr.gather(type(v), v, lane) for v in values])


def put_in_mitsuba(desc, film, offset, values, spp):
    """Sums of the same samples, and of their weights, in Mitsuba's own image block."""
    settings = {"type": desc.rfilter.name}
    if desc.rfilter.name == "gaussian":
        settings["stddev"] = desc.rfilter.stddev
    filter = mi.load_dict(settings)
    size, corner = [desc.crop_width, desc.crop_height], [desc.crop_offset_x, desc.crop_offset_y]
    # Without coalescing, Mitsuba 3.9.1 writes out of bounds for samples left of or above the block.
    coalesce = spp >= 4 or film.border > 0
    block = mi.ImageBlock(size, corner, len(values) + 1, filter, border=False, coalesce=coalesce)
    pixel, _ = Wavefront(film.pixel_count, spp).pixel_and_sample()
    x = mi.Float(pixel % film.sampled_width) - film.border + desc.crop_offset_x
    y = mi.Float(pixel // film.sampled_width) - film.border + desc.crop_offset_y
    if not filter.is_box_filter():
        x, y = x + mi.Float(offset.x), y + mi.Float(offset.y)
    block.put(mi.Point2f(x, y), [mi.Float(v) for v in values] + [mi.Float(1)])
    raw = np.array(block.tensor(), dtype=float)
    return raw[..., :-1], raw[..., -1:]


def sums(film):
    weights = np.array(film.weights(), dtype=float)
    return np.array(film.develop(), dtype=float) * np.where(weights == 0, 1, weights), weights


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("crop", CROPS)
@pytest.mark.parametrize(("spp", "border"), [(1, False), (6, True)])
@pytest.mark.parametrize("ordered", [False, True])
def test_sums_are_those_of_mitsuba(filter, crop, spp, border, ordered):
    t = types("float32")
    desc = describe(filter, crop, border)
    film = Film(desc, t, 3)
    n = film.pixel_count * spp
    offset, values = random_samples(t, n, 3)
    wavefront = Wavefront(film.pixel_count, spp)
    if ordered:
        film.add(wavefront, offset, values)
    else:
        order = t.UInt(np.random.default_rng(1).permutation(n).astype(np.uint32))
        pixel, _ = wavefront.pixel_and_sample()
        film.add(
            dr.gather(t.UInt, pixel, order),
            dr.gather(t.Array2f, offset, order),
            [dr.gather(t.Float, value, order) for value in values],
        )
    for ours, theirs in zip(sums(film), put_in_mitsuba(desc, film, offset, values, spp), strict=True):
        scale = max(1.0, np.abs(theirs).max())
        assert np.abs(ours - theirs).max() < 4e-5 * scale


@pytest.mark.parametrize("filter", ["box", "tent", "gaussian"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_passes_add_up_to_the_whole(filter, precision):
    t = types(precision)
    spp = 6
    offset, values = random_samples(t, 9 * 7 * spp, 2)
    images = []
    for passes in (
        [Wavefront(63, spp)],
        split_passes(63, spp, 63 * 2),
        split_passes(63, spp, 10),
        split_passes(63, spp, 1),
    ):
        film = Film(describe(filter), t, 2)
        fill(film, passes[::-1], offset, values, spp)
        images.append(np.array(film.develop()))
    for image in images[1:]:
        assert np.abs(image - images[0]).max() < 8 * t.epsilon * np.abs(images[0]).max()


def test_the_same_pass_gives_the_same_bits():
    t = types("float32")
    images = []
    for _ in range(3):
        film = Film(describe("gaussian", (40, 30, 0, 0, 40, 30)), t, 3)
        wavefront = Wavefront(1200, 16)
        film.add(wavefront, *random_samples(t, wavefront.size, 3))
        images.append(np.array(film.develop()))
    assert (images[0] == images[1]).all() and (images[0] == images[2]).all()


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("ordered", [False, True])
def test_a_constant_stays_constant(filter, ordered):
    t = types("float64")
    film = Film(describe(filter, border=True), t, 1)
    wavefront = Wavefront(film.pixel_count, 4)
    offset, _ = random_samples(t, wavefront.size, 0)
    film.add(wavefront if ordered else wavefront.pixel_and_sample()[0], offset, [t.Float(2.5)])
    assert np.abs(np.array(film.develop()) - 2.5).max() < 1e-12


@pytest.mark.parametrize("filter", ["box", "gaussian"])
@pytest.mark.parametrize("ordered", [False, True])
def test_samples_that_are_not_finite_are_left_out_and_counted(filter, ordered):
    t = types("float32")
    film = Film(describe(filter), t, 2)
    wavefront = Wavefront(63, 4)
    offset, _ = random_samples(t, wavefront.size, 0)
    first, second = np.ones(wavefront.size, "float32"), np.ones(wavefront.size, "float32")
    first[3], first[50], second[50], second[70] = np.nan, np.inf, -np.inf, np.nan
    where = wavefront if ordered else wavefront.pixel_and_sample()[0]
    film.add(where, offset, [t.Float(first), t.Float(second)])
    assert film.non_finite_samples() == 3
    assert np.abs(np.array(film.develop()) - 1).max() < 1e-6
    film.add(where, offset, [t.Float(first), t.Float(second)])
    assert film.non_finite_samples() == 6
    film.clear()
    assert film.non_finite_samples() == 0 and np.array(film.weights()).max() == 0


@pytest.mark.parametrize("ordered", [False, True])
def test_inactive_samples_count_for_nothing(ordered):
    t = types("float32")
    film = Film(describe("gaussian"), t, 1)
    wavefront = Wavefront(63, 4)
    offset, values = random_samples(t, wavefront.size, 1)
    active = np.arange(wavefront.size) % 3 == 0
    where = wavefront if ordered else wavefront.pixel_and_sample()[0]
    film.add(where, offset, [dr.select(t.Bool(active), 7, values[0])], t.Bool(active))
    assert np.abs(np.array(film.develop()) - 7).max() < 1e-5


@pytest.mark.parametrize("filter", ["box", "gaussian"])
def test_the_image_is_differentiable_in_the_values(filter):
    t = types("float64")
    wavefront = Wavefront(63, 2)
    offset, values = random_samples(t, wavefront.size, 1)
    weights = t.Float(np.random.default_rng(5).normal(size=63))
    plain = Film(describe(filter), t, 1)
    plain.add(wavefront, offset, [values[0]])
    reference = np.array(plain.develop())
    dr.enable_grad(values[0])
    film = Film(describe(filter), t, 1)
    film.add(wavefront, offset, values)
    image = film.develop()
    assert np.abs(np.array(image) - reference).max() < 1e-12
    dr.backward(dr.sum(image.array * weights))
    gradient = np.array(dr.grad(values[0]))
    # The image is linear in the values.
    assert np.dot(gradient, np.array(dr.detach(values[0]))) == pytest.approx(
        np.dot(reference.ravel(), np.array(weights))
    )
    shifted = Film(describe(filter), t, 1)
    bump = np.zeros(wavefront.size)
    bump[37] = 1
    shifted.add(wavefront, offset, [dr.detach(values[0]) + t.Float(bump)])
    change = (np.array(shifted.develop()) - reference).ravel() @ np.array(weights)
    assert gradient[37] == pytest.approx(change, rel=1e-9, abs=1e-12)


def test_positions_are_relative_to_the_crop_window():
    t = types("float64")
    film = Film(describe("gaussian", CROPS[1], border=True), t, 1)
    assert (film.border, film.sampled_width, film.sampled_height) == (2, 9, 8)
    pixel = t.UInt([0, 2 * 9 + 2, 71])
    position = np.array(film.position(pixel, t.Array2f([0.0, 0.5, 0.25], [0.0, 0.5, 0.75])))
    assert np.allclose(position, [[-2 / 5, 0.5 / 5, 6.25 / 5], [-2 / 4, 0.5 / 4, 5.75 / 4]], rtol=1e-15)


@pytest.mark.parametrize("pixel_format", ["luminance", "xyz", "luminance_alpha", "rgba"])
def test_pixel_formats_are_those_of_mitsuba(pixel_format):
    t = types("float32")
    channels = 4 if "a" in pixel_format[-1:] else 3
    film = Film(describe("box", (1, 1, 0, 0, 1, 1), pixel_format=pixel_format), t, channels)
    film.add(Wavefront(1, 1), t.Array2f(0.5), [t.Float(v) for v in (0.2, 0.5, 0.9, 1.0)[:channels]])
    colour = mi.Color3f(0.2, 0.5, 0.9)
    expected = {"l": [mi.luminance(colour)], "x": list(mi.srgb_to_xyz(colour)), "r": list(colour)}[pixel_format[0]]
    result = np.array(film.develop()).ravel()
    assert np.allclose(result, [v[0] for v in expected] + [1.0] * (channels - 3), atol=2e-6)


def test_an_empty_film_is_black():
    image = np.array(Film(describe("gaussian"), types("float32"), 3).develop())
    assert image.shape == (7, 9, 3) and (image == 0).all()


@pytest.mark.parametrize("crop", [(0, 5, 0, 0, 1, 1), (5, 5, 0, 0, 0, 1), (5, 5, 3, 0, 3, 1), (5, 5, -1, 0, 3, 1)])
def test_films_that_cannot_be_are_refused(crop):
    with pytest.raises(SceneError, match="film"):
        Film(describe("box", crop), types("float32"), 3)


def test_pixels_beyond_the_film_do_no_harm():
    t = types("float32")
    film = Film(describe("gaussian"), t, 1)
    film.add(t.UInt([0, 63, 2**32 - 1]), t.Array2f(0.5), [t.Float([1.0, np.nan, 5.0])])
    assert film.non_finite_samples() == 0 and np.array(film.develop()).max() == pytest.approx(1)
    with pytest.raises(ValueError, match="63 pixels"):
        film.add(Wavefront(64, 1), t.Array2f(0.5), [t.Float(1)])
