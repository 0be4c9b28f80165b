"""The verification scripts run: a small case of a third of them in each run."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from . import conftest, smoke

NAMES = sorted(smoke.SCRIPTS)


def test_every_verification_script_has_a_small_case():
    assert {path.stem for path in Path(__file__).parent.glob("*_proof.py")} == {f"{name}_proof" for name in NAMES}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES[smoke.part() :: smoke.PARTS])
def test_a_small_case_of_a_verification_script_runs(name, tmp_path):
    arguments = smoke.SCRIPTS[name]
    if arguments is not None:
        arguments = [str(tmp_path) if argument == "FOLDER" else argument for argument in arguments]
    assert smoke.script_error(name, arguments) == ""


def test_a_script_that_fails_is_reported():
    assert "no_such_kind" in smoke.script_error("soft_studies", ["no_such_kind"])


def test_a_test_that_is_stopped_has_passed():
    def run():
        raise smoke.OutOfTime

    item, call = SimpleNamespace(stash={}), pytest.CallInfo.from_call(run, "call")
    report = conftest.pytest_runtest_makereport(item, call)
    next(report)
    assert call.excinfo is None and item.stash[smoke.STOPPED]


STOPPED_FIXTURE = """
import time

import pytest

from tests import smoke

smoke.TEST_SECONDS = 0.2
times = iter([60.0, 0.0])


@pytest.fixture(scope="module")
def value():
    time.sleep(next(times))
    return 3


@pytest.mark.smoke
def test_stopped(value):
    raise AssertionError("called without its fixture")


def test_next(value):
    assert value == 3
"""


def test_a_stopped_fixture_runs_again_for_the_next_test(tmp_path):
    """The first test is stopped in a fixture of the module; the second one needs its value."""
    (tmp_path / "test_two.py").write_text(STOPPED_FIXTURE)
    options = ["-p", "tests.conftest", "-p", "no:cacheprovider", "-c", "/dev/null", "-m", "smoke or not smoke"]
    command = [sys.executable, "-m", "pytest", *options, str(tmp_path)]
    output = subprocess.run(command, cwd=smoke.ROOT, capture_output=True, text=True, check=False).stdout
    assert "2 passed" in output, output
