"""What is around the package: the workflow, the hooks of a commit, and a wheel that runs outside of the checkout."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest
import yaml

import jaxvibro as jv

from . import conftest, shard

ROOT = Path(__file__).parents[1]


def jobs(workflow):
    """Return {job: (lines that it runs, actions that it uses, its matrix)} of a workflow."""
    table = yaml.safe_load((ROOT / ".github" / "workflows" / f"{workflow}.yml").read_text())["jobs"]
    return {
        name: (
            [step["run"].split(" SHARD=")[0] for step in job["steps"] if "run" in step],
            [step["uses"] for step in job["steps"] if "uses" in step],
            job.get("strategy", {}).get("matrix", {}),
        )
        for name, job in table.items()
    }


def test_the_workflows_run_each_tier_and_each_python_that_is_promised():
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    promised = [line.rpartition(" ")[2] for line in classifiers if re.search(r":: 3\.\d+$", line)]
    ci, nightly = jobs("ci"), jobs("nightly")
    assert ci["test"][2]["python"] == promised
    assert {name: runs for name, (runs, _, _) in (ci | nightly).items()} == {
        "test": ["make run", "make test"],
        "test-ci": ["make test-ci"],
        "docs": ["make docs"],
        "release": ["make release-tests"],
        "without-cache": ["make test", "make test-ci"],
    }
    cached = {name for name, (_, uses, _) in (ci | nightly).items() if "./.github/actions/compiled" in uses}
    assert cached == {"test", "test-ci", "release"}
    action = yaml.safe_load((ROOT / ".github" / "actions" / "compiled" / "action.yml").read_text())
    (cache,) = [step["with"] for step in action["runs"]["steps"] if "with" in step]
    assert cache["path"] == str(Path(conftest.CACHE["JAX_COMPILATION_CACHE_DIR"]).relative_to(ROOT))
    for pattern in re.findall(r"'([\w.*/-]+)'", cache["key"]):
        assert any(ROOT.glob(pattern)), pattern


def test_the_shards_of_a_workflow_are_all_test_files():
    matrices = [matrix["shard"] for _, _, matrix in (jobs("ci") | jobs("nightly")).values() if "shard" in matrix]
    assert len(matrices) == 3
    for parts in matrices:
        files = [file for part in parts for file in shard.files(part)]
        assert sorted(files) == sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("test_*.py"))
    with pytest.raises(ValueError, match="shard must be"):
        shard.files("4/3")


def test_the_hooks_are_the_lines_of_make_test():
    (own,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    makefile = (ROOT / "Makefile").read_text().replace("$(BIN)", ".venv/bin")
    recipe = re.search(r"^test: .*?\n\n", makefile, re.MULTILINE | re.DOTALL)[0].splitlines()
    *checks, last = [hook["entry"] for hook in own["hooks"]]
    assert own["repo"] == "local" and {hook["language"] for hook in own["hooks"]} == {"system"}
    assert last == "make test" and checks == [line.strip() for line in recipe if "ruff" in line or "mypy" in line]


def test_a_wheel_runs_outside_of_the_checkout(tmp_path):
    def called(*command):
        quiet = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        ended = subprocess.run(command, cwd=tmp_path, env=quiet, capture_output=True, text=True, timeout=300)
        assert ended.returncode == 0, ended.stdout + ended.stderr
        return ended.stdout

    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    own = tmp_path / "venv" / "bin"
    called(own / "python", "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", wheel)
    (packages,) = (tmp_path / "venv" / "lib").glob("python3*/site-packages")
    (packages / "locked.pth").write_text(sysconfig.get_paths()["purelib"])  # what it needs, but not this checkout

    where = called(
        own / "python", "-c", "import jaxvibro, continuation; print(jaxvibro.__file__, continuation.__file__)"
    )
    assert where.count(str(packages)) == 2
    assert called(own / "jaxvibro", "--version").strip() == jv.__version__
    called(own / "jaxvibro", "init", "my.toml")
    (tmp_path / "tiny.toml").write_text("[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.1\nrestitution = 0.7\n")
    done = json.loads(called(own / "jaxvibro", "run", "tiny.toml", "--json"))
    assert done["files"] and all((tmp_path / path).exists() for path in done["files"].values())
