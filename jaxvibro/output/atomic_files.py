"""Write files and folders that are either complete or absent, and lock files.

Create folders that are either complete or absent. A folder is created under a unique temporary name in the same parent
folder. It is renamed when it is complete.

A lock file beside the temporary folder shows whether the process that creates the folder is alive. This process holds a
lock on the file, and the system releases the lock when the process ends. Other processes can therefore remove the
temporary folder of a dead process, and never remove that of a live process, even on another host or in another
container. If the file system does not support locks, there is no lock file, and the temporary folder of a killed
process remains.
"""

import errno
import os
import re
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

fcntl: Any
try:
    import fcntl
except ImportError:  # not available on this system
    fcntl = None


class LocksUnsupported(Exception):
    """Error for a system or a file system that does not support locks."""


def acquire_lock(descriptor: int, shared: bool = False) -> bool:
    """Lock an open file; return False if another process or thread holds a lock on it.

    Parameters
    ----------
    descriptor : int
        Descriptor of the open file.
    shared : bool, optional
        If True, wait for a shared lock; else try to get an exclusive lock without waiting.

    Returns
    -------
    bool
        True if this process holds the lock.

    Raises
    ------
    LocksUnsupported
        If the system or the file system does not support locks.
    """
    if fcntl is None:
        raise LocksUnsupported
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH if shared else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        raise LocksUnsupported from None
    return True


@contextmanager
def lock_file(path, shared):
    """Try to hold a lock on a file within the block; continue without a lock if the file cannot be locked.

    Parameters
    ----------
    path : path_like
        File to lock.
    shared : bool
        If True, wait for a shared lock; else try to get an exclusive lock without waiting.

    Yields
    ------
    bool
        True if the block holds the lock.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY if shared else os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        has_lock = False
        with suppress(LocksUnsupported):
            has_lock = acquire_lock(descriptor, shared)
        yield has_lock
    finally:
        os.close(descriptor)


MIN_FREE_BYTES = 1 << 20  # free space required on the disk of the results


@contextmanager
def atomic_file(path, overwrite=False):
    """Yield a binary file that is renamed to `path` if the block ends without an error.

    The file is created under an unguessable name and is therefore never written through an existing link. Its
    permissions follow the user's mask. After an error or an interrupt in the block the file is removed.

    Parameters
    ----------
    path : path_like
        File to write.
    overwrite : bool, optional
        If True, replace an existing file.

    Yields
    ------
    file
        Binary file, open for writing.

    Raises
    ------
    FileExistsError
        If the file exists and `overwrite` is False.
    NotADirectoryError
        If the parent of `path` does not exist or is not a folder.
    OSError
        If writing fails for another reason. The error names `path`.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise NotADirectoryError(f"{path.parent} is not a folder")
    if os.path.lexists(path) and not overwrite:
        raise FileExistsError(f"{path} already exists; force overwrites it")
    temporary_path = path.with_name(f".{secrets.token_hex(16)}.part")
    try:
        with open(temporary_path, "xb") as file:
            try:
                yield file
                file.close()
                os.replace(temporary_path, path)
            finally:
                temporary_path.unlink(missing_ok=True)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary_path)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def require_writable_folder(folder):
    """Raise an OSError if files cannot be written to a folder, whether it exists or has to be created.

    Parameters
    ----------
    folder : path_like
        Folder, existing or not.

    Raises
    ------
    NotADirectoryError
        If `folder` is a file.
    PermissionError
        If the folder, or its nearest existing parent, is not writable.
    OSError
        If less than 1 MiB of the disk is free.
    """
    folder = Path(folder)
    if not os.path.isdir(folder) and os.path.lexists(folder):
        raise NotADirectoryError(f"out: {folder} is not a folder")
    existing_path = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not (existing_path.is_dir() and os.access(existing_path, os.W_OK | os.X_OK)):
        raise PermissionError(f"out: {existing_path} cannot be written to")
    if shutil.disk_usage(existing_path).free < MIN_FREE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


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
