"""Files that are whole or not there: written beside their place, then renamed into it."""

import os
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path, force=False):
    """A path to write to, beside the wanted one and with its ending, which takes its place when the block ends well.

    After an error in the block nothing is left behind. Raises FileExistsError where the wanted file is there already,
    unless force is given, and NotADirectoryError where its folder is none.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise NotADirectoryError(f"{path.parent} is no folder")
    if path.exists() and not force:
        raise FileExistsError(f"{path} is there already; force overwrites it")
    part = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
