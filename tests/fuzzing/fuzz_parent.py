# ruff: noqa: E501 -- a case a line
"""Runs cases in child processes, so that one that kills its process or never ends is a result and not the end."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

CHILD = Path(__file__).with_name("fuzz_child.py")


def run_all(
    cases: Iterable[Sequence[Any]], folder: Path, *, module: str = "fuzz_cases", batch: int = 300, seconds: float = 60.0,
    tell: Callable[[Sequence[Any], str, str], None] | None = None,
) -> list[tuple[Sequence[Any], str, str]]:  # fmt: skip
    """(case, class, message) for each case, run by ``module.run``, ``batch`` cases to a process and at most ``seconds``
    a case. ``tell`` is called after each."""
    pending = list(cases)
    results: list[tuple[Sequence[Any], str, str]] = []
    folder.mkdir(parents=True, exist_ok=True)
    while pending:
        done = _run_child(pending[:batch], folder, module, seconds, tell)
        results += done
        pending = pending[len(done) :]
    return results


def _run_child(
    cases: list[Sequence[Any]], folder: Path, module: str, seconds: float, tell: Callable[[Sequence[Any], str, str], None] | None
) -> list[tuple[Sequence[Any], str, str]]:  # fmt: skip
    with open(folder / "child.log", "wb") as log:
        child = subprocess.Popen(
            [sys.executable, str(CHILD), module, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
        )  # fmt: skip
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        assert child.stdout is not None
        for line in child.stdout:
            lines.put(line)
        lines.put("")

    def write() -> None:
        assert child.stdin is not None
        try:
            for case in cases:
                child.stdin.write(json.dumps(case) + "\n")
            child.stdin.close()
        except BrokenPipeError:
            pass

    for target in (read, write):
        threading.Thread(target=target, daemon=True).start()
    results: list[tuple[Sequence[Any], str, str]] = []

    def note(outcome: str, message: str) -> None:
        results.append((cases[len(results)], outcome, message))
        if tell:
            tell(*results[-1])

    try:
        while len(results) < len(cases):
            # The first answer waits for the imports.
            begun = lines.get(timeout=seconds + 60.0)
            line = lines.get(timeout=seconds) if begun else ""
            if not line:
                code = child.wait()
                tail = (folder / "child.log").read_bytes()[-300:].decode(errors="replace")
                name = signal.Signals(-code).name if code < 0 else f"exit status {code}"
                note("signal", f"{name}: {' '.join(tail.split())}")
                break
            note(*json.loads(line))
    except queue.Empty:
        note("hang", f"no answer within {seconds:g} s")
    finally:
        child.kill()
        child.wait()
    return results
