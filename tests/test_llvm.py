"""Which libLLVM is taken, and that a bad one raises instead of killing the process (so each case has its own)."""

from __future__ import annotations

import os
import subprocess
import sys
from glob import glob
from pathlib import Path

import pytest

from raytrace2 import _llvm

ROOT = Path(__file__).parent.parent
VARIABLE = "DRJIT_LIBLLVM_PATH"
USE = "import raytrace2, drjit as dr, drjit.llvm.ad as ad; x = dr.minimum(ad.Float(1, 4), 2) + 1; print(x[1])"

has_wheel = pytest.mark.skipif(_llvm.wheel_library() is None, reason=f"{_llvm.WHEEL} is not installed")


def python(code: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    merged = {**os.environ, **environment}
    kept = {name: value for name, value in merged.items() if value is not None}
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=kept, capture_output=True, text=True, timeout=120, check=False
    )


def assert_refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1, done.stderr  # an exception, not a signal
    assert last.startswith("raytrace2.errors.EnvironmentProblem: ")
    assert all(word in last for word in words), last


def old_libraries() -> list[str]:
    """libLLVMs of this machine that are older than what works, one of each version."""
    found = {}
    for name in glob("/usr/lib/*-linux-gnu/libLLVM*.so*") + glob("/usr/lib/llvm-*/lib/libLLVM*.so*"):
        version = _llvm._stated_version(Path(name).resolve())
        if version and version[0] < _llvm.OLDEST:
            found[version[0]] = name
    return list(found.values())


@has_wheel
def test_the_wheel_is_taken_and_computes() -> None:
    done = python(USE + "; print(raytrace2._llvm.require())", **{VARIABLE: None})
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("3.0\n")
    assert "wheel" in done.stdout and str(_llvm.wheel_library()) in done.stdout


@has_wheel
def test_an_empty_variable_counts_as_none() -> None:
    assert python(USE, **{VARIABLE: ""}).stdout == "3.0\n"


@has_wheel
def test_the_wheels_file_is_no_link() -> None:
    library = _llvm.wheel_library()
    assert library is not None and library.is_file() and not library.is_symlink()


@has_wheel
def test_the_users_own_variable_is_respected() -> None:
    library = Path(str(_llvm.wheel_library()))
    own = f"{library.parent}/./{library.name}"
    done = python(USE + "; import os; print(os.environ['DRJIT_LIBLLVM_PATH'])", **{VARIABLE: own})
    assert done.stdout == f"3.0\n{own}\n", done.stderr


@has_wheel
def test_missing_links_of_the_wheel_are_made_good(tmp_path: Path) -> None:
    real = Path(str(_llvm.wheel_library()))
    (tmp_path / real.name).symlink_to(real)
    for folder in real.parent.glob("*-linux-gnu"):
        (tmp_path / folder.name).mkdir()
        for library in folder.glob("*.so.1.0"):
            (tmp_path / folder.name / library.name).symlink_to(library)
    code = (
        "from pathlib import Path; import ctypes; from raytrace2 import _llvm\n"
        f"_llvm._load_neighbours(Path({str(tmp_path / real.name)!r}))\n"
        "ctypes.CDLL('libc++.so.1')  # no search path leads to it: found by its soname, being loaded"
    )
    done = python(code, **{VARIABLE: None})
    assert done.returncode == 0, done.stderr


def test_a_path_that_is_not_a_file() -> None:
    assert_refused(python("import raytrace2", **{VARIABLE: "/nowhere/libLLVM.so"}), "/nowhere/libLLVM.so", "not a file")


def test_a_name_that_the_loader_does_not_know() -> None:
    assert_refused(python("import raytrace2", **{VARIABLE: "libLLVM-nowhere.so"}), "libLLVM-nowhere.so")


def test_a_library_that_is_not_llvm(tmp_path: Path) -> None:
    text = tmp_path / "libLLVM.so"
    text.write_text("no library")
    assert_refused(python("import raytrace2", **{VARIABLE: str(text)}), str(text))


@pytest.mark.parametrize(
    "library", old_libraries() or [pytest.param("", marks=pytest.mark.skip("no old libLLVM here"))]
)
def test_versions_that_abort(library: str) -> None:
    assert_refused(
        python("import raytrace2", **{VARIABLE: library}), library, f"LLVM {_llvm.OLDEST} or newer is needed"
    )


def test_a_version_that_aborts_under_another_name(tmp_path: Path) -> None:
    old = [name for name in old_libraries() if "15" in name or "16" in name]
    if not old:
        pytest.skip("no LLVM 15 or 16 on this machine")
    hidden = tmp_path / "compiler.so"
    os.link(Path(old[0]).resolve(), hidden) if os.stat(old[0]).st_dev == tmp_path.stat().st_dev else hidden.write_bytes(
        Path(old[0]).read_bytes()
    )
    assert_refused(python("import raytrace2", **{VARIABLE: str(hidden)}), "LLVM 1", "aborts")


def test_drjit_imported_before_with_nothing_that_works() -> None:
    done = python("import drjit; import raytrace2", **{VARIABLE: "/nowhere/libLLVM.so"})
    assert_refused(done, "no libLLVM that it can use")


@has_wheel
def test_drjit_imported_before_with_one_that_works() -> None:
    assert python("import drjit; " + USE, **{VARIABLE: str(_llvm.wheel_library())}).stdout == "3.0\n"


def test_drjit_imported_before_with_one_that_aborts() -> None:
    old = [name for name in old_libraries() if "15" in name or "16" in name]
    if not old:
        pytest.skip("no LLVM 15 or 16 on this machine")
    done = python(f"import os; os.environ[{VARIABLE!r}] = {old[0]!r}; import drjit; import raytrace2")
    assert_refused(done, "aborts the process")


def test_system_libraries_are_new_enough_and_newest_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.18.1", "libLLVM.so.20.1", "libLLVM.so.9", "libLLVM.so")
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.setattr(_llvm, "_SYSTEM_PATTERNS", {sys.platform: (f"{tmp_path}/libLLVM*.so*",)})
    taken = [path.name for path in _llvm.system_libraries()]
    assert taken == ["libLLVM.so.20.1", "libLLVM.so.18.1", "libLLVM-17.so.1"]


@pytest.mark.parametrize(
    ("system", "machine", "words"),
    [
        ("linux", "x86_64", "pip install karellen-llvm-core"),
        ("linux", "aarch64", "your distribution's libllvm"),
        ("darwin", "arm64", "brew install llvm"),
        ("win32", "AMD64", "LLVM-C.dll"),
    ],
)
def test_the_remedy_fits_the_machine(system: str, machine: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_llvm, "wheel_library", lambda: None)
    monkeypatch.setattr(_llvm.sys, "platform", system)
    monkeypatch.setattr(_llvm.platform, "machine", lambda: machine)
    for chosen in ("", "/some/libLLVM.so"):
        remedy = _llvm._remedy(chosen)
        assert words in remedy and "\n" not in remedy
