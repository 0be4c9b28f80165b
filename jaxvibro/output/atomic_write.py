"""Files that are whole or not there: written beside their place, then renamed into it."""

import errno
import os
import secrets
import shutil
from contextlib import contextmanager
from pathlib import Path

MIN_FREE_BYTES = 1 << 20  # bytes that a disk must have free before work whose results go there


@contextmanager
def atomic_file(path, overwrite=False):
    """A file for bytes, beside the wanted one, which takes its place when the block ends well.

    It is made anew under a name that nobody can guess, so never written through a link that lies there, and has the
    permissions that the user's mask leaves. After an error or an interrupt in the block nothing is left behind. Raises
    FileExistsError where the wanted file is there already, unless force is given, NotADirectoryError where its folder
    is none, and other OSErrors that name the wanted file.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise NotADirectoryError(f"{path.parent} is no folder")
    if os.path.lexists(path) and not overwrite:
        raise FileExistsError(f"{path} is there already; force overwrites it")
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
    """Refuse a folder to write into, be it there or to be made, where files cannot be put: an OSError that names it."""
    folder = Path(folder)
    if not os.path.isdir(folder) and os.path.lexists(folder):
        raise NotADirectoryError(f"out: {folder} is no folder")
    ancestor = next(candidate for candidate in (folder, *folder.absolute().parents) if os.path.lexists(candidate))
    if not (ancestor.is_dir() and os.access(ancestor, os.W_OK | os.X_OK)):
        raise PermissionError(f"out: {ancestor} cannot be written to")
    if shutil.disk_usage(ancestor).free < MIN_FREE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
