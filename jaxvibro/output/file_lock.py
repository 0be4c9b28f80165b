"""Lock files with advisory locks, which the system releases when the process that holds them ends."""

import errno
import os
from contextlib import contextmanager, suppress
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
