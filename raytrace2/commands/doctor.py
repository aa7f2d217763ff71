"""``raytrace2 doctor``: what this machine has, and whether a ray can be traced with it."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command takes no arguments."""


def run(args: argparse.Namespace) -> int:
    """Print the report; 0 if a ray was traced and met its triangle where it should, 1 if something is in the way."""
    from ..doctor import examine

    report = examine()
    print(report)
    return 1 if report.problems else 0
