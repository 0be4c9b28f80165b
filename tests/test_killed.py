"""Processes that are killed: what they leave is whole, and a later run ends with the numbers of an undisturbed one."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import jaxvibro as jv

ROOT = Path(__file__).parents[1]
RUN = """
[scene]
amplitude = 4.65
frequency = 2.1
damping = 0.05
restitution = 0.7
left = {position = -1.0}
right = {position = 1.0}
[sweep]
parameter = "amplitude"
count = 201
settle = 100
keep = 20
legs = [{name = "up", from = 0.0, to = 7.0, start = {x = 0.0, v = 0.0}}]
"""
EXPLORE = """
import sys, jax
from pathlib import Path
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
scene, folder, budget = jv.make_scene(4.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), Path(sys.argv[1]), 0
while True:
    known = jv.load_diagram(folder) if (folder / "diagram.json").exists() else None
    if known is not None and (known.complete or len(known) > 1):
        break
    budget = 1 if known is None else len(known) + 1
    jv.explore(scene, "amplitude", (3.0, 4.5), 1, 0, budget, known).save(folder, force=True)
"""


def numbers_of_run(folder):
    """Return the data of a run; check that its files are whole."""
    for picture in folder.glob("[!.]*.png"):
        assert picture.read_bytes().endswith(b"IEND\xaeB`\x82")
    assert all(table.read_text().strip() for table in folder.glob("[!.]*.txt"))
    data = [jv.load_data(path) for path in folder.glob("[!.]*.nc")]
    return [{name: column.values.tobytes() for name, column in each.items() if column.dtype != object} for each in data]


def numbers_of_paper(folder):
    """Return the claims of the figures that are complete."""
    return {path.name: json.loads(path.read_text())["claims"] for path in folder.glob("[!.]*.json")}


def numbers_of_explore(folder):
    """Return the table and the points of a diagram; check that it is whole."""
    if not (folder / "diagram.json").exists():
        return None
    diagram = jv.load_diagram(folder)
    return [special.kind for branch in diagram.branches for special in branch.special], [
        np.round(branch.values[[0, -1]], 8).tolist() for branch in diagram.branches
    ]


def stop(command, seconds, how):
    """Begin a command and stop it by a signal after some seconds; then end the processes that it leaves."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT, "start_new_session": True}
    process = subprocess.Popen(command, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **quiet)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(how)
        process.wait()
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.parametrize("kills", [pytest.param(1, id="once"), pytest.param(10, id="often")])
@pytest.mark.parametrize("study", ["run", "paper", "explore"])
def test_a_killed_study_leaves_whole_files_and_ends_with_the_same_numbers(study, kills, tmp_path):
    (tmp_path / "study.toml").write_text(RUN)
    program = [sys.executable, "-m", "jaxvibro"]
    command, numbers = {
        "run": ([*program, "run", str(tmp_path / "study.toml"), "--force", "--out"], numbers_of_run),
        "paper": ([*program, "paper", "fig9", "formulas", "--out"], numbers_of_paper),
        "explore": ([sys.executable, "-c", EXPLORE], numbers_of_explore),
    }[study]
    alone, disturbed = tmp_path / "alone", tmp_path / "disturbed"
    for folder in (alone, disturbed):
        folder.mkdir()
    began = time.perf_counter()
    subprocess.run([*command, alone], check=True, capture_output=True, cwd=ROOT, env=os.environ)
    spent, draw = time.perf_counter() - began, np.random.default_rng(1)
    for _ in range(kills):
        how = signal.Signals(draw.choice([signal.SIGINT, signal.SIGKILL, signal.SIGTERM]))
        stop([*command, disturbed], draw.uniform(0.3, 0.95) * spent, how)
        numbers(disturbed)
    subprocess.run([*command, disturbed], check=True, capture_output=True, cwd=ROOT, env=os.environ)
    assert numbers(disturbed) == numbers(alone)
