"""DOC"""

from __future__ import annotations

import hashlib
import json
from importlib import metadata
from pathlib import Path
from typing import Any

from occlib.base.files import read_yaml, write_file
from occlib.recordings import LAB, lab_recordings


def write_manifest(lab_dir: str | Path = LAB, *, spp: int = 6, llvm: str | None = None) -> Path:
    """Write ``manifest.json``: size and SHA-256 of every file of the lab, and how it was made.

    Call it where the lab was rendered: it records the versions that are installed; ``llvm`` is what
    ``drjit.detail.llvm_version()`` said.
    """
    lab = Path(lab_dir)
    files = {str(p.relative_to(lab).as_posix()): _fingerprint(p) for p in _lab_files(lab)}
    how: dict[str, Any] = {"by": "occlib.lab.render", "variant": "llvm_ad_rgb", "spp": spp, "versions": {}}
    for package in ("mitsuba", "drjit", "pyoidn", "numpy", "opencv-python-headless", "scipy"):
        try:
            how["versions"][package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    if llvm:
        how["versions"]["llvm"] = llvm
    how["seeds"] = {p.parent.name: read_yaml(p).get("seed", 0) for p in sorted(lab.glob("*/scene.yaml"))}
    content = {"made": how, "bytes": sum(f["bytes"] for f in files.values()), "files": files}
    write_file(lab / "manifest.json", (json.dumps(content, indent=1) + "\n").encode())
    return lab / "manifest.json"


def verify_manifest(lab_dir: str | Path = LAB) -> list[str]:
    """What differs from the manifest, one line a file; an empty list if nothing does."""
    lab = Path(lab_dir)
    if not lab.is_dir():
        raise ValueError(f"{lab}: no such folder ({lab_recordings()})")
    try:
        expected = json.loads((lab / "manifest.json").read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return [f"manifest.json: cannot be read ({error})"]
    present = {str(p.relative_to(lab).as_posix()): p for p in _lab_files(lab)}
    problems = [f"{name}: missing" for name in expected if name not in present]
    problems += [f"{name}: not in the manifest" for name in present if name not in expected]
    problems += [f"{n}: changed" for n, p in present.items() if n in expected and _fingerprint(p) != expected[n]]
    return sorted(problems)


def _lab_files(lab: Path) -> list[Path]:
    return sorted(p for p in lab.rglob("*") if p.is_file() and p.name != "manifest.json" and p.suffix != ".part")


def _fingerprint(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
