"""Puts measured tables into the README: what stands between its lines "begin NAME" and "end NAME" becomes out/NAME.md.

    python experiments/readme.py [out]

Each table has the command that makes it beside it in the README.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from raytrace2.files import write_atomically

README = Path(__file__).parent.parent / "README.md"


def main() -> int:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
    text = README.read_text()
    missing = []
    for name in re.findall(r"<!-- begin (\S+) -->", text):
        table = folder / f"{name}.md"
        if not table.is_file():
            missing.append(name)
            continue
        pattern = rf"(<!-- begin {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)"
        text = re.sub(pattern, lambda m, t=table: m[1] + t.read_text().strip() + "\n" + m[2], text, flags=re.DOTALL)
    write_atomically(README, text.encode())
    print(f"{README}: rewritten" + (f"; no table for {', '.join(missing)}" if missing else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
