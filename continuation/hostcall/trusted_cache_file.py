"""Read and write executable files in the cache folder, only if no other user can have changed them.

A person who can write to the cache folder can execute code as the user of the cache. The folder and its files must
therefore belong to the user or to root, and no one else may have permission to write to them. A digest in the file
detects damage. The digest includes the names of the file and its folder, so that a copy of another file is rejected.
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
    """Return the content that `write` stored in a file; None if the file is missing, damaged or not trusted."""
    try:
        with open(path, "rb") as file:
            if distrust_from_status(os.fstat(file.fileno())):
                return None
            content = file.read()
    except OSError:
        return None
    return content[DIGEST:] if _integrity_digest(path, content[DIGEST:]) == content[:DIGEST] else None


def write(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it.

    The file is either complete or absent. It begins with a digest of its content. If the system reports an OSError, no
    file is written and the error is ignored.
    """
    with suppress(OSError):
        descriptor, temporary_path = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_integrity_digest(path, content) + content)
            os.replace(temporary_path, path)
        except BaseException:
            os.unlink(temporary_path)
            raise


def _integrity_digest(path, content):
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
    Each folder must belong to the user or to root. Nobody else may have permission to write to it, except the private
    group of the user, which has the name of the user and no other members. A parent folder must not be writable by
    everyone, unless its sticky bit protects its contents. On systems without users and modes all folders are trusted.
    """
    if not hasattr(os, "geteuid"):
        return None
    resolved_folders = [Path(os.path.realpath(folder)) for folder in folders]
    for folder in resolved_folders:
        try:
            reason = distrust_from_status(os.stat(folder))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            reason = f"cannot be examined ({error.strerror})"
        if reason:
            return f"{folder} {reason}"
    for parent in sorted(
        {parent_folder for folder in resolved_folders for parent_folder in folder.parents} - set(resolved_folders)
    ):
        with suppress(OSError):
            permissions = os.stat(parent).st_mode
            if permissions & stat.S_IWOTH and not permissions & stat.S_ISVTX:
                return f"everyone can write to {parent}"
    return None


def distrust_from_status(file_status: os.stat_result) -> str | None:
    """Explain why a file or folder with an `os.stat` status cannot be trusted; return None if it can be trusted."""
    if not hasattr(os, "geteuid"):
        return None
    if file_status.st_uid not in (os.geteuid(), 0):
        return f"belongs to another user, number {file_status.st_uid}"
    if file_status.st_mode & stat.S_IWOTH:
        return "can be written to by everyone"
    if file_status.st_mode & stat.S_IWGRP and not _is_private_group(file_status.st_gid):
        return f"can be written to by a group, number {file_status.st_gid}"
    return None


def _is_private_group(group_id):
    """Return True for the private group of the user, which has the name of the user and no other members."""
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


def is_distrusted(cache_root: Path, *folders: Path) -> bool:
    """Return True, with a warning, if folders of a cache must not be used."""
    reason = reason_for_distrust(*folders)
    if reason is not None:
        warn_once(cache_root, reason)
    return reason is not None
