"""The notebooks run from top to bottom as plain Python."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
MARKED = [
    pytest.param(path, id=path.name, marks=pytest.mark.slow if path.name.startswith("00") else pytest.mark.long)
    for path in NOTEBOOKS
]


@pytest.mark.parametrize("path", MARKED)
def test_a_notebook_runs_and_draws(path, tmp_path):
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900
    )
    assert ended.returncode == 0, ended.stderr
    assert list((tmp_path / "out").glob(f"{path.name[:2]}_*.png"))


def test_there_are_notebooks():
    assert NOTEBOOKS
