"""`jaxvibro report`: the facts that the report of a bug needs, for people and for machines."""

import json
import os
import platform
import re
import subprocess
import sys
from importlib.metadata import version

import jax
import pytest

import jaxvibro as jv
from jaxvibro.compiled.kernel_calls import block_width, call_as_kernel
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS, call_without_inlining
from jaxvibro.studies.command import main

from .sources import ROOT


@pytest.fixture
def cache(tmp_path):
    """A folder for compiled programs of its own."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def report(capsys):
    """The function that returns the facts of the command."""

    def facts():
        assert main(["report", "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return facts


def test_the_facts_of_the_environment(cache, report):
    facts = report()
    assert facts["versions"]["jaxvibro"] == jv.__version__
    assert facts["versions"]["python"].startswith(platform.python_version())
    assert all(facts["versions"][name] == version(name) for name in ("jax", "jaxlib", "numpy", "scipy"))
    assert facts["jax"]["platform"] == "cpu" and len(facts["jax"]["devices"]) == jax.device_count()
    assert facts["jax"]["x64"] is True
    with jax.enable_x64(False):
        assert report()["jax"]["x64"] is False
    assert facts["processor"]["logical_cores"] == os.cpu_count()
    assert facts["hints"]["options"] == COMPILER_OPTIONS and facts["hints"]["block_width"] == block_width()
    used = {"writable": True, "used_by_jax": True, "used_for_traced_functions": True, "reason_if_not": None}
    assert facts["cache"] == {"folder": str(cache), **used}


def test_the_reason_why_a_cache_is_not_used(cache, report):
    cache.chmod(0o777)
    facts = report()["cache"]
    assert not facts["used_for_traced_functions"] and "can be written to by everyone" in facts["reason_if_not"]
    cache.chmod(0o700)
    jax.config.update("jax_compilation_cache_dir", None)
    facts = report()["cache"]
    assert facts["folder"] is None and not facts["used_by_jax"] and "no cache folder is set" in facts["reason_if_not"]
    jax.config.update("jax_compilation_cache_dir", str(cache / "file" / "below"))
    (cache / "file").write_text("")
    assert report()["cache"]["writable"] is False


def test_the_hints_are_the_marks_of_compiled_code_and_none_on_other_devices(report, monkeypatch):
    def double(x):
        return call_without_inlining(lambda x: 2.0 * x, x)

    text = jax.jit(lambda x: call_as_kernel(double, x)).lower(jax.numpy.ones(3)).as_text()
    hints = report()["hints"]
    expected = {name: value for group in hints["marks"].values() for name, value in group.items()}
    assert dict(re.findall(r'(inlineable|xla_cpu_small_call) = "(\w+)"', text)) == expected
    assert hints["marks"]["stage"]["inlineable"] == hints["marks"]["one_kernel"]["inlineable"] == "false"
    monkeypatch.setattr("jaxvibro.compiled.kernel_calls.is_traced_for_cpu", lambda: False)
    others = report()["hints"]
    assert (others["applied"], others["marks"]) == (False, {}) and others["block_width"] > 1000 * hints["block_width"]


def test_a_processor_without_a_description(report, monkeypatch):
    monkeypatch.setattr("jaxvibro.studies.environment._read_cpuinfo", lambda: ({}, None))
    facts = report()["processor"]
    assert facts["model"] and facts["instruction_sets"] == [] and facts["cores"] is None


def test_the_command_prints_both_forms(report, capsys):
    facts = report()
    assert main(["report"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^  block_width +\d+$", text, re.MULTILINE) and "None" not in text
    assert list(facts) == ["versions", "system", "processor", "jax", "hints", "cache", "evaluation"]
    groups = re.split(r"^(\w+):", text, flags=re.MULTILINE)[1:]
    rows = [dict(re.findall(r"^  (\S+) +(.+)$", body, re.MULTILINE)) for body in groups[1::2]]
    keys = [list(group) if isinstance(group, dict) else [] for group in facts.values()]
    assert groups[::2] == list(facts) and [list(row) for row in rows] == keys
    assert rows[0] == facts["versions"]


def test_a_process_of_its_own_uses_the_settings_of_the_command(tmp_path):
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, "-m", "jaxvibro", "report", "--json"]
    given = plain | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(command, cwd=ROOT, env=given, capture_output=True, text=True, check=True)
    facts = json.loads(done.stdout)
    assert facts["jax"]["x64"] is True and facts["cache"]["folder"].startswith(str(tmp_path / "jaxvibro"))
    assert facts["cache"]["used_for_traced_functions"] is True
