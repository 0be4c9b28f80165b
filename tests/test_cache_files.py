"""Modules and programs kept in JAX's cache folder: what is read has the same numbers, and is not traced again; files
that are damaged, of another origin or open to other users are never used."""

import errno
import marshal
import os
import random
import stat
import subprocess
import sys
import warnings
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from continuation.hostcall import persistent_jit, reason_without_cache
from continuation.hostcall.module_store import distrust_from_status, read, reason_for_distrust, write
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.maps.strobe import _two_tier_strobe

from .cached_functions import DIGEST, FOLDER, compiled, evaluated, flipped, own_files, require_right, separate_cache

CACHE_FILE, STORE = "continuation.hostcall.module_store", "continuation.hostcall.module_store"
TREES = "continuation.hostcall.tree_description"
ROOT = Path(__file__).parents[1]
GENERATIONS = 3  # versions of the sources whose modules are kept


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """JAX's compile cache in a folder of its own; repeated warnings are repeated here."""
    monkeypatch.setattr(f"{TREES}.own_packages", {"continuation", "jaxvibro"})
    monkeypatch.setattr(f"{CACHE_FILE}._warned", set())
    with separate_cache(tmp_path / "cache") as folder:
        yield folder


@pytest.fixture
def traces(monkeypatch):
    """How often a function is traced because nothing is kept of it, a list."""
    found = []
    traced = "continuation.hostcall.host_jit.HostFunction._trace_program"
    for kind, name in (("program", traced), ("module", f"{STORE}._export_module")):
        plain = resolve_name(name)
        monkeypatch.setattr(name, lambda *given, kind=kind, plain=plain: found.append(kind) or plain(*given))
    return found


def status_of(mode, owner, group=0):
    """The status of a file or folder."""
    return os.stat_result((mode, 0, 0, 0, owner, group, 0, 0, 0, 0))


def test_a_line_that_is_inserted_is_not_executed(cache, tmp_path):
    first, mark = evaluated(), tmp_path / "ran"
    path = own_files(cache)[".code"]
    content = path.read_bytes()
    line = f"open({str(mark)!r}, 'w').close()\n"
    code = marshal.dumps(compile(f"{line}size, run = 1, None", "<program>", "exec"))
    form = content[DIGEST:].split(b"\n")[0]
    for digest in (content[:DIGEST], b"\0" * DIGEST):
        path.write_bytes(digest + form + b"\n" + code)
        for one, again in zip(first, evaluated(), strict=True):
            np.testing.assert_array_equal(one, again)
    assert not mark.exists()


def test_a_folder_of_somebody_else_is_not_used(cache, traces, monkeypatch):
    evaluated()
    files = {one: one.read_bytes() for one in cache.rglob("*") if one.is_file()}
    theirs = os.geteuid() + 7

    def of_another(status):
        return distrust_from_status(status_of(status.st_mode, theirs, status.st_gid))

    monkeypatch.setattr(f"{CACHE_FILE}.distrust_from_status", of_another)
    rule = rf"neither kept in this cache folder nor read.*belongs to another user, number {theirs}"
    with pytest.warns(UserWarning, match=rule) as told:
        require_right(evaluated())
        require_right(evaluated())
    assert len(told) == 1 and str(cache) in str(told[0].message)
    assert traces == ["program"] * 3
    assert f"belongs to another user, number {theirs}" in reason_without_cache()
    assert {one: one.read_bytes() for one in cache.rglob("*") if one.is_file()} == files
    assert read(own_files(cache)[".code"]) is None
    with pytest.raises(jv.ArgumentError, match="jax_compilation_cache_dir: must be a folder that no other user"):
        jv.warm()


# Of the cache folder: (mode, why it is not used, None where it is).
MODES = [(0o700, None), (0o755, None)]
MODES += [(mode, "can be written to by everyone") for mode in (0o777, 0o1777, 0o702)]
MODES += [(mode, "can be written to by a group") for mode in (0o770, 0o2775)]


@pytest.mark.parametrize(("mode", "reason"), MODES)
@pytest.mark.parametrize("below", [0, 1, 2])
def test_a_folder_that_others_can_write_to_is_not_used(cache, traces, monkeypatch, mode, reason, below):
    monkeypatch.setattr(f"{CACHE_FILE}._is_private_group", lambda group: False)
    evaluated()
    folder = own_files(cache)[".code"].parents[2 - below]
    folder.chmod(mode)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        require_right(evaluated())
    assert traces == ["program"] * (2 if reason else 1)
    assert [reason in str(one.message) for one in told] == ([True] if reason else [])
    folder.chmod(0o700)
    require_right(evaluated())
    assert len(traces) == (2 if reason else 1)


