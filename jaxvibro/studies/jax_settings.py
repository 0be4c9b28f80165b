"""Set the environment of JAX for the command line before it loads: double precision and a persistent compile cache.

Compiled code fits one kind of processor and is trusted like the program itself. It lies in a private folder of the
user, one per kind of processor. Without such a folder the command runs without a cache.
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

CPUINFO_FIELDS = ("vendor_id", "model name", "flags", "Features", "CPU implementer", "CPU part")  # in /proc/cpuinfo


def prepare_environment():
    """Set the environment variables of JAX, except those that the user has set, without loading JAX.

    Nothing changes if JAX is already loaded, as in a test. Returns the resulting values of these variables, {name:
    text}.
    """
    if "jax" in sys.modules:
        return {}
    settings = {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3"}
    if cache_path := user_cache_folder():
        settings |= {
            "JAX_COMPILATION_CACHE_DIR": str(cache_path),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
        warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    os.environ.update({name: value for name, value in settings.items() if name not in os.environ})
    return {name: os.environ[name] for name in settings}


def user_cache_folder():
    """Return the cache folder for this user and this kind of processor, or None if it cannot be created.

    It lies in XDG_CACHE_HOME or ~/.cache. Only the user can enter it, or put another folder in its place.
    """
    try:
        xdg_home = Path(os.environ.get("XDG_CACHE_HOME", ""))
        if not xdg_home.is_absolute() and not Path.home().is_dir():
            return None
        base = (xdg_home if xdg_home.is_absolute() else Path.home() / ".cache") / "jaxvibro"
        path = base / processor_fingerprint()
        for directory in (base, path):
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            if directory.stat().st_uid != os.geteuid():
                return None
            directory.chmod(0o700)
        if any(map(_is_world_writable, path.resolve().parents)):
            return None
    except (OSError, RuntimeError):
        return None
    return path if os.access(path, os.W_OK | os.X_OK) else None


def _is_world_writable(folder):
    """Return True if everyone can rename the contents of a folder."""
    mode = folder.stat().st_mode
    return bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX


def page_token():
    """Return the token in the address of the explorer's page, or None without a folder for it.

    It is the same each time, so that a page outlives its server. Only the user can read it.
    """
    path = user_cache_folder()
    if path is None:
        return None
    path = path.parent / "view.token"
    token = _read_token(path)
    if token is None:
        _write_token(path)
        token = _read_token(path)
    return token


def _read_token(path):
    """Return the token in a file; None if there is no file, or no token in it."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError):
        return None
    return text if re.fullmatch(r"[\w-]{43}", text) else None


def _write_token(path):
    """Write a new token; the first of several processes wins, and a file without a token is replaced."""
    temporary_path = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    with suppress(OSError):
        try:
            descriptor = os.open(temporary_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(descriptor, "w") as file:
                file.write(secrets.token_urlsafe(32))
            try:
                os.link(temporary_path, path)
            except OSError:
                if _read_token(path) is None:
                    os.replace(temporary_path, path)
        finally:
            temporary_path.unlink(missing_ok=True)


def processor_fingerprint():
    """Return a name for the kind of processor, equal where compiled code can be shared."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    identity_lines = [
        line for line in text.split("\n\n")[0].splitlines() if line.split(":")[0].strip() in CPUINFO_FIELDS
    ]
    return hashlib.sha256("\n".join([platform.machine(), *identity_lines]).encode()).hexdigest()[:16]
