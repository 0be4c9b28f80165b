"""Files that are complete or absent: links beside them, permissions, and what an error leaves."""

import builtins
import os
import shutil
from collections import namedtuple

import pytest

from jaxvibro.output.atomic_write import atomic_file, require_writable_folder


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


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, OSError(28, "No space left on device"), ValueError])
def test_an_error_leaves_what_was_there(tmp_path, error):
    (tmp_path / "mine").write_text("old")
    with (
        pytest.raises(error if isinstance(error, type) else OSError) as caught,
        atomic_file(tmp_path / "mine", True) as file,
    ):
        file.write(b"half")
        raise error
    assert [one.name for one in tmp_path.iterdir()] == ["mine"] and (tmp_path / "mine").read_text() == "old"
    assert isinstance(error, type) or caught.value.filename == str(tmp_path / "mine")


def test_a_link_that_leads_nowhere_is_there_already(tmp_path):
    (tmp_path / "mine").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileExistsError), atomic_file(tmp_path / "mine"):
        pass
    with atomic_file(tmp_path / "mine", overwrite=True) as file:
        file.write(b"new")
    assert not (tmp_path / "mine").is_symlink() and not (tmp_path / "nowhere").exists()


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(path, mode):
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        return builtins.open("/dev/full", "wb", buffering=0)

    monkeypatch.setattr("jaxvibro.output.atomic_write.open", full, raising=False)
    with pytest.raises(OSError, match="No space left on device") as caught, atomic_file(tmp_path / "mine") as file:
        file.write(b"new")
    assert caught.value.filename == str(tmp_path / "mine") and not list(tmp_path.iterdir())


def test_a_folder_on_a_full_disk_is_refused(tmp_path, monkeypatch):
    require_writable_folder(tmp_path / "new" / "below")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: namedtuple("Usage", "free")(1000))
    with pytest.raises(OSError, match="No space left on device") as caught:
        require_writable_folder(tmp_path / "new")
    assert caught.value.filename == str(tmp_path / "new")
