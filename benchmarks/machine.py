"""Describe the machine of the measurements."""

import datetime
import os
import pathlib
import platform
from importlib import metadata

PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "diffrax", "heyoka", "python-flint")
WIDTHS = {"avx512f": "AVX-512", "avx2": "AVX2", "avx": "AVX", "sse2": "SSE2"}


def processor():
    """Return the processor's model, family and widest vectors, and the number of cores of the machine."""
    info = pathlib.Path("/proc/cpuinfo")
    text = info.read_text() if info.exists() else ""
    facts = dict(reversed([tuple(map(str.strip, line.split(":", 1))) for line in text.splitlines() if ":" in line]))
    name = facts.get("model name", platform.processor() or platform.machine())
    family = f"family {facts['cpu family']} model {facts['model']}, " if "cpu family" in facts else ""
    width = next(
        (words for flag, words in WIDTHS.items() if flag in facts.get("flags", "").split()), "no known vectors"
    )
    return f"{name} ({family}{width}, {os.cpu_count()} cores)"


def describe():
    """Return lines of text: machine, versions, date."""
    versions = ", ".join(f"{package} {metadata.version(package)}" for package in PACKAGES)
    return (
        f"Machine: {processor()}, {platform.system()}; load average at the end {os.getloadavg()[0]:.1f}.",
        f"Versions: Python {platform.python_version()}, {versions}.",
        f"Date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC.",
    )
