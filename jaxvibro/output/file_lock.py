"""Advisory locks on open files, released by the system when the process that holds them ends."""

import errno
import os
from contextlib import contextmanager, suppress
from typing import Any

fcntl: Any
try:
    import fcntl
except ImportError:  # not available on this system
    fcntl = None


class LockUnavailable(Exception):
    """Error: the system or the file system has no such locks."""


def try_lock(descriptor: int) -> bool:
    """Lock an open file exclusively; return False if another process or thread holds a lock on it.

    Parameters
    ----------
    descriptor : int
        Descriptor of the open file.

    Returns
    -------
    bool
        True if the lock is held.

    Raises
    ------
    LockUnavailable
        If the file cannot be locked at all.
    """
    if fcntl is None:
        raise LockUnavailable
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        raise LockUnavailable from None
    return True


@contextmanager
def shared_lock(path):
    """Hold a shared lock on a file within the block, or no lock if the file cannot be locked.

    Parameters
    ----------
    path : path_like
        File.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def exclusive_lock(path):
    """Try to hold an exclusive lock on a file within the block, without waiting.

    Parameters
    ----------
    path : path_like
        File.

    Yields
    ------
    bool
        True if the lock is held.
    """
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        try:
            has_lock = try_lock(descriptor)
        except LockUnavailable:
            has_lock = False
        yield has_lock
    finally:
        os.close(descriptor)
