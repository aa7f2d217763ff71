from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.rays.low_discrepancy import _pascal
from raytrace2.rays.random import fraction
from raytrace2.rays.sampler import make_sampler
from raytrace2.rays.wavefront import Wavefront, split_passes
from raytrace2.scene.description import Sampler
from raytrace2.types import types

mi = pytest.importorskip("mitsuba")
if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")

KINDS = ["independent", "stratified", "multijitter", "ldsampler"]


def draw(sampler):
    """A 1D, a 2D and another 1D draw, as one (4, n) array."""
    first, second, third = sampler.next_1d(), sampler.next_2d(), sampler.next_1d()
    return np.stack([np.array(first), *np.array(second), np.array(third)])


@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("sample_count", [1, 6, 9, 16, 100])
@pytest.mark.parametrize("jitter", [False, True])
def test_numbers_are_those_of_mitsuba(kind, sample_count, jitter):
    settings = {"type": kind, "sample_count": sample_count, "seed": 3}
    if kind != "independent":
        settings["jitter"] = jitter
    theirs = mi.load_dict(settings)
    ours = make_sampler(Sampler(kind, sample_count, 3, jitter), types("float32"))
    assert ours.sample_count == theirs.sample_count()
    pixels = 37
    theirs.set_samples_per_wavefront(ours.sample_count)
    for seed in (0, 5):
        theirs.seed(seed, pixels * ours.sample_count)
        ours.seed(seed, Wavefront(pixels, ours.sample_count))
        for _ in range(2):
            assert (draw(ours) == draw(theirs)).all()


def test_lanes_are_in_the_order_of_mitsuba():
    pixel, sample = Wavefront(5, 3).pixel_and_sample()
    assert list(pixel) == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]
    assert list(sample) == [0, 1, 2] * 5
    pixel, sample = Wavefront(2, 4, 7, 8).pixel_and_sample()
    assert list(pixel) == [7] * 4 + [8] * 4 and list(sample) == [8, 9, 10, 11] * 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("max_lanes", [13 * 4, 7, 1000])
def test_passes_take_the_samples_of_one_pass(kind, precision, max_lanes):
    sampler = make_sampler(Sampler(kind), types(precision), 16)
    sampler.seed(9, Wavefront(13, 16))
    whole = draw(sampler).reshape(4, 13, 16)
    seen = np.full((4, 13, 16), np.nan)
    for wavefront in split_passes(13, 16, max_lanes):
        assert wavefront.size <= max_lanes
        sampler.seed(9, wavefront)
        pixel, sample = wavefront.pixel_and_sample()
        assert np.isnan(seen[:, np.array(pixel), np.array(sample)]).all()
        seen[:, np.array(pixel), np.array(sample)] = draw(sampler)
    assert (seen == whole).all()


@pytest.mark.parametrize("kind", KINDS)
def test_seeds_reproduce_and_differ(kind):
    sampler = make_sampler(Sampler(kind), types("float32"), 16)
    draws = []
    for seed in (1, 1, 2, -1, 2**40 + 1):
        sampler.seed(seed, Wavefront(5, 16))
        draws.append(draw(sampler))
    assert (draws[0] == draws[1]).all() and (draws[0] != draws[2]).mean() > 0.9 and (draws[0] != draws[3]).mean() > 0.9
    base = make_sampler(Sampler(kind, seed=7), types("float32"), 16)
    base.seed(1, Wavefront(5, 16))
    assert (draw(base) != draws[0]).mean() > 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_both_precisions_take_the_same_samples(kind):
    draws = []
    for precision in ("float32", "float64"):
        sampler = make_sampler(Sampler(kind), types(precision), 36)
        sampler.seed(4, Wavefront(50, sampler.sample_count))
        draws.append(draw(sampler).astype(float))
    assert np.abs(draws[0] - draws[1]).max() < 3e-7
    # More bits than single precision holds.
    assert (draws[1] != draws[1].astype("float32")).mean() > 0.9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_numbers_are_uniform_below_one(kind, precision):
    sampler = make_sampler(Sampler(kind), types(precision), 64)
    sampler.seed(0, Wavefront(1024, 64))
    numbers = draw(sampler)
    assert numbers.min() >= 0 and numbers.max() < 1
    for row in numbers:
        counts = np.histogram(row, 64, (0, 1))[0]
        assert ((counts - 1024) ** 2 / 1024).sum() < 140  # chi-square, 63 degrees of freedom: beyond 1e-7
    correlation = np.corrcoef(numbers)
    # The permutations of Mitsuba's stratified sampler have neighbouring seeds, and correlate a little from one
    # dimension to the next.
    assert np.abs(correlation - np.eye(4)).max() < (0.04 if kind == "stratified" else 0.02)


def test_no_rounding_reaches_one():
    # (2^22 - 1 + 0.9999999) / 2^22 rounds to 1 in single precision.
    for kind in ("stratified", "multijitter"):
        sampler = make_sampler(Sampler(kind), types("float32"), 2**22)
        sampler.seed(0, Wavefront(1, 2**22))
        assert np.array(sampler.next_1d()).max() < 1 and np.array(sampler.next_2d()).max() < 1
    full = types("float32").UInt([0xFFFFFFFF])
    assert fraction(full, "float32")[0] < 1 and fraction(full, "float64")[0] < 1


