"""Create folders that are complete or absent: made under a unique name beside their place, then renamed into it.

A lock file beside the temporary folder shows whether its process is alive: the process holds a lock on it, which the
system releases when the process ends. So the temporary folder of a dead process can be removed, and that of a live
process never is, whichever host or container it runs in. If the file system has no locks, there is no lock file, and
the temporary folder of a killed process remains.
"""

import os
import re
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path

from .file_lock import LockUnavailable, try_lock

PARTIAL_SUFFIX, LOCK_SUFFIX = ".partial", ".lock"
TOKEN_PATTERN = "[0-9a-f]{16}"


@contextmanager
def complete_folder(path):
    """Yield a new temporary folder that takes the place of `path` when the block ends without an error.

    If several processes create the same folder, the first to finish wins. The others discard their own folder, so that
    afterwards `path` exists and its content may be another process's.

    Parameters
    ----------
    path : Path
        Folder to create. Its parent must exist.

    Yields
    ------
    Path
        Name of the temporary folder, which the caller creates and fills.

    Raises
    ------
    OSError
        If the folder cannot be made beside its place, or cannot be moved into it and nothing else exists there.
    """
    temporary, lock, descriptor = _reserve_temporary(path)
    try:
        yield temporary
        try:
            os.rename(temporary, path)
        except OSError:
            if not os.path.lexists(path):
                raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            os.unlink(lock)
        if descriptor is not None:
            os.close(descriptor)


def remove_abandoned(path: Path) -> None:
    """Remove the temporary folders that dead processes left beside `path`; those of live processes stay.

    Parameters
    ----------
    path : Path
        Folder beside whose place they are.
    """
    pattern = re.compile(rf"{re.escape(f'.{path.name}.')}{TOKEN_PATTERN}{re.escape(LOCK_SUFFIX)}")
    try:
        locks = [path.with_name(name) for name in os.listdir(path.parent) if pattern.fullmatch(name)]
    except OSError:
        return
    for lock in locks:
        with suppress(OSError, LockUnavailable):  # removed in the meantime, or owned by another user
            descriptor = os.open(lock, os.O_RDWR)
            try:
                temporary = lock.with_suffix(PARTIAL_SUFFIX)
                if try_lock(descriptor):
                    shutil.rmtree(temporary, ignore_errors=True)
                    if not os.path.lexists(temporary):
                        os.unlink(lock)
            finally:
                os.close(descriptor)


def _reserve_temporary(path):
    """Return (temporary folder, its lock file, descriptor that holds the lock or None) under unused names."""
    while True:
        stem = f".{path.name}.{secrets.token_hex(8)}"
        temporary, lock = path.with_name(stem + PARTIAL_SUFFIX), path.with_name(stem + LOCK_SUFFIX)
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
        try:
            if try_lock(descriptor) and _still_has_name(descriptor, lock):
                return temporary, lock, descriptor
        except LockUnavailable:
            os.close(descriptor)
            os.unlink(lock)
            return temporary, lock, None
        os.close(descriptor)  # `remove_abandoned` of another process preceded the lock


def _still_has_name(descriptor, path):
    """Return True if an open file still has its name."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False
