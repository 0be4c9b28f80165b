"""Create folders that are either complete or absent.

A folder is created under a unique temporary name in the same parent folder. It is renamed when it is complete.

A lock file beside the temporary folder shows whether the process that creates the folder is alive. This process holds a
lock on the file, and the system releases the lock when the process ends. Other processes can therefore remove the
temporary folder of a dead process, and never remove that of a live process, even on another host or in another
container. If the file system does not support locks, there is no lock file, and the temporary folder of a killed
process remains.
"""

import os
import re
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path

from .file_lock import LocksUnsupported, acquire_lock

PARTIAL_SUFFIX, LOCK_SUFFIX = ".partial", ".lock"
TOKEN_PATTERN = "[0-9a-f]{16}"


@contextmanager
def create_folder_atomically(path):
    """Yield the name of a temporary folder that is renamed to `path` if the block ends without an error.

    If several processes create the same folder, the folder of the first process to finish remains. The others discard
    their own folders. `path` then exists, but another process may have written its content.

    Parameters
    ----------
    path : Path
        Folder to create. Its parent must exist.

    Yields
    ------
    Path
        Temporary folder. The caller creates and fills it.

    Raises
    ------
    OSError
        If the temporary folder cannot be created, or cannot be renamed although `path` does not exist.
    """
    temporary_folder, lock_path, lock_descriptor = _reserve_folder_name(path)
    try:
        yield temporary_folder
        try:
            os.rename(temporary_folder, path)
        except OSError:
            if not os.path.lexists(path):
                raise
    finally:
        shutil.rmtree(temporary_folder, ignore_errors=True)
        with suppress(OSError):
            os.unlink(lock_path)
        if lock_descriptor is not None:
            os.close(lock_descriptor)


def remove_abandoned_folders(path: Path) -> None:
    """Remove the temporary folders of `path` whose processes have ended.

    Parameters
    ----------
    path : Path
        Folder that these processes were creating.
    """
    lock_name_pattern = re.compile(rf"{re.escape(f'.{path.name}.')}{TOKEN_PATTERN}{re.escape(LOCK_SUFFIX)}")
    try:
        lock_paths = [
            path.with_name(file_name) for file_name in os.listdir(path.parent) if lock_name_pattern.fullmatch(file_name)
        ]
    except OSError:
        return
    for lock_path in lock_paths:
        with suppress(OSError, LocksUnsupported):  # removed in the meantime, or owned by another user
            lock_descriptor = os.open(lock_path, os.O_RDWR)
            try:
                temporary_folder = lock_path.with_suffix(PARTIAL_SUFFIX)
                if acquire_lock(lock_descriptor):
                    shutil.rmtree(temporary_folder, ignore_errors=True)
                    if not os.path.lexists(temporary_folder):
                        os.unlink(lock_path)
            finally:
                os.close(lock_descriptor)


def _reserve_folder_name(path):
    """Reserve an unused name; return (temporary folder, lock file, descriptor that holds the lock).

    The descriptor is None if the file system does not support locks.
    """
    while True:
        name_stem = f".{path.name}.{secrets.token_hex(8)}"
        temporary_folder, lock_path = (
            path.with_name(name_stem + PARTIAL_SUFFIX),
            path.with_name(name_stem + LOCK_SUFFIX),
        )
        try:
            lock_descriptor = os.open(lock_path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
        try:
            if acquire_lock(lock_descriptor) and _is_still_at_path(lock_descriptor, lock_path):
                return temporary_folder, lock_path, lock_descriptor
        except LocksUnsupported:
            os.close(lock_descriptor)
            os.unlink(lock_path)
            return temporary_folder, lock_path, None
        os.close(lock_descriptor)  # `remove_abandoned_folders` of another process preceded the lock


def _is_still_at_path(lock_descriptor, path):
    """Return True if the open file is still the file at `path`."""
    try:
        return os.path.samestat(os.fstat(lock_descriptor), os.stat(path))
    except FileNotFoundError:
        return False
