"""Puts measured tables into the README: what stands between its lines "begin NAME" and "end NAME" becomes
out/NAME.md, and "NAME: TITLE" the section of that title.

    python experiments/readme.py [out]

Each table has the command that makes it beside it in the README.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from raytrace2.files import write_atomically

README = Path(__file__).parent.parent / "README.md"


def body(table: Path, section: str) -> str:
    """The table and what is said about it, without titles; of the section whose title begins so, if one is named."""
    text = table.read_text()
    if section:
        found = re.search(rf"^## {re.escape(section)}.*?$(.*?)(?=^## |\Z)", text, flags=re.DOTALL | re.MULTILINE)
        if found is None:
            raise SystemExit(f"{table}: no section begins with {section!r}")
        text = found[1]
    return "\n".join(line for line in text.splitlines() if not line.startswith("#")).strip()


def main() -> int:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
    text = README.read_text()
    missing = []
    for name in re.findall(r"<!-- begin (.+?) -->", text):
        file, _, section = name.partition(": ")
        table = folder / f"{file}.md"
        if not table.is_file():
            missing.append(name)
            continue
        pattern = rf"(<!-- begin {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)"
        text = re.sub(pattern, lambda m, t=table, s=section: m[1] + body(t, s) + "\n" + m[2], text, flags=re.DOTALL)
    write_atomically(README, text.encode())
    print(f"{README}: rewritten" + (f"; no table for {', '.join(missing)}" if missing else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
