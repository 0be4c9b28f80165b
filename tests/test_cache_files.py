"""Cached files are executed: those that are damaged, of another origin or open to strangers are never used."""

import errno
import os
import random
import shutil
import stat
import warnings
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxvibro as jv
from continuation import jaxpr_to_python, numpy_evaluation, persistent_jit, trusted_cache_file
from continuation.trusted_cache_file import distrust_from_status, reason_for_distrust

from .cached_functions import GIVEN, compiled, evaluated, other_waves
from .flipped_bits import flipped

TRUE = np.sin(GIVEN), GIVEN * np.exp(-GIVEN)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """jax's compile cache in a folder of its own; what was warned of before is warned of again."""
    monkeypatch.setattr(persistent_jit, "_own_packages", {*persistent_jit._own_packages})
    monkeypatch.setattr(trusted_cache_file, "_warned", set())
    before = jax.config.jax_compilation_cache_dir
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    yield folder
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def traces(monkeypatch):
    """How often a function is traced because nothing is kept of it, a list."""
    found, traced, made = [], numpy_evaluation.NumpyEvaluator.trace_function, persistent_jit._export_module
    monkeypatch.setattr(
        numpy_evaluation.NumpyEvaluator,
        "trace_function",
        lambda self, args: found.append("program") or traced(self, args),
    )
    monkeypatch.setattr(persistent_jit, "_export_module", lambda *given: found.append("module") or made(*given))
    return found


def status_of(mode, owner, group=0):
    """The status of a file or folder."""
    return os.stat_result((mode, 0, 0, 0, owner, group, 0, 0, 0, 0))


def kept(cache):
    """The files of our own, by the ends of their names."""
    return {one.suffix: one for one in cache.glob(f"{persistent_jit.FOLDER}/*/*")}


def require_right(found):
    for one, true in zip(found, TRUE, strict=True):
        np.testing.assert_allclose(one, true, rtol=1e-14)


def test_a_flipped_bit_is_never_used(cache, traces):
    """A small draw of `python -m tests.cache_proof 1000`."""
    require_right(evaluated())
    require_right(compiled())
    assert traces == ["program", "module"]
    rng = random.Random(58)
    for suffix, path in kept(cache).items():
        whole = path.read_bytes()
        assert trusted_cache_file.read(path) == whole[trusted_cache_file.DIGEST :]
        for place in {0, 8 * trusted_cache_file.DIGEST, 8 * len(whole) - 1, *rng.sample(range(8 * len(whole)), 60)}:
            path.write_bytes(flipped(whole, place))
            assert trusted_cache_file.read(path) is None, (suffix, place)
        for damaged in (b"", whole[:20], whole[:-1], whole + b"\n"):
            path.write_bytes(damaged)
            assert trusted_cache_file.read(path) is None
        traces.clear()
        require_right(evaluated() if suffix else compiled())
        assert traces == (["program"] if suffix else ["module"])
        assert path.read_bytes()[: trusted_cache_file.DIGEST] == whole[: trusted_cache_file.DIGEST]  # written anew


def test_a_line_that_is_inserted_is_not_executed(cache, tmp_path):
    first, mark = evaluated(), tmp_path / "ran"
    path = kept(cache)[".code"]
    content = path.read_bytes()
    line = f"open({str(mark)!r}, 'w').close()\n"
    code = jaxpr_to_python.compile_program_text(f"{line}size, run = 1, None")
    form = content[trusted_cache_file.DIGEST :].split(b"\n")[0]
    for digest in (content[: trusted_cache_file.DIGEST], b"\0" * trusted_cache_file.DIGEST):
        path.write_bytes(digest + form + b"\n" + code)
        for one, again in zip(first, evaluated(), strict=True):
            np.testing.assert_array_equal(one, again)
    assert not mark.exists()


def test_a_file_of_another_function_or_version_is_not_used(cache, traces):
    evaluated()
    mine = kept(cache)[".code"]
    evaluated(other_waves)
    (others,) = set(cache.glob("modules/*/*.code")) - {mine}
    assert trusted_cache_file.read(others) is not None
    shutil.copyfile(others, mine)
    assert trusted_cache_file.read(mine) is None
    require_right(evaluated())
    version = mine.parent.with_name("0" * 32)
    shutil.copytree(mine.parent, version)
    assert trusted_cache_file.read(mine) is not None and trusted_cache_file.read(version / mine.name) is None


def test_a_folder_of_somebody_else_is_not_used(cache, traces, monkeypatch):
    evaluated()
    files = {one: one.read_bytes() for one in cache.rglob("*") if one.is_file()}
    plain, theirs = trusted_cache_file.distrust_from_status, os.geteuid() + 7

    def of_another(status):
        return plain(status_of(status.st_mode, theirs, status.st_gid))

    monkeypatch.setattr(trusted_cache_file, "distrust_from_status", of_another)
    rule = rf"neither kept in this cache folder nor read.*belongs to another user, number {theirs}"
    with pytest.warns(UserWarning, match=rule) as told:
        require_right(evaluated())
        require_right(evaluated())
    assert len(told) == 1 and str(cache) in str(told[0].message)
    assert traces == ["program"] * 3
    assert f"belongs to another user, number {theirs}" in persistent_jit.reason_without_cache()
    assert {one: one.read_bytes() for one in cache.rglob("*") if one.is_file()} == files
    assert trusted_cache_file.read(kept(cache)[".code"]) is None
    with pytest.raises(jv.ArgumentError, match="jax_compilation_cache_dir: must be a folder that no other user"):
        jv.warm()


