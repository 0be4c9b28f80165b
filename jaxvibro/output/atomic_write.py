"""Write files that are either complete or absent: each is written under a temporary name, then renamed."""

import errno
import os
import secrets
import shutil
from contextlib import contextmanager
from pathlib import Path

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
