"""The command line: help, exit statuses, and the doctor on machines well and ill."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from raytrace2 import _llvm, cli, doctor
from raytrace2.errors import EnvironmentProblem, Location, Problem, SceneError

ROOT = Path(__file__).parent.parent


def command(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "raytrace2", *words],
        cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=180, check=False,
    )  # fmt: skip


def stand_in(monkeypatch: pytest.MonkeyPatch, run: object) -> None:
    """Let ``raytrace2 doctor`` run ``run`` instead."""
    module = SimpleNamespace(add_arguments=lambda parser: None, run=run)
    monkeypatch.setattr(cli.importlib, "import_module", lambda *names: module)


def test_every_command_is_a_module_and_every_module_a_command() -> None:
    files = {path.stem for path in (ROOT / "raytrace2" / "commands").glob("[a-z]*.py")}
    assert files == set(cli.COMMANDS)


def test_help_names_the_commands_and_imports_none_of_them() -> None:
    code = (
        "import sys; from raytrace2.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "sys.exit(any(m.startswith('raytrace2.commands') or m == 'mitsuba' for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in cli.COMMANDS)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main([name, "--help"])
    assert end.value.code == 0
    assert f"raytrace2 {name}" in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["nonsense"], ["doctor", "--nonsense"]])
def test_wrong_usage_is_status_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert end.value.code == 2
    assert "usage: raytrace2" in capsys.readouterr().err


def test_an_error_of_ours_is_its_text_and_status_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(args: argparse.Namespace) -> int:
        raise SceneError([Problem("unknown plugin", Location("a.xml", 3), "remove it"), Problem("no sensor")])

    stand_in(monkeypatch, run)
    assert cli.main(["doctor"]) == 2
    assert capsys.readouterr().err == "raytrace2: a.xml:3: unknown plugin (remove it)\nno sensor\n"


def test_the_commands_own_status_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, lambda args: 1)
    assert cli.main(["doctor"]) == 1


def test_interrupt_is_130_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(args: argparse.Namespace) -> int:
        raise KeyboardInterrupt

    stand_in(monkeypatch, run)
    assert cli.main(["doctor"]) == 130
    assert capsys.readouterr().err == "raytrace2: interrupted\n"


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end in another way")
def test_a_reader_that_has_gone_is_no_traceback() -> None:
    code = (
        "import sys; from raytrace2 import cli; from types import SimpleNamespace as S\n"
        "run = lambda args: print('x' * 1000000) or 0\n"
        "cli.importlib = S(import_module=lambda *n: S(add_arguments=lambda p: None, run=run))\n"
        "sys.exit(cli.main(['doctor']))"
    )
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


def test_a_command_that_traces_wants_llvm_first(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing() -> _llvm.Llvm:
        raise EnvironmentProblem("no libLLVM")

    monkeypatch.setattr(cli._llvm, "require", missing)
    monkeypatch.setattr(cli, "_WITHOUT_LLVM", frozenset())
    stand_in(monkeypatch, lambda args: 0)
    assert cli.main(["doctor"]) == 2
    assert capsys.readouterr().err == "raytrace2: no libLLVM\n"


# --- the doctor -----------------------------------------------------------------------------------------------------


def test_the_doctor_is_content_here() -> None:
    done = command("doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("python", "drjit", "mitsuba", "numpy", "OpenEXR", "LLVM from", "threads", "memory", "kernel cache"):
        assert re.search(rf"^{name} ", done.stdout, re.MULTILINE), done.stdout
    assert re.search(r"^trace +one ray met a triangle at t = 2 exactly", done.stdout, re.MULTILINE)


def test_the_doctor_runs_where_libllvm_is_missing() -> None:
    done = command("doctor", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert re.search(r"^PROBLEM: .*/nowhere/libLLVM.so", done.stdout, re.MULTILINE), done.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="Dr.Jit keeps kernels elsewhere")
@pytest.mark.parametrize("home", ["", "/dev/null"])
def test_the_doctor_says_that_kernels_are_not_kept(home: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", home)
    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    assert "compiles anew" in doctor._kernel_cache()


def test_the_doctor_counts_the_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "kernel.bin").write_bytes(bytes(2**20))
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    assert doctor._kernel_cache() == f"{tmp_path}: 1 files, 1.0 MiB"


def test_the_doctor_tells_of_a_death_by_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    dead = SimpleNamespace(returncode=-signal.SIGILL, stderr="")
    monkeypatch.setattr(doctor.subprocess, "run", lambda *args, **options: dead)
    assert doctor._trace_apart() == "the process died by SIGILL"


# --- the two commands of the README -----------------------------------------------------------------------------------


def test_ci_runs_the_readmes_own_test_command() -> None:
    readme = (ROOT / "README.md").read_text()
    [command] = [line.strip() for line in readme.splitlines() if line.strip().endswith("pytest -q")]
    assert command in (ROOT / ".ci" / "run").read_text().splitlines()


def test_a_png_says_which_channels_it_has_no_room_for(tmp_path: Path) -> None:
    out = tmp_path / "grazing.png"
    words = "--spp 1 --size 4x4 --integrator aov:depth,sh_normal".split()
    ran = command("render", "scenes/grazing_floor.xml", "-o", str(out), *words)
    assert ran.returncode == 0, ran.stderr
    assert out.read_bytes().startswith(b"\x89PNG")
    assert f"{out}: without sh_normal.Z" in ran.stderr
