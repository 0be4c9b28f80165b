"""Measure where methods fail, this package and others: one file for each part of docs/reliability.md."""
