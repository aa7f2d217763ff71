"""``python -m raytrace2`` is the ``raytrace2`` command."""

from __future__ import annotations

import sys

from .cli import main

sys.exit(main())
