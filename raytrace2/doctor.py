"""What this machine has for tracing rays: versions, libLLVM, processor, memory, kernel cache, and a traced ray."""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import platform
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from . import _llvm
from .errors import EnvironmentProblem

_PACKAGES = ("raytrace2", "drjit", "mitsuba", "numpy", "OpenEXR")
_TRACE_SECONDS = 120


@dataclass(frozen=True)
class Report:
    """``lines``: (name, value) pairs in order; ``problems``: what stands in the way, empty if nothing does."""

    lines: tuple[tuple[str, str], ...]
    problems: tuple[str, ...]

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.lines)
        rows = [f"{name:<{width}}  {value}" for name, value in self.lines]
        return "\n".join(rows + [f"PROBLEM: {problem}" for problem in self.problems])


def examine() -> Report:
    """Look at everything; never raises for what it finds."""
    lines = [("python", f"{platform.python_version()} ({sys.executable}), {platform.platform()}")]
    problems: list[str] = []
    for name in _PACKAGES:
        try:
            lines.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            lines.append((name, "not installed"))
            if name != "raytrace2":  # it runs from its source folder too
                problems.append(f"{name} is not installed (pip install {name})")
    try:
        llvm = _llvm.require()
    except EnvironmentProblem as problem:
        lines.append(("LLVM", "none that is usable"))
        problems.append(str(problem))
    else:
        number = ".".join(map(str, llvm.version))
        newer = f" (newer than the tested {_llvm.OLDEST} to {_llvm.NEWEST_TESTED})"
        lines.append(("LLVM", number + (newer if llvm.version[0] > _llvm.NEWEST_TESTED else "")))
        lines.append(("LLVM from", f"{llvm.source}: {llvm.path}"))
    lines += _processor()
    lines.append(("memory", _memory()))
    lines.append(("kernel cache", _kernel_cache()))
    if not problems:
        failure = _trace_apart()
        lines.append(("trace", failure or "one ray met a triangle at t = 2 exactly, another passed it by"))
        problems += [f"the test ray was not traced: {failure}"] if failure else []
    return Report(tuple(lines), tuple(problems))


def trace() -> None:
    """Trace two rays at one triangle, through a BVH: ``AssertionError`` if they do not end just where they should."""
    import raytrace2 as rt

    mesh = rt.TriangleMesh([[0.0, 0.0, 2.0], [4.0, 0.0, 2.0], [0.0, 4.0, 2.0]], [[0, 1, 2]])
    accel = rt.accel.build(mesh, "bvh")
    hit = accel.intersect(rt.Ray([[1.0, 1.0, 0.0], [3.0, 3.0, 0.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]))
    t, prim = list(hit.t), int(hit.prim[0])
    if t != [2.0, float("inf")] or prim != 0:
        raise AssertionError(f"t is {t} where [2.0, inf] is right, and the triangle is {prim} where 0 is right")


def _trace_apart() -> str | None:
    """Why :func:`trace` fails, or None; it runs in a process of its own so that a signal is told and not suffered."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", "from raytrace2.doctor import trace; trace()"],
            capture_output=True, text=True, timeout=_TRACE_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"not done after {_TRACE_SECONDS} seconds"
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"the process died by {signal.Signals(-done.returncode).name}"
    return (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]


def _processor() -> list[tuple[str, str]]:
    import drjit as dr

    known = _dr_jit_target()
    features = [name for name in ("avx512f", "avx2", "fma", "avx", "sse4.2", "neon") if f"+{name}" in known.features]
    lines = [("processor", ", ".join([known.cpu or platform.machine(), *features]))]
    if known.width > 0:
        lines.append(("vector width", f"{known.width} float32 lanes"))
    lines.append(("threads", f"{dr.thread_count()} of {os.cpu_count()} processors"))
    return lines


@dataclass(frozen=True)
class _Target:
    cpu: str = ""
    features: tuple[str, ...] = ()
    width: int = 0


def _dr_jit_target() -> _Target:
    """What Dr.Jit compiles for. Its Python interface does not tell; its C++ library, which is loaded, does."""
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        return _Target()
    try:
        library = ctypes.CDLL(str(next(Path(dr.__file__).parent.glob("*drjit-core.*"))))
        cpu, features, width = (
            getattr(library, name)
            for name in ("_Z19jit_llvm_target_cpuv", "_Z24jit_llvm_target_featuresv", "_Z21jit_llvm_vector_widthv")
        )
    except (OSError, StopIteration, AttributeError):  # another compiler spells these names in another way
        return _Target()
    cpu.restype = features.restype = ctypes.c_char_p
    width.restype = ctypes.c_uint
    return _Target((cpu() or b"").decode(), tuple((features() or b"").decode().split(",")), width())


def _memory() -> str:
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        total, free = page * os.sysconf("SC_PHYS_PAGES"), page * os.sysconf("SC_AVPHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return "unknown"
    return f"{_bytes(total)}, {_bytes(free)} of it free"


def _kernel_cache() -> str:
    """Where Dr.Jit keeps compiled kernels (DRJIT_CACHE_DIR, or .drjit in the home folder), how much, and if it can."""
    chosen = os.environ.get("DRJIT_CACHE_DIR")
    home = os.environ.get("HOME")
    if not chosen and sys.platform == "win32":
        chosen = str(Path(tempfile.gettempdir()) / "drjit")
    if not chosen and not home:
        return "none, so every start compiles anew: HOME is not set (set it or DRJIT_CACHE_DIR)"
    folder = Path(chosen) if chosen else Path(str(home)) / ".drjit"
    if not folder.is_dir():
        return f"none, so every start compiles anew: {folder} cannot be made (set DRJIT_CACHE_DIR)"
    try:
        sizes = [entry.stat().st_size for entry in os.scandir(folder) if entry.is_file()]
        with tempfile.TemporaryFile(dir=folder):
            writable = True
    except OSError:
        sizes, writable = [], False
    return (
        f"{folder}: {len(sizes)} files, {_bytes(sum(sizes))}"
        if writable
        else f"{folder} cannot be written to (set DRJIT_CACHE_DIR)"
    )


def _bytes(n: int) -> str:
    return f"{n / 2**30:.1f} GiB" if n >= 2**30 else f"{n / 2**20:.1f} MiB"
