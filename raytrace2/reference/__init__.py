"""Mitsuba's renders beside ours: cached references, metrics, the noise test and the report."""
