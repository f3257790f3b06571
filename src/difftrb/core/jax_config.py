"""JAX as the command line runs it: float64, and compiled programs kept in the user's cache folder."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
from pathlib import Path


def set_up_jax(cache: bool) -> None:
    """Float64, no noise from XLA and, if asked, compiled programs kept in the user's cache folder."""
    # XLA reports its own tuning hints as missing processor features whenever it loads a kept program
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    jax.config.update("jax_enable_x64", True)
    if cache and (folder := cache_folder()) is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def cache_folder() -> Path | None:
    """Where compiled programs are kept: the user's cache folder, apart for every kind of processor.

    The folder is made; None where it cannot be.
    """
    import platformdirs

    processor = platform.machine()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    folder = Path(platformdirs.user_cache_dir("difftrb")) / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None
