"""Stores that several processes create, continue and open at once."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jaxvibro as jv
from jaxvibro.output import atomic_folder, file_lock
from jaxvibro.output.atomic_folder import create_folder_atomically, remove_abandoned_folders
from jaxvibro.output.file_lock import exclusive_lock, shared_lock
from jaxvibro.stores.study_completion import complete_study
from jaxvibro.stores.zarr_store import METADATA_FILE, OpenStore

from .counted_study import Counted
from .stored_bits import bits

TOKEN = "0123456789abcdef"


def test_processes_that_create_one_store_at_once_share_it():
    """A small draw of `python -m tests.stores_proof race 200`: two processes, four, and two of different studies."""
    command = [sys.executable, "-m", "tests.stores_race", "3"]
    ended = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_the_loser_of_a_race_leaves_the_winners_folder(tmp_path):
    path = tmp_path / "store"
    with create_folder_atomically(path) as slow:
        slow.mkdir()
        with create_folder_atomically(path) as fast:
            fast.mkdir()
            (fast / "winner").write_text("")
        assert slow != fast and slow.is_dir()
    assert [one.name for one in path.iterdir()] == ["winner"]
    assert list(tmp_path.iterdir()) == [path]


def test_the_loser_of_a_race_refuses_another_study(tmp_path, monkeypatch):
    path, plain = tmp_path / "store", create_folder_atomically

    def later(place):
        monkeypatch.undo()
        complete_study(Counted(3), jv.Store(path), None)
        return plain(place)

    monkeypatch.setattr("jaxvibro.stores.zarr_store.create_folder_atomically", later)
    with pytest.raises(jv.ArgumentError, match="must hold this study: scene differs"):
        complete_study(Counted(3, offset=0.25), jv.Store(path), None)
    complete_study(Counted(3), jv.Store(tmp_path / "other"), None)
    assert bits(path) == bits(tmp_path / "other")
    assert {one.name for one in tmp_path.iterdir()} == {"store", "other"}


def test_an_error_leaves_nothing(tmp_path):
    with pytest.raises(ArithmeticError), create_folder_atomically(tmp_path / "store") as part:
        part.mkdir()
        raise ArithmeticError
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "store", tmp_path / ("a" * 300)):
        with pytest.raises(OSError, match=re.escape(str(path))), create_folder_atomically(path):
            pass


def abandoned(folder, name):
    part = folder / f".{name}.{TOKEN}.partial"
    part.mkdir()
    (part / "zarr.json").write_text("half")
    (folder / f".{name}.{TOKEN}.lock").write_text("")
    return part


def test_folders_of_dead_processes_alone_are_removed(tmp_path):
    path = tmp_path / "a [b].zarr"
    dead, another = abandoned(tmp_path, path.name), abandoned(tmp_path, "c.zarr")
    with create_folder_atomically(path) as live:
        live.mkdir()
        remove_abandoned_folders(path)
        assert live.is_dir() and not dead.exists() and another.is_dir()
        assert sorted(one.suffix for one in tmp_path.glob(".a*")) == [".lock", ".partial"]
    remove_abandoned_folders(tmp_path / "missing" / "store")


def test_opening_a_store_removes_what_a_killed_creator_left(tmp_path):
    path = tmp_path / "store"
    abandoned(tmp_path, "store")
    complete_study(Counted(3), jv.Store(path), None)
    abandoned(tmp_path, "store")
    complete_study(Counted(3), jv.Store(path), None)
    assert list(tmp_path.iterdir()) == [path]


def test_a_name_taken_before_it_is_locked_is_given_up(tmp_path, monkeypatch):
    """Another process removes a lock file between its creation and its locking."""
    plain, removed = file_lock.try_lock, []

    def slow(descriptor):
        if not removed:
            removed.extend(tmp_path.glob(".*.lock"))
            removed[0].unlink()
        return plain(descriptor)

    monkeypatch.setattr(atomic_folder, "try_lock", slow)
    with create_folder_atomically(tmp_path / "store") as part:
        part.mkdir()
        assert part.with_suffix(".lock").is_file() and part.with_suffix(".lock") not in removed
        monkeypatch.undo()
        remove_abandoned_folders(tmp_path / "store")
        assert part.is_dir()
    assert list(tmp_path.iterdir()) == [tmp_path / "store"]


def test_without_locks_nothing_is_taken_for_abandoned(tmp_path, monkeypatch):
    monkeypatch.setattr(file_lock, "fcntl", None)
    path = tmp_path / "store"
    with create_folder_atomically(path) as part:
        part.mkdir()
        assert not part.with_suffix(".lock").exists()
        dead = abandoned(tmp_path, "store")
        remove_abandoned_folders(path)
        assert part.is_dir() and dead.is_dir()
    assert path.is_dir()


def test_unfinished_files_stay_while_another_process_writes_a_chunk(tmp_path):
    path = tmp_path / "store"
    complete_study(Counted(3), jv.Store(path), None)
    unfinished = path / "label" / "c" / "0" / "0.abc.partial"
    unfinished.write_text("half")
    with shared_lock(path / METADATA_FILE):
        OpenStore(str(path)).remove_unfinished()
        assert unfinished.exists()
    OpenStore(str(path)).remove_unfinished()
    assert not unfinished.exists()


def test_a_chunk_is_written_under_the_lock(tmp_path, monkeypatch):
    path, free = tmp_path / "store", []
    plain = OpenStore._chunk_digest

    def digest(self, number):
        with exclusive_lock(path / METADATA_FILE) as alone:
            free.append(alone)
        return plain(self, number)

    monkeypatch.setattr(OpenStore, "_chunk_digest", digest)
    complete_study(Counted(1), jv.Store(path, jv.LocalEngine(1)), None)
    assert free[0] is False
    with exclusive_lock(path / METADATA_FILE) as alone:
        assert alone
    assert os.listdir(tmp_path) == ["store"]
