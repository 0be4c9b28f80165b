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


def try_lock(descriptor: int) -> bool:
    """Lock an open file exclusively; return False if another process or thread holds a lock on it.

    Parameters
    ----------
    descriptor : int
        Descriptor of the open file.

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
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        raise LocksUnsupported from None
    return True


@contextmanager
def shared_lock(path):
    """Hold a shared lock on a file within the block; continue without a lock if the file cannot be locked.

    Parameters
    ----------
    path : path_like
        File to lock.
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
        File to lock.

    Yields
    ------
    bool
        True if the block holds the lock.
    """
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        try:
            has_lock = try_lock(descriptor)
        except LocksUnsupported:
            has_lock = False
        yield has_lock
    finally:
        os.close(descriptor)
