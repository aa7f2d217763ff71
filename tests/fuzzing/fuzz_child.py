"""Runs cases one after the other and says before each that it begins: a parent sees which one was the last.

    python fuzz_child.py MODULE FOLDER < (one case a line, as JSON)

Answers on standard output, a line each: "begin", then the JSON of what MODULE.run(*case, folder) returned.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import sys
from pathlib import Path

import raytrace2  # noqa: F401  settles libLLVM before anything imports drjit

HERE = Path(__file__).parent
MEMORY = 8 << 30


def main() -> None:
    module, folder = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.path.insert(0, str(HERE))
    # What libraries print must not mix with the answers.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    run = importlib.import_module(module).run
    # Sizes that a file only claims end here, not in the machine's memory.
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.chdir(folder)
    for line in sys.stdin:
        answers.write("begin\n")
        result = run(*json.loads(line), Path(folder))
        with contextlib.suppress(BrokenPipeError):
            answers.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