def test_owners_and_groups_that_are_trusted(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    names = {1000: "ann", 1001: "ann", 1002: "lab"}
    members = {1000: [], 1001: ["bob"], 1002: []}
    monkeypatch.setattr("pwd.getpwuid", lambda user: SimpleNamespace(pw_name=names[user]))
    monkeypatch.setattr("grp.getgrgid", lambda group: SimpleNamespace(gr_name=names[group], gr_mem=members[group]))
    for owner in (1000, 0):
        assert distrust_from_status(status_of(0o755, owner)) is None
        assert distrust_from_status(status_of(0o775, owner, 1000)) is None  # the user's private group
        for number in (1001, 1002, 7):  # with another member, of another name, unknown
            assert "by a group" in distrust_from_status(status_of(0o775, owner, number))
    assert "another user, number 999" in distrust_from_status(status_of(0o700, 999))
    monkeypatch.delattr(os, "geteuid")
    assert distrust_from_status(status_of(0o777, 999)) is None


def test_folders_above_links_and_what_cannot_be_examined(tmp_path):
    folder = tmp_path / "open" / "cache"
    folder.mkdir(parents=True)
    assert reason_for_distrust(folder) is None
    for mode, reason in ((0o777, f"everyone can write to {folder.parent}"), (0o1777, None), (0o775, None)):
        folder.parent.chmod(mode)
        assert reason_for_distrust(folder, folder / "missing") == reason
    folder.chmod(0o777)
    (tmp_path / "link").symlink_to(folder)
    assert "cache can be written to by everyone" in reason_for_distrust(tmp_path / "link")
    (tmp_path / "file").write_text("")
    assert reason_for_distrust(tmp_path / "file" / "below", tmp_path / "missing") is None
    (tmp_path / "circle").symlink_to("circle")
    assert "circle cannot be examined" in reason_for_distrust(tmp_path / "circle")


def test_a_file_that_others_can_write_to_is_not_used(cache, traces):
    evaluated()
    path = own_files(cache)[".code"]
    for mode in (0o606, 0o666):
        path.chmod(mode)
        assert read(path) is None
    require_right(evaluated())
    assert stat.S_IMODE(path.stat().st_mode) == 0o600 and traces == ["program"] * 2


def test_nothing_is_removed_through_a_folder_of_strangers(cache, tmp_path):
    """Old generations are removed; a link in the place of the modules must not lead to other folders."""
    for name in "abcde":
        (tmp_path / "mine" / name).mkdir(parents=True)
    (cache / FOLDER).symlink_to(tmp_path / "mine")
    cache.chmod(0o777)
    with pytest.warns(UserWarning, match="can be written to by everyone"):
        require_right(evaluated())
    assert sorted(one.name for one in (tmp_path / "mine").iterdir()) == list("abcde")


@pytest.mark.parametrize("code", [errno.EROFS, errno.ENOSPC])
def test_a_disk_that_is_full_or_read_only_is_done_without(cache, traces, monkeypatch, code):
    def refused(*given, **more):
        raise OSError(code, os.strerror(code))

    evaluated()
    monkeypatch.setattr("tempfile.mkstemp", refused)
    require_right(evaluated())
    require_right(compiled())
    assert traces == ["program", "module"]
    assert list(own_files(cache)) == [".code"]


def test_a_write_that_ends_half_way_leaves_nothing(tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    path = tmp_path / "file"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        write(path, b"x" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
    write(path, b"x" * 5000)
    assert read(path) == b"x" * 5000


# A package of its own, in processes of its own, so that its source can change.
TOY = """
from typing import NamedTuple
import jax, jax.numpy as jnp, numpy as np
from continuation.hostcall import persistent_jit
traced = []

class Pair(NamedTuple):
    sine: jax.Array
    rest: tuple

def twice(x):
    return 2.0 * x

@persistent_jit(static_argnames="how")
def waves(x, how):
    traced.append(1)
    return Pair(jnp.sin(x), (how(x), None))

@persistent_jit(numpy_first=True)
def squares(x):
    traced.append(1)
    return x * x
"""
CALL = """
import sys, numpy as np, jax, toy
own, x = sys.argv[1] == "own", np.linspace(0.0, 1.0, 5)
for k in range(2):
    pair = toy.waves(x, how=(lambda x: 2.0 * x) if own else toy.twice)
assert isinstance(pair, toy.Pair) and pair.rest[1] is None
numbers = [np.asarray(each).tobytes().hex() for each in (pair.sine, pair.rest[0], toy.squares(x))]
print(len(toy.traced), *numbers)
"""


def fresh(*words, **environment):
    """Return the output of a Python process with no settings of JAX but the given ones."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, env=plain | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_later_processes_do_not_trace_until_the_source_changes(tmp_path):
    folder, source = tmp_path / "cache", tmp_path / "toy.py"
    folder.mkdir(mode=0o700)
    source.write_text(TOY)
    settings = {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)]), "JAX_ENABLE_X64": "1"}
    settings["PYTHONDONTWRITEBYTECODE"] = "1"  # a source of the same length and second would be taken for the old one
    cached = settings | {"JAX_COMPILATION_CACHE_DIR": str(folder)}
    first, second, without = (fresh("-c", CALL, "ours", **given).split() for given in (cached, cached, settings))
    assert (first[0], second[0], without[0]) == ("2", "0", "2")
    assert first[1:] == second[1:] == without[1:]
    assert (
        fresh("-c", CALL, "own", **cached)[0] == "2"
    )  # functions of users are not kept, each is another: the squares are
    files = own_files(folder)
    assert sorted(files) == ["", ".code"]
    for path in files.values():
        assert path.stat().st_mode & 0o077 == 0 and path.parent.stat().st_mode & 0o077 == 0
    for k in range(GENERATIONS):
        source.write_text(TOY.replace("2.0 * x", f"{3 + k}.0 * x"))
        count, _, numbers, _ = fresh("-c", CALL, "ours", **cached).split()
        assert count == "2"
        assert np.allclose(np.frombuffer(bytes.fromhex(numbers)), (3.0 + k) * np.linspace(0.0, 1.0, 5))
    modules = [path for path in folder.glob(f"{FOLDER}/*/*") if path.suffix == ""]
    assert len(modules) == GENERATIONS


@pytest.mark.parametrize("fails", [False, True])
def test_the_strobe_has_the_same_bits_by_its_module(cache, fails):
    """Also without the module, where the folder cannot be made."""
    if fails:
        (cache / FOLDER).write_text("a file in its place")
    scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    state, slots = jv.State(*(jnp.asarray(each, float) for each in (0.9, -1.1, 0.0, 0.0))), 5 + fails
    computed = _two_tier_strobe(scene, state, 1, slots, False)
    assert len(own_files(cache)) == (0 if fails else 1)
    plain = jax.jit(_two_tier_strobe.__wrapped__, static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)(
        scene, state, 1, slots, False
    )
    for one, two in zip(jax.tree.leaves(computed), jax.tree.leaves(plain), strict=True):
        np.testing.assert_array_equal(one, two)


def test_a_module_is_passed_over_under_transformations(cache):
    """It has no derivative and no lanes: the function itself is called."""

    @persistent_jit(numpy_first=True)
    def cubes(x):
        return x**3

    assert np.allclose(jax.vmap(cubes)(jnp.array([1.0, 2.0])), [1.0, 8.0], rtol=1e-15)
    assert np.allclose([jax.grad(cubes)(2.0), jax.jacrev(cubes)(2.0), jax.jit(cubes)(2.0)], [12.0, 12.0, 8.0])
    assert not own_files(cache)  # a function made here is known to this process alone


SCENES = {"small": (1.0, 2.1, 0.05, 0.7, (-5.0, 5.0)), "full": (2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))}
WARMED = """
import sys, numpy as np, jaxvibro as jv
from continuation.hostcall.host_jit import HostFunction
traced, plain = [], HostFunction._trace_program
HostFunction._trace_program = lambda one, *given: traced.append(one.call_stored_module.__name__) or plain(one, *given)
scene = jv.load_scene(sys.argv[1])
state, _ = jv.strobe(scene, jv.State(0.9, -1.1))
branch = jv.follow(jv.find_orbit(scene, state), "amplitude", (0.0, 3.0 * float(scene.amplitude)))
for special in branch.points("SB"):
    jv.switch(special)
for special in branch.points("SN")[:1]:
    jv.locus(special, ("amplitude", "frequency"), dict(amplitude=(0.0, 9.0), frequency=(1.8, 2.4)))
jv.find_attractors(scene)
print(*traced)
print(branch.table(), np.asarray(branch.multipliers).tobytes().hex())
"""


@pytest.mark.parametrize("size", SCENES)
def test_after_jaxvibro_warm_a_process_traces_nothing(tmp_path, size):
    """And it has the numbers of a process without a cache; so has one whose cache is damaged."""
    file = tmp_path / "scene.toml"
    jv.save_scene(jv.make_scene(*SCENES[size]), file)
    told = fresh("-m", "jaxvibro", "warm", file, XDG_CACHE_HOME=str(tmp_path)).splitlines()
    steps = ["strobe", "find_orbit", "follow", "find_attractors" if size == "small" else "switch"]
    assert [line.split()[0] for line in told[:4]] == steps
    settings = dict(line.removeprefix("export ").split("=") for line in told if line.startswith("export "))
    folder = Path(settings["JAX_COMPILATION_CACHE_DIR"])
    assert folder.is_relative_to(tmp_path)
    functions, *table = fresh("-c", WARMED, file, **settings).splitlines()
    assert functions == ""
    functions, *plain = fresh("-c", WARMED, file, JAX_ENABLE_X64="1").splitlines()
    assert len(functions.split()) > 5 and plain == table
    if size == "small":
        return
    rng = random.Random(58)
    for path in folder.glob(f"{FOLDER}/*/*"):
        whole = path.read_bytes()
        path.write_bytes(flipped(whole, rng.randrange(8 * len(whole))))
    functions, *damaged = fresh("-c", WARMED, file, **settings).splitlines()
    assert len(functions.split()) > 5 and damaged == table


def test_warm_refuses_what_it_cannot_do(cache):
    with pytest.raises(jv.ArgumentError):
        jv.warm(jv.make_scene(np.array([2.0, 3.0]), 2.1, 0.05, 0.7, (-1.0, 1.0)))
    jax.config.update("jax_compilation_cache_dir", None)
    with pytest.raises(jv.ArgumentError, match="jax_compilation_cache_dir: must be set"):
        jv.warm()
