"""Set the environment variables of JAX for the command line: double precision and a persistent compile cache.

Compiled code fits one kind of processor and must be as trustworthy as the program itself. The cache is therefore a
private folder of the user, one for each kind of processor. If this folder cannot be created, the command runs without a
cache.
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


def set_jax_environment():
    """Set the environment variables of JAX that the user has not set; return {name: value} of all of them.

    The result contains the variables that the command line uses, whoever has set them. JAX is not imported. If JAX is
    already imported, nothing is set, and the result is empty.
    """
    if "jax" in sys.modules:
        return {}
    environment_variables = {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3"}
    if compile_cache_path := user_cache_folder():
        environment_variables |= {
            "JAX_COMPILATION_CACHE_DIR": str(compile_cache_path),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
        warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    os.environ.update(
        {
            variable_name: variable_value
            for variable_name, variable_value in environment_variables.items()
            if variable_name not in os.environ
        }
    )
    return {variable_name: os.environ[variable_name] for variable_name in environment_variables}


def user_cache_folder():
    """Return the cache folder for this user and this kind of processor; None if it is not private and writable.

    The folder is in XDG_CACHE_HOME or ~/.cache. Only the user can enter or replace the folder.
    """
    try:
        xdg_cache_home = Path(os.environ.get("XDG_CACHE_HOME", ""))
        if not xdg_cache_home.is_absolute() and not Path.home().is_dir():
            return None
        base_folder = (xdg_cache_home if xdg_cache_home.is_absolute() else Path.home() / ".cache") / "jaxvibro"
        processor_folder = base_folder / processor_fingerprint()
        for folder in (base_folder, processor_folder):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if folder.stat().st_uid != os.geteuid():
                return None
            folder.chmod(0o700)
        if any(map(_is_world_writable, processor_folder.resolve().parents)):
            return None
    except (OSError, RuntimeError):
        return None
    return processor_folder if os.access(processor_folder, os.W_OK | os.X_OK) else None


def _is_world_writable(folder):
    """Return True if every user can rename the contents of a folder."""
    permission_bits = folder.stat().st_mode
    return bool(permission_bits & stat.S_IWOTH) and not permission_bits & stat.S_ISVTX


def load_page_token():
    """Return the token in the address of the explorer's page; None if there is no private folder for the token.

    The token is stored and reused, so that a page remains valid after a restart of the server. Only the user can read
    the token.
    """
    token_path = user_cache_folder()
    if token_path is None:
        return None
    token_path = token_path.parent / "view.token"
    page_token = _read_page_token(token_path)
    if page_token is None:
        _write_page_token(token_path)
        page_token = _read_page_token(token_path)
    return page_token


def _read_page_token(token_path):
    """Return the token in a file; None if the file does not exist or contains no valid token."""
    try:
        token_text = token_path.read_text()
    except (OSError, UnicodeDecodeError):
        return None
    return token_text if re.fullmatch(r"[\w-]{43}", token_text) else None


def _write_page_token(token_path):
    """Write a new token to a file, unless another process has written one; replace a file without a valid token."""
    temporary_path = token_path.with_name(f".{token_path.name}.{secrets.token_hex(8)}.part")
    with suppress(OSError):
        try:
            file_descriptor = os.open(temporary_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(file_descriptor, "w") as token_file:
                token_file.write(secrets.token_urlsafe(32))
            try:
                os.link(temporary_path, token_path)
            except OSError:
                if _read_page_token(token_path) is None:
                    os.replace(temporary_path, token_path)
        finally:
            temporary_path.unlink(missing_ok=True)


def processor_fingerprint():
    """Return a name for the kind of processor; processors with equal names can share compiled code."""
    identity_lines = [
        cpuinfo_line
        for cpuinfo_line in read_cpuinfo().split("\n\n")[0].splitlines()
        if cpuinfo_line.split(":")[0].strip() in CPUINFO_FIELDS
    ]
    return hashlib.sha256("\n".join([platform.machine(), *identity_lines]).encode()).hexdigest()[:16]


def read_cpuinfo():
    """Return the text of /proc/cpuinfo; "" on a system without it."""
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
