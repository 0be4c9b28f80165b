"""Lines of the packages that tests run, for `coverage report`.

The lines are recorded in the bytecode of the packages alone. coverage follows all Python of a process up to 3.11, jax
included, and tests take 1.7 times as long; it records processes that tests start.
"""

import os
from functools import cache
from pathlib import Path

from coverage import CoverageData
from slipcover import Slipcover
from slipcover.importer import SlipcoverLoader

ROOT = Path(__file__).parents[1]
DATA = ROOT / ".coverage"


@cache
def recorder():
    """Return the recorder of this process; coverage records the processes that it starts from now on."""
    os.environ |= {"COVERAGE_PROCESS_START": str(ROOT / "pyproject.toml"), "COVERAGE_FILE": str(DATA)}
    return Slipcover()


def record(spec):
    """Have the lines of a module recorded when it is imported."""
    spec.loader = SlipcoverLoader(recorder(), spec.loader, spec.origin)


def write(packages):
    """Write the recorded lines beside those of other processes, and the names of files of which no line has run."""
    data = CoverageData(DATA, suffix=True)
    recorded = {file: rows["executed_lines"] for file, rows in recorder().get_coverage()["files"].items()}
    data.add_lines({str(ROOT / file): numbers for file, numbers in recorded.items()})
    data.touch_files(str(file) for package in packages for file in (ROOT / package).rglob("*.py"))
    data.write()