@pytest.mark.parametrize("kind", ["stratified", "multijitter", "ldsampler"])
def test_each_pixel_is_stratified(kind):
    pixels, samples = 40, 64
    sampler = make_sampler(Sampler(kind), types("float32"), samples)
    sampler.seed(2, Wavefront(pixels, samples))
    for _ in range(3):
        line = np.array(sampler.next_1d()).reshape(pixels, samples)
        assert (np.sort((line * samples).astype(int), axis=1) == np.arange(samples)).all()
        x, y = np.array(sampler.next_2d()).reshape(2, pixels, samples)
        cells = (x * 8).astype(int) + 8 * (y * 8).astype(int)
        assert (np.sort(cells, axis=1) == np.arange(samples)).all()
        if kind != "stratified":
            for axis in (x, y):
                assert (np.sort((axis * samples).astype(int), axis=1) == np.arange(samples)).all()


def test_low_discrepancy_prefixes_are_nets_in_every_shape():
    pixels, samples = 20, 64
    sampler = make_sampler(Sampler("ldsampler"), types("float32"), samples)
    sampler.seed(2, Wavefront(pixels, samples))
    x, y = np.array(sampler.next_2d()).reshape(2, pixels, samples)
    for m in range(7):
        for start in range(0, samples, 2**m):
            part = slice(start, start + 2**m)
            for k in range(m + 1):
                cells = (x[:, part] * 2**k).astype(int) * 2 ** (m - k) + (y[:, part] * 2 ** (m - k)).astype(int)
                assert (np.sort(cells, axis=1) == np.arange(2**m)).all()


def test_the_second_dimension_is_that_of_sobol():
    from scipy.stats import qmc

    UInt = types("float32").UInt
    index = dr.arange(UInt, 256)
    ours = np.stack([np.array(dr.brev(index)), np.array(dr.brev(_pascal(index)))]) / 2.0**32
    theirs = qmc.Sobol(2, scramble=False).random(256).T
    # Sobol's sequence in Gray-code order: the same points within every aligned block of 2^m.
    for m in range(9):
        assert {tuple(p) for p in ours[:, : 2**m].T} == {tuple(p) for p in theirs[:, : 2**m].T}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sample_count", [16, 9])
def test_samplers_are_loop_state(kind, sample_count):
    t = types("float32")
    sampler = make_sampler(Sampler(kind), t, sample_count)
    wavefront = Wavefront(11, sampler.sample_count)
    n = wavefront.size

    sampler.seed(6, wavefront)
    expected = sum(np.array(sampler.next_1d()) + np.array(sampler.next_2d().y) for _ in range(4))

    def body(sampler, i, total):
        def inner(sampler, total):
            total = total + sampler.next_1d(i < 4)
            return sampler, total + sampler.next_2d(i < 4).y

        sampler, total = dr.if_stmt((sampler, total), i < 4, inner, lambda sampler, total: (sampler, total))
        return sampler, i + 1, total

    sampler.seed(6, wavefront)
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, True):
        state = (sampler, dr.zeros(t.UInt, n), dr.zeros(t.Float, n))
        after, _, total = dr.while_loop(state, lambda sampler, i, total: i < 6, body)
    assert np.abs(np.array(total) - expected).max() < 1e-5
    assert after.sample_count == sampler.sample_count
    follow = np.array(after.next_1d())
    assert follow.shape == (n,) and follow.min() >= 0 and follow.max() < 1


def test_lanes_that_are_not_active_keep_their_place():
    t = types("float32")
    sampler = make_sampler(Sampler("independent"), t, 4)
    sampler.seed(0, Wavefront(16, 4))
    first = np.array(sampler.next_1d())
    sampler.seed(0, Wavefront(16, 4))
    odd = np.arange(64) % 2 == 1
    sampler.next_1d(t.Bool(odd))
    again = np.array(sampler.next_1d())
    assert (again[~odd] == first[~odd]).all() and (again[odd] != first[odd]).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_sequences_past_two_to_the_32_stay_distinct(kind, precision):
    count = 2**26
    sampler = make_sampler(Sampler(kind), types(precision), count)
    draws = []
    # Pixel 64 begins where 32-bit numbering comes round to 0.
    for pixel in (0, 1, 64, 65):
        sampler.seed(0, Wavefront(1, 512, pixel, 1000))
        draws.append(draw(sampler))
    for i in range(4):
        for j in range(i):
            assert (draws[i] != draws[j]).mean() > 0.99
            assert np.abs(np.corrcoef(draws[i].ravel(), draws[j].ravel())[0, 1]) < 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_kernels_do_not_depend_on_seed_or_sample_count(kind):
    hashes = []
    for seed, samples, pixels in ((1, 16, 40), (2, 64, 50)):
        sampler = make_sampler(Sampler(kind), types("float32"), samples)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            sampler.seed(seed, Wavefront(pixels, samples, seed, 0))
            dr.eval(sampler.next_2d(), sampler.next_1d())
            hashes.append({k["hash"] for k in dr.kernel_history([dr.KernelType.JIT])})
    assert hashes[0] and hashes[0] == hashes[1]


@pytest.mark.parametrize(
    ("desc", "count"), [(Sampler("sobol"), 4), (Sampler(), 0), (Sampler(), -3), (Sampler(sample_count=0), None)]
)
def test_samplers_that_cannot_be_are_refused(desc, count):
    with pytest.raises(SceneError):
        make_sampler(desc, types("float32"), count)


@pytest.mark.parametrize("arguments", [(0, 1), (1, 0), (1, 1, -1), (2**20, 2**12), (1, 1, 2**32)])
def test_passes_that_cannot_be_are_refused(arguments):
    with pytest.raises(ValueError, match="a pass"):
        Wavefront(*arguments)


def test_passes_cover_the_image_first():
    passes = split_passes(100, 10, 300)
    assert [(p.pixels, p.samples, p.first_sample) for p in passes] == [
        (100, 2, 0),
        (100, 3, 2),
        (100, 2, 5),
        (100, 3, 7),
    ]
    assert all(p.samples == 1 and p.pixels <= 30 for p in split_passes(100, 3, 30))
