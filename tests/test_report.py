"""`jaxvibro report`: what a report of a fault needs, for people and for machines."""

import json
import os
import platform
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import jax

import jaxvibro as jv
from jaxvibro.compiled import kernel_calls, lane_arithmetic
from jaxvibro.compiled.hints_in_use import describe_hints
from jaxvibro.studies import command, environment
from jaxvibro.studies.environment import describe_environment, format_environment
from tests.test_cache_files import cache as cache  # a fixture


def test_what_is_described(cache):
    found = describe_environment()
    assert found["versions"]["jaxvibro"] == jv.__version__
    assert found["versions"]["python"].startswith(platform.python_version())
    assert all(found["versions"][name] == version(name) for name in ("jax", "jaxlib", "numpy", "scipy"))
    assert found["jax"]["platform"] == "cpu" and len(found["jax"]["devices"]) == jax.device_count()
    assert found["jax"]["x64"] is True
    with jax.enable_x64(False):
        assert describe_environment()["jax"]["x64"] is False
    assert found["processor"]["logical_cores"] == os.cpu_count()
    assert found["hints"]["options"] == lane_arithmetic.COMPILER_OPTIONS
    assert found["hints"]["block_width"] == kernel_calls.block_width()
    kept = {"writable": True, "used_by_jax": True, "used_for_traced_functions": True, "reason_if_not": None}
    assert found["cache"] == {"folder": str(cache), **kept}
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_a_cache_that_is_not_used_says_why(cache):
    cache.chmod(0o777)
    found = describe_environment()["cache"]
    assert not found["used_for_traced_functions"] and "can be written to by everyone" in found["reason_if_not"]
    cache.chmod(0o700)
    jax.config.update("jax_compilation_cache_dir", None)
    found = describe_environment()["cache"]
    assert found["folder"] is None and not found["used_by_jax"] and "no cache folder is set" in found["reason_if_not"]
    jax.config.update("jax_compilation_cache_dir", str(cache / "file" / "below"))
    (cache / "file").write_text("")
    assert describe_environment()["cache"]["writable"] is False


def test_hints_are_none_for_other_devices(monkeypatch):
    marks = describe_hints()["marks"]
    assert marks["stage"]["inlineable"] == "false" and marks["one_kernel"]["xla_cpu_small_call"] == "true"
    monkeypatch.setattr(kernel_calls, "is_traced_for_cpu", lambda: False)
    found = describe_hints()
    assert (found["applied"], found["marks"], found["block_width"]) == (False, {}, kernel_calls.GPU_BLOCK_WIDTHS[0])


def test_a_processor_without_a_description(monkeypatch):
    monkeypatch.setattr(environment, "_read_cpuinfo", lambda: ({}, None))
    found = environment._processor_info()
    assert found["model"] and found["instruction_sets"] == [] and found["cores"] is None


def test_the_marks_that_are_described_are_those_of_compiled_code():
    """Of a stage within one kernel, in the lowered text."""

    def twice(x):
        return lane_arithmetic.call_without_inlining(lambda x: 2.0 * x, x)

    text = jax.jit(lambda x: kernel_calls.call_as_kernel(twice, x)).lower(jax.numpy.ones(3)).as_text()
    found = {name: value for marks in describe_hints()["marks"].values() for name, value in marks.items()}
    assert dict(re.findall(r'(inlineable|xla_cpu_small_call) = "(\w+)"', text)) == found


def test_the_command_prints_both_forms(capsys):
    assert command.main(["report"]) == 0
    text = capsys.readouterr().out
    assert re.search(rf"^  jaxvibro +{re.escape(jv.__version__)}$", text, re.MULTILINE)
    assert re.search(r"^  block_width +\d+$", text, re.MULTILINE) and "None" not in text
    assert command.main(["report", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["versions", "system", "processor", "jax", "hints", "cache"]
    assert text == format_environment(found) + "\n"


def test_a_process_of_its_own_uses_the_commands_settings(tmp_path):
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    words = [sys.executable, "-m", "jaxvibro", "report", "--json"]
    given = plain | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(words, cwd=Path(__file__).parents[1], env=given, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["jax"]["x64"] is True and found["cache"]["folder"].startswith(str(tmp_path / "jaxvibro"))
    assert found["cache"]["used_for_traced_functions"] is True