# Of the cache folder: (mode, why it is not used, None where it is).
MODES = [
    (0o700, None),
    (0o755, None),
    (0o777, "can be written to by everyone"),
    (0o1777, "can be written to by everyone"),
    (0o702, "can be written to by everyone"),
    (0o770, "can be written to by a group"),
    (0o2775, "can be written to by a group"),
]


@pytest.mark.parametrize(("mode", "reason"), MODES)
@pytest.mark.parametrize("below", [0, 1, 2])
def test_a_folder_that_others_can_write_to_is_not_used(cache, traces, monkeypatch, mode, reason, below):
    monkeypatch.setattr(trusted_cache_file, "_is_private_group", lambda group: False)
    evaluated()
    folder = kept(cache)[".code"].parents[2 - below]
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
    monkeypatch.setattr(
        trusted_cache_file, "pwd", SimpleNamespace(getpwuid=lambda user: SimpleNamespace(pw_name=names[user]))
    )

    def group(number):
        return SimpleNamespace(gr_name=names[number], gr_mem=members[number])

    monkeypatch.setattr(trusted_cache_file, "grp", SimpleNamespace(getgrgid=group))
    for owner in (1000, 0):
        assert distrust_from_status(status_of(0o755, owner)) is None
        assert distrust_from_status(status_of(0o775, owner, 1000)) is None  # the user's private group
        for number in (1001, 1002, 7):  # with another member, of another name, unknown
            assert "by a group" in distrust_from_status(status_of(0o775, owner, number))
    assert "another user, number 999" in distrust_from_status(status_of(0o700, 999))
    monkeypatch.delattr(os, "geteuid")
    assert distrust_from_status(status_of(0o777, 999)) is None


def test_a_folder_above_that_everyone_can_write_to(tmp_path):
    folder = tmp_path / "open" / "cache"
    folder.mkdir(parents=True)
    assert reason_for_distrust(folder) is None
    for mode, reason in ((0o777, f"everyone can write to {folder.parent}"), (0o1777, None), (0o775, None)):
        folder.parent.chmod(mode)
        assert reason_for_distrust(folder, folder / "missing") == reason


def test_a_link_is_followed_to_what_it_means(tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs").chmod(0o777)
    (tmp_path / "link").symlink_to("theirs")
    assert "theirs can be written to by everyone" in reason_for_distrust(tmp_path / "link")


def test_what_cannot_be_examined_is_not_trusted(tmp_path):
    (tmp_path / "file").write_text("")
    assert reason_for_distrust(tmp_path / "file" / "below", tmp_path / "missing") is None
    (tmp_path / "circle").symlink_to("circle")
    assert "circle cannot be examined" in reason_for_distrust(tmp_path / "circle")


def test_a_file_that_others_can_write_to_is_not_used(cache, traces):
    evaluated()
    path = kept(cache)[".code"]
    for mode in (0o606, 0o666):
        path.chmod(mode)
        assert trusted_cache_file.read(path) is None
    require_right(evaluated())
    assert stat.S_IMODE(path.stat().st_mode) == 0o600 and traces == ["program"] * 2


def test_nothing_is_removed_through_a_folder_of_strangers(cache, tmp_path):
    """Old generations are removed; a link in the place of the modules must not lead to other folders."""
    for name in "abcde":
        (tmp_path / "mine" / name).mkdir(parents=True)
    (cache / persistent_jit.FOLDER).symlink_to(tmp_path / "mine")
    cache.chmod(0o777)
    with pytest.warns(UserWarning, match="can be written to by everyone"):
        require_right(evaluated())
    assert sorted(one.name for one in (tmp_path / "mine").iterdir()) == list("abcde")


@pytest.mark.parametrize("code", [errno.EROFS, errno.ENOSPC])
def test_a_disk_that_is_full_or_read_only_is_done_without(cache, traces, monkeypatch, code):
    def refused(*given, **more):
        raise OSError(code, os.strerror(code))

    evaluated()
    monkeypatch.setattr(trusted_cache_file.tempfile, "mkstemp", refused)
    require_right(evaluated())
    require_right(compiled())
    assert traces == ["program", "module"]
    assert list(kept(cache)) == [".code"]


def test_a_write_that_ends_half_way_leaves_nothing(tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    path = tmp_path / "file"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        trusted_cache_file.write(path, b"x" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
    trusted_cache_file.write(path, b"x" * 5000)
    assert trusted_cache_file.read(path) == b"x" * 5000
