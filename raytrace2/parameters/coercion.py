"""Values that users give for parameters, in the types that kernels read."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..errors import SettingError
from ..types import Types


def coerced_floats(key: str, given: Any, types: Types, width: int, wanted: str) -> Any:
    """``width`` numbers in one row (Float) from an array of any shape; ``wanted`` tells users what they are.

    As of all that is coerced here, derivatives stay, and ``SettingError`` names ``key`` if ``given`` is no such value.
    """
    if isinstance(given, dr.ArrayBase):
        value = types.Float(given.array if dr.is_tensor_v(given) else dr.ravel(given))
    else:
        value = copied(_numbers(key, given, wanted), types)
    if dr.width(value) != width:
        raise SettingError(f"{key} must be {wanted}, not {dr.width(value)}")
    return value


def coerced_triple(key: str, given: Any, types: Types, wanted: str) -> Any:
    """An Array3f from three numbers, or from one that stands for all three."""
    if isinstance(given, dr.ArrayBase) and dr.depth_v(given) == 2 and len(given) == 3:
        return types.Array3f(*(_entry(key, c, types) for c in given))
    if isinstance(given, dr.ArrayBase):
        flat = types.Float(given.array if dr.is_tensor_v(given) else dr.ravel(given))
        if dr.width(flat) not in (1, 3):
            raise SettingError(f"{key} must be {wanted}, not {dr.width(flat)}")
        return types.Array3f(*(_at(flat, k) for k in range(3))) if dr.width(flat) == 3 else types.Array3f(flat)
    array = _numbers(key, given, wanted).ravel()
    if array.size not in (1, 3):
        raise SettingError(f"{key} must be {wanted}, not {array.size}")
    return types.Array3f(*(types.Float(float(c)) for c in np.broadcast_to(array, 3)))


def coerced_matrix(key: str, given: Any, size: int, types: Types) -> Any:
    """A matrix from a matrix, a transform or an array."""
    kind = types.Matrix4f if size == 4 else types.Matrix3f
    # Of Dr.Jit arrays names of attributes pick components.
    given = given if isinstance(given, dr.ArrayBase) else getattr(given, "matrix", given)
    if isinstance(given, dr.ArrayBase) and dr.is_matrix_v(given) and len(given) == size:
        entries = [[given[i, j] for j in range(size)] for i in range(size)]
    elif isinstance(given, dr.ArrayBase) and dr.is_tensor_v(given) and tuple(given.shape) == (size, size):
        entries = [[_at(given.array, size * i + j) for j in range(size)] for i in range(size)]
    else:
        array = _numbers(key, given, f"a {size}x{size} matrix")
        if array.shape != (size, size):
            raise SettingError(f"{key} must be a {size}x{size} matrix, not of shape {array.shape}")
        entries = array.tolist()
    value = kind(*(_entry(key, e, types) for row in entries for e in row))
    if dr.flag(dr.JitFlag.FreezingScope):
        return value
    last = [float(dr.detach(value)[size - 1, j][0]) for j in range(size)]
    if last != [0.0] * (size - 1) + [1.0]:
        raise SettingError(f"{key} must be affine (last row {' '.join('0' * (size - 1))} 1), not {last}")
    return value


def coerced_tensor(key: str, given: Any, before: Any, types: Types) -> Any:
    """A tensor of the shape of ``before`` from a tensor or an array."""
    if isinstance(given, dr.ArrayBase) and dr.is_tensor_v(given):
        value = types.TensorXf(types.Float(given.array), given.shape)
    else:
        array = _numbers(key, given, "an image")
        value = types.TensorXf(copied(array, types), array.shape)
    if tuple(value.shape) != tuple(before.shape):
        raise SettingError(f"{key} must have the shape {tuple(before.shape)}, not {tuple(value.shape)}")
    return value


def converted(value: Any, types: Types) -> Any:
    """``value`` in the precision of ``types``, with its derivatives."""
    if dr.type_v(value) == dr.type_v(types.Float):
        return value
    if dr.is_tensor_v(value):
        return types.TensorXf(types.Float(value.array), value.shape)
    if dr.is_matrix_v(value):
        kind = types.Matrix4f if len(value) == 4 else types.Matrix3f
        return kind(*(types.Float(value[i, j]) for i in range(len(value)) for j in range(len(value))))
    return types.Array3f(*(types.Float(v) for v in value)) if dr.depth_v(value) > 1 else types.Float(value)


def copied(array: np.ndarray, types: Types) -> Any:
    """``array`` flattened, as a Float."""
    return owned(np.ascontiguousarray(array, types.numpy), types.Float)


def _entry(key: str, value: Any, types: Types) -> Any:
    value = types.Float(value)
    if dr.width(value) != 1:
        raise SettingError(f"{key} must be one value, not {dr.width(value)}")
    return value


def _at(flat: Any, k: int) -> Any:
    return dr.gather(type(flat), flat, dr.uint32_array_t(type(flat))(k))


def _numbers(key: str, given: Any, wanted: str) -> np.ndarray:
    if dr.grad_enabled(given):
        raise SettingError(f"{key} must be {wanted}: a {type(given).__name__} would lose its derivatives here")
    try:
        array = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise SettingError(f"{key} must be {wanted}, not {type(given).__name__}") from None
    except RuntimeError:
        # PyTorch's, of tensors that carry derivatives.
        message = f"{key}: a {type(given).__name__} loses its derivatives here: assign it in a function of dr.wrap"
        raise SettingError(message) from None
    return array
