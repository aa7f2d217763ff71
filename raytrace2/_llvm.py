"""Which libLLVM Dr.Jit compiles with, settled before ``import drjit`` binds one for the life of the process.

In order of preference: the user's own ``DRJIT_LIBLLVM_PATH``; the library in the ``karellen-llvm-core`` wheel, which
``pip install raytrace2`` brings along on Linux x86_64; the newest usable one that the system has. Dr.Jit itself then
says what it bound. That costs no second loading of a library: two libLLVMs in one process clash.

LLVM 14 has no opaque pointers, and Dr.Jit refuses it; under LLVM 15 and 16 ``dr.minimum``, ``dr.maximum`` and
``dr.clip`` abort the process ("Cannot select: fminimum"); 17 to 23 work. With no library at all Dr.Jit dies by SIGFPE
as soon as an array is made, so what is wrong is raised here, as an exception.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from glob import glob
from pathlib import Path

from .errors import EnvironmentProblem

VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"
OLDEST = 17
NEWEST_TESTED = 23

_SYSTEM_PATTERNS = {
    "linux": (
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    ),
    "darwin": ("/opt/homebrew/Cellar/llvm*/*/lib/libLLVM.dylib", "/usr/local/Cellar/llvm*/*/lib/libLLVM.dylib"),
}


@dataclass(frozen=True)
class Llvm:
    """The libLLVM that Dr.Jit is bound to: its version, its file (None if unknown) and who chose it."""

    version: tuple[int, int, int]
    path: str | None
    source: str


def settle() -> None:
    """Choose a libLLVM and make sure that Dr.Jit can use it; to be called before anything else imports drjit.

    Raises :class:`~raytrace2.errors.EnvironmentProblem` if there is none or one too old. Inside the ``raytrace2``
    command that is left to :func:`require`, so that the command can say it in one line and ``doctor`` can still run.
    """
    if "drjit" not in sys.modules:
        choose()
    if not _inside_command():
        require()


def choose() -> None:
    """Set ``DRJIT_LIBLLVM_PATH`` unless the user has, to the wheel's library or else the system's newest usable one."""
    if os.environ.get(VARIABLE):
        return
    wheel = wheel_library()
    if wheel:
        _load_neighbours(wheel)
    path = wheel or next(system_libraries(), None)
    if path:
        os.environ[VARIABLE] = str(path)


def require() -> Llvm:
    """What Dr.Jit is bound to; :class:`~raytrace2.errors.EnvironmentProblem` if it is nothing, or one that aborts."""
    chosen = os.environ.get(VARIABLE, "")
    if "drjit" not in sys.modules and chosen:
        _check_file(chosen)
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        named = f" ({VARIABLE} is {chosen})" if chosen else ""
        raise EnvironmentProblem(f"Dr.Jit has found no libLLVM that it can use{named} ({_remedy(chosen)})")
    version = dr.detail.llvm_version()
    file = _loaded_file() or chosen or None
    if version[0] < OLDEST:
        raise _too_old(version, file or "the system's library", chosen)
    return Llvm(version, file, _source(file, chosen))


def wheel_library() -> Path | None:
    """The libLLVM that the karellen-llvm-core wheel brought: the file itself, not one of the links to it."""
    try:
        files = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        if re.fullmatch(r"libLLVM(\.so\.[\d.]+|-\d+\.so)", file.name):
            path = Path(str(file.locate())).resolve()
            if path.is_file():
                return path
    return None


def system_libraries() -> Iterator[Path]:
    """The system's libLLVM files that say by their name or folder that they are new enough, newest first."""
    found: dict[Path, tuple[int, ...]] = {}
    for pattern in _SYSTEM_PATTERNS.get(sys.platform, ()):
        for name in glob(pattern):
            path = Path(name).resolve()
            version = _stated_version(path)
            if version and path.is_file():
                found[path] = version
    usable = [path for path, version in found.items() if version[0] >= OLDEST]
    yield from sorted(usable, key=lambda path: (found[path], str(path)), reverse=True)


def _check_file(chosen: str) -> None:
    """Refuse what can be told from the file alone, so that Dr.Jit never has to start and stop with it."""
    path = Path(chosen).resolve()
    if os.sep in chosen and not path.is_file():
        raise EnvironmentProblem(f"{VARIABLE} names {chosen}, which is not a file ({_remedy(chosen)})")
    stated = _stated_version(path)
    if stated and stated[0] < OLDEST:
        raise _too_old(stated, chosen, chosen)


def _stated_version(path: Path) -> tuple[int, ...] | None:
    """The version in a library's file name or, for those of Homebrew, in the name of its folder."""
    stated = re.search(r"libLLVM(?:-|\.so\.)(\d+(?:\.\d+)*)", path.name) or re.search(r"/(\d+(?:\.\d+)+)/", str(path))
    return tuple(int(part) for part in stated[1].split(".")) if stated else None


def _too_old(version: tuple[int, ...], file: str, chosen: str) -> EnvironmentProblem:
    return EnvironmentProblem(
        f"LLVM {'.'.join(map(str, version))} ({file}) aborts the process on common operations; "
        f"LLVM {OLDEST} or newer is needed ({_remedy(chosen)})"
    )


def _load_neighbours(library: Path) -> None:
    """Load the C++ library that the wheel's libLLVM needs, where the wheel's links to it are missing.

    The wheel makes its links (libc++.so.1 and the like) when Python first starts after the install, which fails in a
    read-only environment. A library that is loaded already is found by its soname, with no need of a link.
    """
    for folder in library.parent.glob("*-linux-gnu"):
        if (folder / "libc++.so.1").exists():
            continue
        for name in ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0"):
            if (folder / name).exists():
                ctypes.CDLL(str(folder / name), mode=ctypes.RTLD_GLOBAL)


def _inside_command() -> bool:
    """Whether this process is ``raytrace2 ...`` or ``python -m raytrace2 ...``, whose main function reports errors."""
    if Path(sys.argv[0] if getattr(sys, "argv", None) else "").stem == "raytrace2":
        return True
    words = sys.orig_argv
    return any(pair == ("-m", "raytrace2") for pair in zip(words, words[1:], strict=False))


def _loaded_file() -> str | None:
    """The libLLVM file that this process has mapped, where the operating system tells (Linux)."""
    try:
        with open("/proc/self/maps") as maps:
            for line in maps:
                if "libLLVM" in line:
                    return line.split(maxsplit=5)[5].strip()
    except OSError:
        pass
    return None


def _source(file: str | None, chosen: str) -> str:
    if file and Path(file).resolve() == wheel_library():
        return f"the {WHEEL} wheel"
    return VARIABLE if chosen else "the system"


def _remedy(chosen: str) -> str:
    wheel = wheel_library()
    if wheel and not chosen:
        return "import raytrace2 before drjit or mitsuba"
    if wheel and chosen != str(wheel):
        return f"unset {VARIABLE}"
    if wheel:
        return f"pip install --force-reinstall --no-deps {WHEEL}, or import raytrace2 before drjit or mitsuba"
    point = f"point {VARIABLE} at libLLVM {OLDEST} or newer"
    if sys.platform == "darwin":
        return f"brew install llvm, or {point}"
    if sys.platform == "win32":
        return f"install LLVM from https://releases.llvm.org and point {VARIABLE} at its LLVM-C.dll"
    if platform.machine() == "x86_64":
        return f"pip install {WHEEL} and unset {VARIABLE}" if chosen else f"pip install {WHEEL}, or {point}"
    return f"install your distribution's libllvm package, version {OLDEST} or newer, or {point}"
