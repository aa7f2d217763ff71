"""A differentiable, just-in-time-compiled ray tracer for the study of rendering."""

from __future__ import annotations

from ._llvm import settle as _settle_libllvm

_settle_libllvm()  # before anything imports drjit, which binds a libLLVM for good
