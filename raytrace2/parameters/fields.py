"""What a value of a description looks like as a parameter, and back: one class for each kind of value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..errors import SettingError
from ..scene.color import linear_pixels
from ..scene.mesh_files.normals import vertex_normals
from ..types import Types
from .coercion import coerced_floats, coerced_matrix, coerced_tensor, coerced_triple, copied


@dataclass(frozen=True)
class Field:
    """``moves_surfaces``: where rays meet surfaces changes with it. ``differentiable``: kernels take derivatives by
    it. ``name``: that of the attribute."""

    name: str
    moves_surfaces: bool = False
    differentiable: bool = True

    def read(self, owner: Any, types: Types) -> Any:
        """The value that ``owner`` has, as Dr.Jit arrays that kernels read from memory."""
        raise NotImplementedError

    def replaced(self, owner: Any, value: Any) -> Any:
        """``owner`` with the detached ``value`` in its place."""
        raise NotImplementedError

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        """``given`` in the type of ``before``, with its derivatives. ``SettingError`` that names ``key`` if it is no
        such value."""
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Field):
    """One float."""

    above: float = -np.inf
    below: float = np.inf

    def read(self, owner: Any, types: Types) -> Any:
        return dr.opaque(types.Float, float(getattr(owner, self.name)))

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, **{self.name: float(value[0])})

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        value = coerced_floats(key, given, types, 1, "one number")
        if dr.flag(dr.JitFlag.FreezingScope):
            return value
        if not self.above < float(dr.detach(value)[0]) < self.below:
            raise SettingError(f"{key} must lie between {self.above:g} and {self.below:g}, not {value[0]:g}")
        return value


@dataclass(frozen=True)
class IndexRatio(Number):
    """The relative index of refraction, ``int_ior / ext_ior``."""

    def read(self, owner: Any, types: Types) -> Any:
        return dr.opaque(types.Float, owner.int_ior / owner.ext_ior)

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, int_ior=float(value[0]), ext_ior=1.0)


@dataclass(frozen=True)
class Color(Field):
    """A colour: Float where it was written as one number (``grey``), Array3f elsewhere."""

    def read(self, owner: Any, types: Types) -> Any:
        color = getattr(owner, self.name)
        if owner.grey:
            return dr.opaque(types.Float, float(color[0]))
        return types.Array3f(*(dr.opaque(types.Float, float(c)) for c in color))

    def replaced(self, owner: Any, value: Any) -> Any:
        color = [float(v[0]) for v in value] if dr.depth_v(value) > 1 else [float(value[0])] * 3
        return replace(owner, **{self.name: tuple(color)})

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        if dr.depth_v(before) > 1:
            return coerced_triple(key, given, types, "a colour of three numbers")
        return coerced_floats(key, given, types, 1, "one number: it was written as one")


@dataclass(frozen=True)
class Point(Field):
    """Three coordinates."""

    def read(self, owner: Any, types: Types) -> Any:
        return types.Array3f(*(dr.opaque(types.Float, float(c)) for c in getattr(owner, self.name)))

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, **{self.name: tuple(float(v[0]) for v in value)})

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        return coerced_triple(key, given, types, "three numbers")


@dataclass(frozen=True)
class Transform(Field):
    """A matrix of ``size`` rows; ``np.ndarray`` in the description."""

    size: int = 4

    def read(self, owner: Any, types: Types) -> Any:
        return _matrix(np.asarray(getattr(owner, self.name), np.float64), types)

    def replaced(self, owner: Any, value: Any) -> Any:
        matrix = np.array([[float(value[i, j][0]) for j in range(self.size)] for i in range(self.size)])
        matrix.setflags(write=False)
        return replace(owner, **{self.name: matrix})

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        return coerced_matrix(key, given, self.size, types)


@dataclass(frozen=True)
class Direction(Transform):
    """A transform of which only the direction of local +z counts."""

    def read(self, owner: Any, types: Types) -> Any:
        z = np.asarray(owner.direction, np.float64)
        z = z / np.linalg.norm(z)
        sign = np.copysign(1.0, z[2])
        a = -1.0 / (sign + z[2])
        up = np.array([1.0 + sign * z[0] ** 2 * a, sign * z[0] * z[1] * a, -sign * z[0]])
        left = np.cross(up, z)
        matrix = np.eye(4)
        matrix[:3, :3] = np.column_stack([left, np.cross(z, left), z])
        return _matrix(matrix, types)

    def replaced(self, owner: Any, value: Any) -> Any:
        z = np.array([float(value[i, 2][0]) for i in range(3)])
        return replace(owner, direction=tuple(float(x) for x in z))

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        value = coerced_matrix(key, given, 4, types)
        if dr.flag(dr.JitFlag.FreezingScope):
            return value
        if not any(float(dr.detach(value)[i, 2][0]) for i in range(3)):
            raise SettingError(f"{key} takes the direction of light, its third column, to nothing")
        return value


@dataclass(frozen=True)
class Pixels(Field):
    """A linear image (height, width, channels)."""

    def read(self, owner: Any, types: Types) -> Any:
        return _tensor(linear_pixels(owner), types)

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, pixels=_host(value), raw=True)

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        return coerced_tensor(key, given, before, types)


@dataclass(frozen=True)
class SkyPixels(Pixels):
    """An environment map as Mitsuba has it: a column more on either side, which repeats that of the other side. Those
    two are not read when it is set."""

    def read(self, owner: Any, types: Types) -> Any:
        return _tensor(np.pad(np.asarray(owner.pixels), ((0, 0), (1, 1), (0, 0)), mode="wrap"), types)

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, pixels=_host(value)[:, 1:-1])


@dataclass(frozen=True)
class Buffer(Field):
    """An array (n, columns), flat. ``sign`` tells of an owner whether the description holds the negative."""

    sign: Callable[[Any], float] = lambda _: 1.0

    def array(self, owner: Any) -> np.ndarray:
        """What the description holds."""
        return np.asarray(getattr(owner, self.name))

    def read(self, owner: Any, types: Types) -> Any:
        return copied(self.array(owner) * self.sign(owner), types)

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, **{self.name: self.host(owner, value)})

    def host(self, owner: Any, value: Any) -> np.ndarray:
        """``value`` as the description holds it."""
        array = np.array(value.numpy(), np.float64).reshape(self.array(owner).shape) * self.sign(owner)
        array.setflags(write=False)
        return array

    def coerced(self, key: str, given: Any, before: Any, types: Types) -> Any:
        return coerced_floats(key, given, types, dr.width(before), f"{dr.width(before)} numbers in one row")


@dataclass(frozen=True)
class Positions(Buffer):
    """Vertices of a mesh; normals that it has are computed anew, as in Mitsuba."""

    def replaced(self, owner: Any, value: Any) -> Any:
        moved = super().replaced(owner, value)
        if owner.normals is None:
            return moved
        return replace(moved, normals=vertex_normals(moved.vertices, moved.faces))


@dataclass(frozen=True)
class Attribute(Buffer):
    """An attribute of the vertices or faces of a mesh."""

    def array(self, owner: Any) -> np.ndarray:
        return np.asarray(owner.attributes[self.name])

    def replaced(self, owner: Any, value: Any) -> Any:
        return replace(owner, attributes={**owner.attributes, self.name: self.host(owner, value)})


def _matrix(matrix: np.ndarray, types: Types) -> Any:
    kind = types.Matrix4f if len(matrix) == 4 else types.Matrix3f
    return kind(*(dr.opaque(types.Float, float(x)) for x in matrix.ravel()))


def _tensor(pixels: np.ndarray, types: Types) -> Any:
    return types.TensorXf(copied(pixels, types), pixels.shape)


def _host(value: Any) -> np.ndarray:
    array = np.array(value.numpy())
    array.setflags(write=False)
    return array
