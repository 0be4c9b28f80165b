"""Files that are complete or absent: links beside them, permissions, and a full disk.

What an interrupted write leaves is tested in test_command.py and tests/properties/test_output.py.
"""

import os
import shutil
from collections import namedtuple

import pytest

import jaxvibro as jv
from jaxvibro.output.atomic_files import atomic_file
from tests.scene_files import SCENES


def test_a_planted_link_is_not_followed(tmp_path):
    """Links lie wherever the name of a part of the file can be guessed."""
    folder, victim, process = tmp_path / "shared", tmp_path / "victim", os.getpid()
    folder.mkdir()
    victim.write_text("theirs")
    names = f".{process}-mine", f"{process}-mine", f"mine.{process}", ".mine", "mine.part", "mine.tmp"
    for name in names:
        (folder / name).symlink_to(victim)
    with atomic_file(folder / "mine") as file:
        file.write(b"new")
    assert (folder / "mine").read_bytes() == b"new" and victim.read_text() == "theirs"
    assert not (folder / "mine").is_symlink()


def test_an_existing_file_under_the_temporary_name_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr("secrets.token_hex", lambda size: "guessed")
    (tmp_path / ".guessed.part").symlink_to(tmp_path / "victim")
    (tmp_path / "victim").write_text("theirs")
    with pytest.raises(FileExistsError, match="mine"), atomic_file(tmp_path / "mine") as file:
        file.write(b"new")
    assert (tmp_path / "victim").read_text() == "theirs"
    assert {one.name for one in tmp_path.iterdir()} == {".guessed.part", "victim"}


def test_temporary_names_differ(tmp_path):
    seen = set()
    for _ in range(50):
        with atomic_file(tmp_path / ("a" * 255), overwrite=True) as file:  # as long as a name may be
            seen |= {one.name for one in tmp_path.iterdir() if one.name.startswith(".")}
            file.write(b"new")
    assert len(seen) == 50


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_the_mask_of_the_user_is_kept(tmp_path, mask):
    before = os.umask(mask)
    try:
        with atomic_file(tmp_path / "mine") as file:
            assert os.fstat(file.fileno()).st_mode & 0o777 == 0o666 & ~mask
            file.write(b"new")
    finally:
        os.umask(before)
    assert (tmp_path / "mine").stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_link_that_leads_nowhere_already_exists(tmp_path):
    (tmp_path / "mine").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileExistsError), atomic_file(tmp_path / "mine"):
        pass
    with atomic_file(tmp_path / "mine", overwrite=True) as file:
        file.write(b"new")
    assert not (tmp_path / "mine").is_symlink() and not (tmp_path / "nowhere").exists()


def test_a_folder_on_a_full_disk_or_that_cannot_be_written_to_is_refused_before_any_work(tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left on device") as caught:
        patch.setattr(shutil, "disk_usage", lambda path: namedtuple("Usage", "free")(1000))
        jv.run(SCENES / "branches.toml", tmp_path)
    assert caught.value.filename == str(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write everywhere
    with pytest.raises(PermissionError, match="cannot be written to"):
        jv.run(SCENES / "branches.toml", tmp_path / "new" / "below")
    assert list(tmp_path.iterdir()) == []
