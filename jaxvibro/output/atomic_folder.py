"""Folders that are complete or absent: made under a unique name beside their place, then renamed into it.

A lock file beside the temporary folder shows whether its process is alive: the process holds a lock on it, which the
system releases when the process ends, however it ends. So a temporary folder of a dead process can be removed, and one
of a live process never is, whichever host or container it runs in. Where the file system has no locks the lock file is
left out, and the temporary folder of a killed process stays.
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

    Of several processes that create the same folder the first to finish wins. The others discard their own folder, so
    that afterwards `path` exists and its content may be another process's.

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
        If the folder cannot be made beside its place, or cannot be put into it and nothing else is there.
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
    """Remove the temporary folders that dead processes left beside `path`; those of live processes stay."""
    pattern = re.compile(rf"{re.escape(f'.{path.name}.')}{TOKEN_PATTERN}{re.escape(LOCK_SUFFIX)}")
    try:
        locks = [path.with_name(name) for name in os.listdir(path.parent) if pattern.fullmatch(name)]
    except OSError:
        return
    for lock in locks:
        with suppress(OSError, LockUnavailable):  # removed meanwhile, or another user's
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
    """(temporary folder, its lock file, descriptor that holds the lock or None) under names that are not in use."""
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
        os.close(descriptor)  # `remove_abandoned` of another process was faster than the lock


def _still_has_name(descriptor, path):
    """Return True if an open file still has its name."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False
