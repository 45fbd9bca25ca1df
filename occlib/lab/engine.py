"""Mitsuba 3 and the LLVM that compiles its kernels (extra ``render``)."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import Any

from occlib.base.extras import MissingExtraError, check_extra, import_extra


def load_mitsuba() -> Any:
    """Import Mitsuba in its vectorised variant; ``ValueError`` with the remedy if that cannot work."""
    try:
        # karellen-llvm-core needs its C++ runtime in the process before LLVM itself is opened.
        llvm = Path(os.environ.get("DRJIT_LIBLLVM_PATH", Path(sys.prefix) / "lib" / "libLLVM.so"))
        if llvm.exists():
            os.environ["DRJIT_LIBLLVM_PATH"] = str(llvm)
            for library in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):
                if (found := llvm.parent / "x86_64-unknown-linux-gnu" / library).exists():
                    # Not RTLD_GLOBAL: libc++abi would take over the C++ exceptions of every other library.
                    ctypes.CDLL(str(found), mode=ctypes.RTLD_LOCAL)
        drjit, mitsuba = import_extra("drjit", "render"), import_extra("mitsuba", "render")
        check_extra("pyoidn", "render")
        mitsuba.set_variant("llvm_ad_rgb")
        version = int(drjit.detail.llvm_version()[0])
        if not 19 <= version <= 22:  # older and newer ones abort the whole process on a real scene
            raise ImportError(f"LLVM {version} cannot compile Mitsuba's kernels, 19 to 22 can: karellen-llvm-core<23")
    except MissingExtraError:
        raise
    except (ImportError, OSError) as error:
        raise ValueError(f"rendering needs Mitsuba 3 with LLVM 19 to 22: {error}") from None
    return mitsuba


def llvm_version() -> str:
    """Of the LLVM that compiles Mitsuba's kernels; ``ValueError`` as from :func:`load_mitsuba`."""
    load_mitsuba()
    import drjit

    return ".".join(map(str, drjit.detail.llvm_version()))
