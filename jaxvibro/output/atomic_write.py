"""Write files that are complete or absent: written beside their place, then renamed into it."""

import errno
import os
import secrets
import shutil
from contextlib import contextmanager
from pathlib import Path

MIN_FREE_BYTES = 1 << 20  # free space required on the disk of the results


@contextmanager
def atomic_file(path, overwrite=False):
    """Yield a file for bytes that takes the place of `path` when the block ends without an error.

    The file is created under an unguessable name, so never written through an existing link, and has the permissions of
    the user's mask. After an error or an interrupt in the block nothing is left.

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
        If its folder does not exist or is not a folder.
    OSError
        If writing fails for another reason. The error names the wanted file.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise NotADirectoryError(f"{path.parent} is not a folder")
    if os.path.lexists(path) and not overwrite:
        raise FileExistsError(f"{path} already exists; force overwrites it")
    temporary = path.with_name(f".{secrets.token_hex(16)}.part")
    try:
        with open(temporary, "xb") as file:
            try:
                yield file
                file.close()
                os.replace(temporary, path)
            finally:
                temporary.unlink(missing_ok=True)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def require_writable_folder(folder):
    """Raise an OSError that names the folder if files cannot be written to it, be it existing or to be created.

    Parameters
    ----------
    folder : path_like
        Folder.

    Raises
    ------
    NotADirectoryError
        If a file has its name.
    PermissionError
        If it, or its nearest existing parent, is not writable.
    OSError
        If the disk is full.
    """
    folder = Path(folder)
    if not os.path.isdir(folder) and os.path.lexists(folder):
        raise NotADirectoryError(f"out: {folder} is not a folder")
    ancestor = next(candidate for candidate in (folder, *folder.absolute().parents) if os.path.lexists(candidate))
    if not (ancestor.is_dir() and os.access(ancestor, os.W_OK | os.X_OK)):
        raise PermissionError(f"out: {ancestor} cannot be written to")
    if shutil.disk_usage(ancestor).free < MIN_FREE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
