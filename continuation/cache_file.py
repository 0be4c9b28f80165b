"""Read and write executable files in the cache folder, only if no other user can have changed them.

Whoever can write to the cache folder can have code run as its user. The folder and its files must therefore belong to
the user or to root, and no one else may have permission to write to them. A digest in the file detects damage. It also
covers the names of the file and its folder, so that a file copied from elsewhere is rejected.
"""

import hashlib
import os
import stat
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

grp: Any
pwd: Any
try:
    import grp
    import pwd
except ImportError:  # absent on this system
    grp = pwd = None

DIGEST = hashlib.sha256().digest_size
_warned: set[tuple[Path, str]] = set()


def read(path: Path) -> bytes | None:
    """Return the content that `write` stored in a file, or None if it is missing or cannot be trusted."""
    try:
        with open(path, "rb") as file:
            if distrust_of(os.fstat(file.fileno())):
                return None
            content = file.read()
    except OSError:
        return None
    return content[DIGEST:] if _digest(path, content[DIGEST:]) == content[:DIGEST] else None


def write(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, under a temporary name that is then changed."""
    with suppress(OSError):
        descriptor, temporary_path = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_digest(path, content) + content)
            os.replace(temporary_path, path)
        except BaseException:
            os.unlink(temporary_path)
            raise


def _digest(path, content):
    return hashlib.sha256(f"{path.parent.name}/{path.name}\n".encode() + content).digest()


def reason_for_distrust(*folders: Path) -> str | None:
    """Explain why files in folders cannot be trusted.

    Parameters
    ----------
    *folders : Path
        Folders to examine. Missing folders are skipped.

    Returns
    -------
    str or None
        The reason; None if the folders can be trusted.

    Notes
    -----
    Each folder must belong to the user or to root, and no one else may have permission to write to it. The user's
    private group may: a group of the same name without other members. A folder above them must not be writable by
    everyone, unless its sticky bit protects its contents. On systems without users and modes all folders are trusted.
    """
    if not hasattr(os, "geteuid"):
        return None
    real_folders = [Path(os.path.realpath(folder)) for folder in folders]
    for folder in real_folders:
        try:
            reason = distrust_of(os.stat(folder))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            reason = f"cannot be examined ({error.strerror})"
        if reason:
            return f"{folder} {reason}"
    for parent in sorted(
        {parent_folder for folder in real_folders for parent_folder in folder.parents} - set(real_folders)
    ):
        with suppress(OSError):
            mode = os.stat(parent).st_mode
            if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
                return f"everyone can write to {parent}"
    return None


def distrust_of(status: os.stat_result) -> str | None:
    """Explain why a file or folder with this status cannot be trusted; None if it can."""
    if not hasattr(os, "geteuid"):
        return None
    if status.st_uid not in (os.geteuid(), 0):
        return f"belongs to another user, number {status.st_uid}"
    if status.st_mode & stat.S_IWOTH:
        return "can be written to by everyone"
    if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid):
        return f"can be written to by a group, number {status.st_gid}"
    return None


def _is_private(group_id):
    """Return True for the user's private group: the same name, without other members."""
    try:
        user_name, group_entry = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group_id)
    except (KeyError, AttributeError):
        return False
    return group_entry.gr_name == user_name and set(group_entry.gr_mem) <= {user_name}


def warn_once(folder: Path, reason: str) -> None:
    """Warn that a cache folder is not used, once per process, folder and reason."""
    if (folder, reason) not in _warned:
        _warned.add((folder, reason))
        warnings.warn(
            f"{folder}: traced functions are neither kept in this cache folder nor read from it, because {reason}. "
            "Anyone who can write to it can have code run as you, as JAX itself executes what it finds there: "
            "use a folder of your own with mode 700.",
            stacklevel=2,
        )
