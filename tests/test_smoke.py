"""The verification scripts run: a small case of a third of them in each run."""

import subprocess
import sys
from pathlib import Path

import pytest

from . import smoke

NAMES = sorted(smoke.SCRIPTS)


def test_every_verification_script_has_a_small_case():
    assert {path.stem for path in Path(__file__).parent.glob("*_proof.py")} == {f"{name}_proof" for name in NAMES}


@pytest.mark.parametrize("name", NAMES[smoke.part() :: smoke.PARTS])
def test_a_small_case_of_a_verification_script_runs(name, tmp_path):
    arguments = smoke.SCRIPTS[name]
    if arguments is not None:
        arguments = [str(tmp_path) if argument == "FOLDER" else argument for argument in arguments]
    assert smoke.script_error(name, arguments) == ""


def test_a_script_that_fails_is_reported():
    assert "no_such_kind" in smoke.script_error("soft_studies", ["no_such_kind"])


STOPPED = """
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import smoke

smoke.TEST_SECONDS = 0.2
times, waits = iter([60.0, 0.0]), iter([60.0])


@pytest.fixture(scope="module")
def value():
    time.sleep(next(times))
    return 3


@pytest.mark.smoke
def test_with_a_stopped_fixture(value):
    raise AssertionError("called without its fixture")


def test_next(value):
    assert value == 3


@pytest.mark.smoke
@given(number=st.integers())
def test_of_draws(number):
    time.sleep(next(waits, 0.0))


@pytest.mark.smoke
def test_wrong():
    assert False
"""


def test_a_stopped_test_has_passed_and_its_fixtures_run_again_for_the_next_test(tmp_path):
    """Tests are stopped in a fixture of the module, whose value the next one needs, and in a draw of hypothesis."""
    (tmp_path / "test_stopped.py").write_text(STOPPED)
    options = ["-p", "tests.conftest", "-p", "no:cacheprovider", "-c", "/dev/null", "-m", "smoke or not smoke"]
    command = [sys.executable, "-m", "pytest", *options, str(tmp_path)]
    output = subprocess.run(command, cwd=smoke.ROOT, capture_output=True, text=True, check=False).stdout
    assert "3 passed" in output and "1 failed" in output, output
