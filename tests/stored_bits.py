"""What a folder holds, for comparing stores."""

import hashlib
from pathlib import Path


def bits(path):
    """A digest of a folder: names and contents."""
    files = sorted(one for one in Path(path).rglob("*") if one.is_file())
    return {str(one.relative_to(path)): hashlib.sha256(one.read_bytes()).hexdigest() for one in files}
