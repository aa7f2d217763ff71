"""Derivatives of look-ups by texels, uv and footprints: against differences, in both modes, in symbolic loops."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

from raytrace2.live import Live, Place
from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, ReconstructionFilter
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.checker_coverage import odd_fraction
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
N = 30
CASES = [
    ("nearest", 1, "repeat", "box"), ("bilinear", 3, "clamp", "box"), ("bicubic", 1, "mirror", "box"),
    ("mip_distance", 1, "clamp", "tent"), ("trilinear", 3, "mirror", "gaussian"), ("ewa", 3, "clamp", "box"),
    ("ewa", 1, "repeat", "gaussian"), ("probes", 1, "repeat", "box"), ("probes", 3, "mirror", "tent"),
    ("exact", 3, "clamp", "box"), ("exact", 1, "repeat", "gaussian"), ("exact2", 1, "mirror", "box"),
    ("exact2", 1, "clamp", "tent"),
]  # fmt: skip
# What takes long to compile is not compiled for every mode.
SLOW = CASES[-3:]


class Case:
    """Look-ups of one filter in two images, of random uv and footprints (12 numbers a lane)."""

    def __init__(self, t: Types, name: str, channels: int, mode: Any, pixel: Any, of: str = "ewa") -> None:
        rng = np.random.default_rng(4)
        self.t = t
        images = [rng.random((12, 25, channels)), rng.random((32, 5, channels))]
        settings = FilterSettings(name, pixel=ReconstructionFilter(pixel), of=of, budget=60)
        textures = [BitmapTexture(image.astype(t.numpy), wrap_mode=mode) for image in images]
        self.table = Bitmaps(textures, t, settings)
        sizes = np.array([1, 1] + [0.2] * 4 + [0.02] * 6)[:, None]
        self.start = [t.Float(v) for v in (rng.random((12, N)) - 0.3) * sizes]
        self.random = t.Array2f(rng.random((2, N)))
        self.place = t.UInt(np.arange(N) % 2)
        self.weights = t.Array3f(1, 2, 3) if channels == 3 else t.Float(1.5)
        self.buffers = list(self.table.buffers)
        self.tangents = [t.Float(v) for v in rng.random((12, N)) - 0.5]
        self.texel_tangents = [t.Float(rng.random(len(b)) - 0.5) for b in self.buffers]
        dr.eval(self.start, self.random, self.place, self.tangents, self.texel_tangents)

    def bind(self, buffers: list[Any]) -> list[Any]:
        self.table.texels._buffer = buffers[0]
        if self.table.blocks is not None:
            self.table.blocks.data = buffers[1], self.table.blocks.data[1]
        return buffers

    def attached(self) -> list[Any]:
        buffers = [type(b)(b) for b in self.buffers]
        dr.enable_grad(buffers)
        return self.bind(buffers)

    def value(self, a: list[Any]) -> Any:
        pairs = [self.t.Array2f(a[k], a[k + 1]) for k in range(0, 12, 2)]
        footprint = Footprint(*pairs[1:], random=self.random)  # type: ignore[misc]
        value = self.table.eval(self.place, pairs[0], footprint, self.t.Bool(True))
        return dr.dot(value, self.weights) if dr.depth_v(value) > 1 else value * self.weights

    def reverse(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Gradients by the 12 numbers of each lane and by buffers."""
        buffers = self.attached()
        inputs = [type(x)(x) for x in self.start]
        dr.enable_grad(inputs)
        dr.backward_from(self.value(inputs))
        return np.array([np.array(dr.grad(x)) for x in inputs]), [np.array(dr.grad(b)) for b in buffers]

    def reverse_in_a_loop(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """The same by two turns of a symbolic loop, each of which differentiates its own look-up."""
        buffers = self.attached()

        def turn(k: Any, a: list[Any], total: list[Any]) -> tuple[Any, ...]:
            with dr.resume_grad():
                local = [type(x)(x) for x in a]
                dr.enable_grad(local)
                dr.backward_from(self.value(local))
                found = [dr.grad(x) for x in local]
            return k + 1, a, [x + y for x, y in zip(total, found, strict=True)]

        with dr.suspend_grad():
            state = dr.zeros(self.t.UInt, N), self.start, [dr.zeros(self.t.Float, N) for _ in self.start]
            total = dr.while_loop(state, lambda k, *_: k < 2, turn)[2]
        dr.eval(total)
        return np.array([np.array(x) for x in total]) / 2, [np.array(dr.grad(b)) / 2 for b in buffers]

    def forward_in_a_loop(self) -> np.ndarray:
        for buffer, tangent in zip(self.attached(), self.texel_tangents, strict=True):
            dr.set_grad(buffer, tangent)

        def turn(k: Any, a: list[Any], total: Any) -> tuple[Any, ...]:
            with dr.resume_grad():
                local = [type(x)(x) for x in a]
                dr.enable_grad(local)
                for x, tangent in zip(local, self.tangents, strict=True):
                    dr.set_grad(x, tangent)
                found = dr.forward_to(self.value(local), flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            return k + 1, a, total + found

        with dr.suspend_grad():
            state = dr.zeros(self.t.UInt, N), self.start, dr.zeros(self.t.Float, N)
            return np.array(dr.while_loop(state, lambda k, *_: k < 2, turn)[2]) / 2

    def difference(self, numbers: slice, texels: bool, h: float = 1e-7) -> np.ndarray:
        """The central difference along the tangents of some numbers, or of texels."""
        ends = []
        for s in (-h, h):
            steps = [s if k in range(12)[numbers] else 0.0 for k in range(12)]
            moved = zip(self.buffers, self.texel_tangents, strict=True)
            self.bind([b + s * d if texels else b for b, d in moved])
            at = [x + step * d for x, step, d in zip(self.start, steps, self.tangents, strict=True)]
            ends.append(np.array(self.value(at)))
        self.bind(self.buffers)
        return (ends[1] - ends[0]) / (2 * h)


@pytest.mark.parametrize("case", CASES, ids=lambda c: "-".join(map(str, c)))
def test_derivatives_against_differences(case: tuple[Any, ...]) -> None:
    case_of = Case(T64, *case)
    numbers, texels = case_of.reverse_in_a_loop()
    along = numbers * np.array([np.array(d) for d in case_of.tangents])
    scale = 1 + np.abs(numbers).max()
    for part in (slice(0, 2), slice(2, 6), slice(6, 12)):
        error = np.abs(along[part].sum(0) - case_of.difference(part, False))
        # Points beside a kink, and texels that come to lie within an ellipse, are few.
        assert np.quantile(error, 0.9) <= 1e-6 * scale
    by_texels = sum((g * np.array(d)).sum() for g, d in zip(texels, case_of.texel_tangents, strict=True))
    assert by_texels == pytest.approx(case_of.difference(slice(0, 0), True, 0.5).sum(), rel=1e-9)
    if case in SLOW:
        return
    forward = case_of.forward_in_a_loop()
    assert forward.sum() == pytest.approx(along.sum() + by_texels, rel=1e-9, abs=1e-9 * scale)
    outside, texels_outside = case_of.reverse()
    assert np.allclose(outside, numbers, rtol=1e-9, atol=1e-10 * scale)
    for a, b in zip(texels_outside, texels, strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", [CASES[k] for k in (1, 4, 5, 8, 9)], ids=lambda c: "-".join(map(str, c)))
def test_single_precision_agrees_with_double(case: tuple[Any, ...]) -> None:
    numbers, texels = Case(T32, *case).reverse()
    expected, expected_texels = Case(T64, *case).reverse()
    error = np.abs(numbers - expected).max(0) / np.abs(expected).max()
    assert np.quantile(error, 0.9) <= 1e-3
    for a, b in zip(texels, expected_texels, strict=True):
        assert np.linalg.norm(a - b) <= 1e-3 * np.linalg.norm(b)


@pytest.mark.parametrize("of", ["bilinear", "trilinear", "ewa", "probes"])
def test_stochastic_derivatives_are_those_of_the_filter(of: str) -> None:
    chosen, expected = Case(T64, "stochastic", 1, "repeat", "box", of), Case(T64, of, 1, "repeat", "box")
    numbers, texels = chosen.reverse()
    expected_numbers, expected_texels = expected.reverse()
    assert np.allclose(numbers, expected_numbers, rtol=1e-12, atol=1e-14)
    assert np.allclose(texels[0], expected_texels[0], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("of", ["exact", "exact2"])
def test_stochastic_places_in_the_pixel_move_with_the_footprint(of: str) -> None:
    case = Case(T64, "stochastic", 3, "clamp", "tent", of)
    still = Case(T64, "bilinear", 3, "clamp", "tent")
    _, texels = case.reverse()
    # Each lane reads what four weights that sum to 1 give.
    _, expected = still.reverse()
    assert texels[0].sum() == pytest.approx(expected[0].sum())
    numbers, _ = case.reverse_in_a_loop()
    assert np.isfinite(numbers).all()
    assert (np.abs(numbers[2:6]).max(1) > 0).all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", ["bilinear", "trilinear", "ewa", "probes", "exact2", "stochastic"])
def test_extremes_have_finite_derivatives(name: str, precision: Any) -> None:
    t = types(precision)
    image = np.random.default_rng(2).random((12, 25, 1))
    table = Bitmaps([BitmapTexture(image.astype(t.numpy), wrap_mode="clamp")], t, FilterSettings(name))
    lengths = [0, 1e-38, 1e-30, 1e-20, 1e-9, 1e-4, 0.03, 1, 1e4, 1e9, 1e18, 1e30, np.inf, np.nan, -0.04]
    shapes = [(1, 0, 0, 1), (1, 0, 0, 0), (1, 1, 1, 1), (0, 1, -1, 0), (1, 1e-8, 0, 1)]
    rows = []
    for u, f, shape in itertools.product([0.3, 0.0, 0.02, 1e-30, -7e5, 3e9, 1e30], lengths, shapes):
        with np.errstate(invalid="ignore"):
            rows.append([u, 0.4, *(0 if s == 0 else f * s for s in shape), *[0.1 * f] * 6])
    # And edges that are nearly level or steep, one of them beside a cell's.
    rows += [[0.3, 0.4, 0.04, f, 0.03, 0.05, *[0] * 6] for f in lengths]
    rows += [[0.3, 0.5, f, 0.04, 0.05, f, *[0] * 6] for f in lengths]
    inputs = [t.Float(v) for v in np.array(rows).T]
    dr.enable_grad(inputs, table.texels._buffer)
    if table.blocks is not None:
        dr.enable_grad(table.blocks.data)
    pairs = [t.Array2f(inputs[k], inputs[k + 1]) for k in range(0, 12, 2)]
    value = table.eval(t.UInt(0), pairs[0], Footprint(*pairs[1:], random=t.Array2f(0.3, 0.6)), t.Bool(True))  # type: ignore[misc]
    dr.backward_from(value)
    # A texture of 25 texels in [0, 1] changes no faster than this, in uv or in a footprint of a texel or more.
    assert all(np.abs(dr.grad(x)).max() < 300 for x in inputs)
    assert np.isfinite(np.array(dr.grad(table.texels._buffer))).all()


@pytest.mark.parametrize(
    ("name", "channels"),
    [("bilinear", 3), ("trilinear", 1), ("trilinear", 3), ("ewa:lanczos", 1), ("exact", 1), ("exact", 3)],
)
def test_texels_through_pyramids_and_blocks(name: str, channels: int) -> None:
    """The look-up is linear in texels, so differences are exact."""
    t, n = T64, 60
    rng = np.random.default_rng(6)
    filter_name, *kernel = name.split(":")
    settings = FilterSettings(filter_name, pyramid=kernel[0] if kernel else "box", budget=40)
    shapes = [(7, 5), (16, 8), (1, 9), (33, 20)]
    textures = [BitmapTexture(rng.random((*s, channels)), wrap_mode="repeat", raw=True) for s in shapes]
    places = [Place(textures[k], "pixels") for k in (0, 1, 3)]
    table = Bitmaps(textures, t, settings, Live(places))
    tensors = {id(p.owner): t.TensorXf(p.owner.pixels) for p in places}
    place = t.UInt(rng.integers(0, 4, n))
    u = t.Array2f(rng.random((2, n)))
    # Some see many periods, of which nothing but the mean is left.
    size = 10.0 ** rng.uniform(-2, 2, n)
    footprint = [t.Array2f(rng.normal(size=(2, n)) * size) for _ in range(2)]
    weights = t.Float(rng.normal(size=n))

    def value(tensors: dict[int, Any]) -> Any:
        for slot in table.slots(moves=False):
            slot.assign(slot.made(_present(tensors)))
        found = table.eval(place, u, Footprint(*footprint), t.Bool(True))
        return dr.sum((found.x + 2 * found.y - found.z if channels == 3 else found) * weights)

    slots = table.slots(moves=False)
    before = [slot.value for slot in slots]
    dr.enable_grad(list(tensors.values()))
    dr.backward_from(value(tensors))
    gradients = {k: np.array(dr.grad(v)) for k, v in tensors.items()}
    steps = {k: t.TensorXf(rng.normal(size=v.shape)) for k, v in tensors.items()}
    ends = [value({k: dr.detach(v) + s * steps[k] for k, v in tensors.items()})[0] for s in (-1, 1)]
    along = sum((gradients[k] * np.array(steps[k])).sum() for k in tensors)
    assert along == pytest.approx((ends[1] - ends[0]) / 2, rel=1e-6)
    for slot, old in zip(slots, before, strict=True):
        slot.assign(old)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("dtype", ["float16", "float32"])
@pytest.mark.parametrize("channels", [1, 3])
def test_new_texels_are_as_if_they_had_been_there(channels: int, dtype: str, precision: Any) -> None:
    t = types(precision)
    rng = np.random.default_rng(8)
    shapes = [(8, 16), (7, 5), (1, 1), (33, 20)]
    before, after = ([rng.random((*s, channels)).astype(dtype) for s in shapes] for _ in range(2))
    for name, mode, filter_type in itertools.product(
        ("trilinear", "exact"), ("repeat", "clamp"), ("bilinear", "nearest")
    ):
        some = {"wrap_mode": mode, "filter_type": filter_type, "raw": True}
        old = [BitmapTexture(x, **some) for x in before]  # type: ignore[arg-type]
        new = [BitmapTexture(y if i != 1 else x, **some) for i, (x, y) in enumerate(zip(before, after, strict=True))]  # type: ignore[arg-type]
        values = {id(o): t.TensorXf(n.pixels.astype(t.numpy)) for o, n in zip(old, new, strict=True)}
        live = Live([Place(o, "pixels") for i, o in enumerate(old) if i != 1])
        for given in (slice(0, 4), slice(1, 2), slice(2, 3)):
            table = Bitmaps(old[given], t, FilterSettings(name), live)
            expected = Bitmaps(new[given], t, FilterSettings(name))
            for slot in table.slots(moves=False):
                slot.assign(slot.made(_present(values)))
            # Coarser levels of halves are not rounded to halves.
            tolerance = 2.0**-10 if dtype == "float16" and name == "trilinear" else 0
            a, b = (np.array(x.texels._buffer, np.float64) for x in (table, expected))
            assert np.allclose(a, b, rtol=tolerance, atol=0)
            if table.blocks is not None:
                assert expected.blocks is not None
                for x, y in zip(_leaves(table.blocks.data), _leaves(expected.blocks.data), strict=True):
                    assert np.array_equal(x, y)


def test_later_steps_compile_nothing() -> None:
    t = T32
    texture = BitmapTexture(np.random.default_rng(3).random((20, 33, 3)).astype(np.float32), raw=True)
    for name in ("trilinear", "exact"):
        table = Bitmaps([texture], t, FilterSettings(name), Live([Place(texture, "pixels")]))
        for step in range(4):
            tensor = t.TensorXf(texture.pixels) * dr.opaque(t.Float, 1 + step)
            dr.eval(tensor)
            dr.enable_grad(tensor)
            with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
                dr.kernel_history_clear()
                now = _present({id(texture): tensor})
                made = [v for slot in table.slots(moves=False) for v in _attached(slot.made(now))]
                for v in made:
                    dr.set_grad(v, dr.ones(type(v), len(v)))
                dr.enqueue(dr.ADMode.Backward, *made)
                dr.traverse(dr.ADMode.Backward)
                dr.eval(dr.grad(tensor))
                kernels = dr.kernel_history([dr.KernelType.JIT])
            assert step < 2 or all(k["cache_hit"] for k in kernels)


@pytest.mark.parametrize(("name", "pyramid"), [("trilinear", "lanczos"), ("exact", "box")])
def test_what_is_made_of_texels_can_be_frozen(name: str, pyramid: str) -> None:
    t = T32
    rng = np.random.default_rng(5)
    textures = [BitmapTexture(rng.random(s).astype(np.float32), raw=True) for s in ((30, 41, 3), (16, 16, 3))]
    live = Live([Place(texture, "pixels") for texture in textures])
    table = Bitmaps(textures, t, FilterSettings(name, pyramid=pyramid), live)

    def gradients(tensors: list[Any]) -> list[Any]:
        dr.enable_grad(tensors)
        now = _present({id(texture): x for texture, x in zip(textures, tensors, strict=True)})
        made = [v for slot in table.slots(moves=False) for v in _attached(slot.made(now))]
        for v in made:
            dr.set_grad(v, dr.square(dr.detach(v)))
        dr.enqueue(dr.ADMode.Backward, *made)
        dr.traverse(dr.ADMode.Backward)
        return [dr.grad(x).array for x in tensors]

    known = [_leaves(slot.base) for slot in table.slots(moves=False)]
    frozen = dr.freeze(gradients, state_fn=lambda _: (table.held_elsewhere(), known))
    for step in range(3):
        tensors = [t.TensorXf(texture.pixels) * dr.opaque(t.Float, step + 1) for texture in textures]
        dr.eval(tensors)
        expected = [np.array(x) for x in gradients([t.TensorXf(x) for x in tensors])]
        for x, y in zip(frozen(tensors), expected, strict=True):
            assert np.allclose(x, y, rtol=1e-4, atol=1e-5)


def test_checkerboard_coverage() -> None:
    t, n = T64, 40
    rng = np.random.default_rng(9)
    start = [t.Float(v) for v in (rng.random((6, n)) - 0.3) * np.array([5, 5, 3, 3, 3, 3])[:, None]]

    def value(a: list[Any]) -> Any:
        return odd_fraction(t.Array2f(a[0], a[1]), t.Array2f(a[2], a[3]), t.Array2f(a[4], a[5]), t.Bool(True))

    inputs = [t.Float(x) for x in start]
    dr.enable_grad(inputs)
    dr.backward_from(value(inputs))
    gradients = [np.array(dr.grad(x)) for x in inputs]
    for k in range(6):
        inputs = [t.Float(x) for x in start]
        dr.enable_grad(inputs[k])
        dr.set_grad(inputs[k], 1)
        forward = np.array(dr.forward_to(value(inputs)))
        assert np.allclose(forward, gradients[k], rtol=1e-9, atol=1e-12)
        ends = [value([x + (s if i == k else 0) for i, x in enumerate(start)]) for s in (-1e-6, 1e-6)]
        assert np.allclose(forward, (np.array(ends[1]) - np.array(ends[0])) / 2e-6, rtol=1e-5, atol=1e-6)


def _present(values: dict[int, Any]) -> Callable[[Place], Any]:
    return lambda place: values[id(place.owner)]


def _leaves(tree: Any) -> list[Any]:
    return [tree] if dr.is_array_v(tree) else [leaf for part in tree for leaf in _leaves(part)]


def _attached(tree: Any) -> list[Any]:
    return [leaf for leaf in _leaves(tree) if dr.grad_enabled(leaf)]
