"""Pseudo-random building blocks of the samplers: hashes, permutations and uniform numbers of either precision."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import types
from .wavefront import Wavefront

_UInt = types("float32").UInt
_UInt64 = types("float32").UInt64


def sample_tea(v0: Any, v1: Any, rounds: int = 4) -> tuple[Any, Any]:
    """Two UInt scrambled by the Tiny Encryption Algorithm (Zafar, Olano and Curtis 2010, HPG)."""
    total = 0
    for _ in range(rounds):
        total = (total + 0x9E3779B9) & 0xFFFFFFFF
        v0 = v0 + (((v1 << 4) + 0xA341316C) ^ (v1 + total) ^ ((v1 >> 5) + 0xC8013EA4))
        v1 = v1 + (((v0 << 4) + 0xAD90777D) ^ (v0 + total) ^ ((v0 >> 5) + 0x7E95761E))
    return v0, v1


def opaque_sum(*numbers: Any) -> Any:
    """The sum of whole numbers (ints, UInts of width 1) modulo 2^32, a UInt that kernels read from memory."""
    known = sum(n for n in numbers if isinstance(n, int))
    total = dr.opaque(_UInt, known % 2**32)
    for n in numbers:
        if not isinstance(n, int):
            total = total + _UInt(n)
    dr.make_opaque(total)
    return total


def mix(x: Any) -> Any:
    """A UInt whose bits each depend on all bits of ``x`` (a bijection; finaliser found by Ellis 2018, "prospector")."""
    x = (x ^ (x >> 16)) * 0x7FEB352D
    x = (x ^ (x >> 15)) * 0x846CA68B
    return x ^ (x >> 16)


def sequence_streams(wavefront: Wavefront, sample_count: int) -> tuple[Any, Any, Any]:
    """Per lane, three UInt: its number in the whole image, where its pixel's numbers begin, and its sample within it.

    Lanes are numbered as if all ``sample_count`` samples of all pixels were one wavefront, so that what a sample draws
    does not depend on how a render is split into passes. Past 2^32, numbers wrap into unrelated ones.
    """
    pixel, sample = wavefront.pixel_and_sample()
    count = dr.opaque(_UInt, sample_count)
    first = pixel * count
    lane = first + sample
    if (wavefront.first_pixel + wavefront.pixels) * sample_count > 2**32:
        wide = _UInt64(pixel) * _UInt64(count)
        turn = _UInt((wide + _UInt64(sample)) >> 32)
        lane = dr.select(turn == 0, lane, mix(lane ^ mix(turn + 0x9E3779B9)))
        turn = _UInt(wide >> 32)
        first = dr.select(turn == 0, first, mix(first ^ mix(turn + 0x9E3779B9)))
    return lane, first, sample


def permute(index: Any, count: Any, power_of_two: bool, seed: Any) -> Any:
    """Where a random permutation of ``0 ... count - 1``, chosen lane by lane by ``seed``, takes ``index``.

    Kensler 2013 ("Correlated Multi-Jittered Sampling", Pixar memo 13-01): a hash on the next power of two, walked until
    it falls below ``count``, which a power of two makes needless. ``count`` is a UInt of width 1, at least 1.
    """
    if power_of_two:
        return (_kensler_hash(index, count - 1, seed) + seed) & (count - 1)
    mask = count - 1
    for shift in (1, 2, 4, 8, 16):
        mask = mask | (mask >> shift)

    def walk(walking: Any, index: Any) -> tuple[Any, Any]:
        index = dr.select(walking, _kensler_hash(index, mask, seed), index)
        return walking & (index >= count), index

    walking = dr.full(dr.mask_t(index), True, dr.width(index))
    _, index = dr.while_loop((walking, index), lambda walking, index: walking, walk, labels=("walking", "index"))
    return (index + seed) % count


def _kensler_hash(index: Any, mask: Any, seed: Any) -> Any:
    x = (index ^ seed) * 0xE170893D
    x = x ^ (seed >> 16)
    x = x ^ ((x & mask) >> 4)
    x = (x ^ (seed >> 8)) * 0x0929EB3F
    x = x ^ (seed >> 23)
    x = x ^ ((x & mask) >> 1)
    x = x * ((seed >> 27) | 1) * 0x6935FA69
    x = (x ^ ((x & mask) >> 11)) * 0x74DCB303
    x = (x ^ ((x & mask) >> 2)) * 0x9E501CC3
    x = (x ^ ((x & mask) >> 2)) * 0xC860A3DF
    x = x & mask
    return x ^ (x >> 5)


def uniform(rng: Any, precision: str, active: Any = True) -> Any:
    """A Float in [0, 1) from the PCG32 ``rng``, which advances by one step where ``active``.

    float32 numbers have 23 random bits, as Mitsuba's; float64 ones have 53, of which the first 23 are those that
    float32 would have got: renders in the two precisions take the same samples.
    """
    t = types(precision)
    arguments = () if active is True else (t.Bool(active),)
    if precision == "float32":
        return rng.next_float32(*arguments)
    state = t.UInt64(rng.state)
    high = rng.next_uint32(*arguments)
    state = (state ^ (state >> 33)) * 0xFF51AFD7ED558CCD
    state = (state ^ (state >> 33)) * 0xC4CEB9FE1A85EC53
    return t.Float((t.UInt64(high) << 21) | (state >> 43)) * 2.0**-53


def fraction(bits: Any, precision: str) -> Any:
    """The UInt ``bits`` as a binary fraction in [0, 1): its first 24 bits in float32, all 32 in float64."""
    t = types(precision)
    return t.Float(bits >> 8) * 2.0**-24 if precision == "float32" else t.Float(bits) * 2.0**-32


def below_one(x: Any, precision: str) -> Any:
    """``x``, or the largest number below 1 where rounding took it to 1."""
    return dr.fmin(x, 1 - types(precision).epsilon)
