"""The verification scripts run: a small case of a third of them in each run."""

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
