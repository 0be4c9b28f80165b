"""What the command line asks of jax before it is loaded: double precision, and compiled code kept between runs.

Compiled code fits one kind of processor and is trusted like the program itself, so it lies in a folder of the user's
own, one for each kind. Where there is no such folder the command runs without.
"""

import hashlib
import os
import platform
import re
import secrets
import stat
import sys
import warnings
from contextlib import suppress
from pathlib import Path

NAMES = ("vendor_id", "model name", "flags", "Features", "CPU implementer", "CPU part")  # of /proc/cpuinfo


def prepare():
    """Set jax up through its environment variables; those that the user has set stay. No jax is loaded here.

    Where jax is loaded already, as in a test, its settings are those of whoever loaded it. Returns what is now set, of
    those that are asked for here: {name: text}.
    """
    if "jax" in sys.modules:
        return {}
    asked = {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3"}
    if place := folder():
        asked |= {
            "JAX_COMPILATION_CACHE_DIR": str(place),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
        warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    os.environ.update({name: value for name, value in asked.items() if name not in os.environ})
    return {name: os.environ[name] for name in asked}


def folder():
    """The folder for this user and this kind of processor, made where it is missing; None where it cannot be.

    It lies in XDG_CACHE_HOME or ~/.cache, and none but the user can enter it, or put another in its place.
    """
    try:
        given = Path(os.environ.get("XDG_CACHE_HOME", ""))
        if not given.is_absolute() and not Path.home().is_dir():
            return None
        top = (given if given.is_absolute() else Path.home() / ".cache") / "jaxvibro"
        place = top / processor()
        for one in (top, place):
            one.mkdir(mode=0o700, parents=True, exist_ok=True)
            if one.stat().st_uid != os.geteuid():
                return None
            one.chmod(0o700)
        if any(map(_is_open, place.resolve().parents)):
            return None
    except (OSError, RuntimeError):
        return None
    return place if os.access(place, os.W_OK | os.X_OK) else None


def _is_open(folder):
    """Return True if everyone can rename what lies in a folder."""
    mode = folder.stat().st_mode
    return bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX


def token():
    """What the address of the explorer's page must hold, the same each time, so that a page outlives its server; None
    where there is no folder for it. None but the user can read it."""
    place = folder()
    if place is None:
        return None
    place = place.parent / "view.token"
    found = _read_token(place)
    if found is None:
        _write_token(place)
        found = _read_token(place)
    return found


def _read_token(place):
    """The token in a file; None if there is no file, or no token in it."""
    try:
        found = place.read_text()
    except (OSError, UnicodeDecodeError):
        return None
    return found if re.fullmatch(r"[\w-]{43}", found) else None


def _write_token(place):
    """Write a new token. Of several processes that do so at once the first wins; a file without a token is replaced."""
    part = place.with_name(f".{place.name}.{secrets.token_hex(8)}.part")
    with suppress(OSError):
        try:
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(descriptor, "w") as file:
                file.write(secrets.token_urlsafe(32))
            try:
                os.link(part, place)
            except OSError:
                if _read_token(place) is None:
                    os.replace(part, place)
        finally:
            part.unlink(missing_ok=True)


def processor():
    """A name for the kind of processor: equal where compiled code may be shared."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    first = [line for line in text.split("\n\n")[0].splitlines() if line.split(":")[0].strip() in NAMES]
    return hashlib.sha256("\n".join([platform.machine(), *first]).encode()).hexdigest()[:16]
