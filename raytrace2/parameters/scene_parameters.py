"""Parameters of a scene by name, as ``mi.traverse`` gives them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from typing import Any

import drjit as dr

from ..buffers import apart
from ..errors import SettingError
from ..scene.scene import Scene
from ..types import types
from .coercion import converted
from .names import Parameter, parameters


class SceneParameters(Mapping[str, Any]):
    """A mapping of names to values, Dr.Jit arrays of one precision; see :func:`traverse`.

    As in Mitsuba, iterating gives pairs of names and values, what is read may be changed in place, and nothing of it
    shows in the scene before :meth:`update`. Functions that Dr.Jit freezes (``dr.freeze``) take them as an argument,
    which has all of the scene in it.
    """

    #: As Dr.Jit sees them.
    DRJIT_STRUCT = {"scene": Scene, "frozen_values": dict}

    def __init__(self, scene: Scene, precision: str, known: Mapping[str, Parameter]) -> None:
        self.scene = scene
        self.types = types(precision)
        self._known = dict(known)
        self._values: dict[str, Any] = {}
        #: What was assigned, and the copies of it that are the values.
        self._copied: dict[str, tuple[Any, Any]] = {}
        self._handed_out: dict[str, tuple[Any, ...]] = {}
        self._dirty: set[str] = set()

    @property
    def frozen_values(self) -> dict[str, Any]:
        """What a function that Dr.Jit freezes reads and writes besides the scene."""
        return self._values if dr.flag(dr.JitFlag.EnableObjectTraversal) else {}

    def keys(self) -> Any:
        """The names."""
        return self._known.keys()

    def __len__(self) -> int:
        return len(self._known)

    def __contains__(self, key: object) -> bool:
        return key in self._known

    def __iter__(self) -> Iterator[Any]:
        return iter([(key, self[key]) for key in self._known])

    def items(self) -> Any:
        """Pairs of names and values."""
        return iter(self)

    def values(self) -> Any:
        """The values."""
        return [self[key] for key in self._known]

    def __getitem__(self, key: str) -> Any:
        value = self._value(key)
        self._handed_out.setdefault(key, _indices(value))
        return value

    def __setitem__(self, key: str, value: Any) -> None:
        before = self._value(key)
        new = self._parameter(key).field.coerced(key, value, before, self.types)
        if _indices(new) == _indices(before):
            return
        if not dr.flag(dr.JitFlag.FreezingScope):
            known = self._copied.get(key)
            if known is not None and _indices(list(known)) == _indices([new, before]):
                return
            given, new = new, apart(new)
            self._copied[key] = given, new
        self._values[key] = new
        self._dirty.add(key)

    def __delitem__(self, key: str) -> None:
        self._parameter(key)
        del self._known[key]

    def set_dirty(self, key: str) -> None:
        """Tells that the value of ``key`` was changed in a way that cannot be seen, such as ``dr.scatter`` into it."""
        self._value(key)
        self._dirty.add(key)

    def flags(self, key: str) -> str:
        """``"D"`` where surfaces move with it (and so silhouettes do), which interior derivatives do not heed; else
        empty."""
        return "D" if self._parameter(key).field.moves_surfaces else ""

    def update(self, values: Mapping[str, Any] | None = None) -> list[str]:
        """Lets the scene have what was assigned or changed in place, after assigning those of ``values`` that have the
        name of a parameter here. Returns the names of what changed.

        :class:`~raytrace2.SettingError` and :class:`~raytrace2.GeometryError` for values that the scene cannot have;
        it then stays as it was.
        """
        for key, value in (values or {}).items():
            if key in self:
                self[key] = value
        for key, before in self._handed_out.items():
            if key in self._known and _indices(self._value(key)) != before:
                self._dirty.add(key)
        changed = [key for key in self._known if key in self._dirty]
        try:
            self._commit(changed)
        finally:
            self._dirty.clear()
            self._handed_out.clear()
        return changed

    def with_derivatives(self) -> list[str]:
        """The names of the values that carry derivatives. The scene has these from then on, also where
        ``dr.enable_grad`` came after the last :meth:`update`."""
        entries = self.scene.store.entries
        seen = [key for key, p in self._known.items() if key in self._values or p.place in entries]
        found = [key for key in seen if dr.grad_enabled(self._value(key))]
        asked = [key for key in found if not self._is_known(key)]
        if asked:
            self._commit(asked)
        return found

    def _is_known(self, key: str) -> bool:
        entry, value = self.scene.store.entries.get(self._known[key].place), self._values[key]
        if entry is None:
            return False
        # What was set in another precision carries the derivatives that it has there.
        return dr.type_v(entry.value) != dr.type_v(value) or _indices(entry.value) == _indices(value)

    def _commit(self, keys: list[str]) -> None:
        for key in keys:
            dr.make_opaque(self._values[key])
        # A function that is being frozen cannot look at values.
        checked = not dr.flag(dr.JitFlag.FreezingScope)
        try:
            if checked:
                self._check(keys)
            known = [self._known[key] for key in keys]
            self.scene.assign([(p.key, p.place, p.field, self._values[p.key]) for p in known], checked=checked)
        except ValueError:
            for key in keys:
                self._values.pop(key, None)
            raise

    def keep(self, keys: str | list[str] | None) -> None:
        """Forgets all parameters but those whose names begin with one of the regular expressions ``keys``; None keeps
        all."""
        if keys is None:
            return
        patterns = [re.compile(key) for key in ([keys] if isinstance(keys, str) else keys)]
        self._known = {key: p for key, p in self._known.items() if any(x.match(key) for x in patterns)}

    def copy(self) -> SceneParameters:
        """Parameters of the same scene, of which others may be kept."""
        return SceneParameters(self.scene, self.types.precision, self._known)

    def __repr__(self) -> str:
        if not self._known:
            return "SceneParameters[]"
        names = max(map(len, self._known)) + 2
        kinds = max(len(type(self._value(key)).__name__) for key in self._known) + 2
        rule = "  " + "-" * (names + kinds + 30)
        rows = [rule, f"  {'Name':{names}}{'Flags':7}{'Type':{kinds}}Parent", rule]
        for key, p in self._known.items():
            flags = ", ".join(["∂", *self.flags(key)])
            rows.append(f"  {key:{names}}{flags:7}{type(self._value(key)).__name__:{kinds}}{p.parent}")
        return "SceneParameters[\n" + "\n".join(rows) + "\n]"

    def _parameter(self, key: str) -> Parameter:
        if key not in self._known:
            near = difflib.get_close_matches(str(key), self._known, 3, 0.4)
            hint = f"; did you mean {', '.join(near)}?" if near else "; print the parameters to see their names"
            raise KeyError(f"there is no parameter {key!r}{hint}")
        return self._known[key]

    def _value(self, key: str) -> Any:
        parameter = self._parameter(key)
        entry = self.scene.store.entries.get(parameter.place)
        if entry is not None and key not in self._dirty and key not in self._handed_out:
            # Another set of parameters may have changed it.
            self._values[key] = converted(entry.value, self.types)
        if key not in self._values:
            self._values[key] = parameter.field.read(parameter.place.owner, self.types)
        return self._values[key]

    def _check(self, keys: list[str]) -> None:
        finite = [dr.all(dr.isfinite(dr.ravel(dr.detach(self._values[key])))) for key in keys]
        dr.eval(finite)
        for key, good in zip(keys, finite, strict=True):
            if not bool(good):
                raise SettingError(f"{key} has values that are not finite numbers")


def traverse(scene: Scene, precision: str = "float32") -> SceneParameters:
    """The parameters of ``scene`` by the names that ``mi.traverse`` gives them.

    Values are Dr.Jit arrays of ``precision``: images linear tensors (height, width, channels), whatever the file holds;
    colours Array3f, or Float where they were written as one number; buffers of meshes flat Floats; transforms Matrix4f
    (``to_uv``: Matrix3f), for which anything with a ``matrix`` may be assigned, or a NumPy array.

    ``params["floor.bsdf.reflectance.data"] = image; params.update()`` changes the scene: what is rendered or asked of
    it from then on is that of the new value. ``dr.enable_grad(params[key])`` asks for derivatives. The scene's
    description stays what was loaded.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"traverse takes a Scene, as rt.load_file gives it, not {type(scene).__name__}")
    return SceneParameters(scene, precision, {p.key: p for p in parameters(scene.description)})


def _indices(value: Any) -> tuple[Any, ...]:
    return tuple(dr.detail.collect_indices(value))
