"""The manifest of the rendered recordings: how they were made, and whether every file is still what it was."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Any

from occlib.base.files import file_hashes, load_json, read_yaml, write_file
from occlib.recordings import LAB, lab_recordings


def write_manifest(lab_dir: str | Path = LAB, *, spp: int = 6, llvm: str | None = None) -> Path:
    """Write ``manifest.json``: size and SHA-256 of every file of a folder of rendered recordings, and how they were made.

    Call it where they were rendered: it records the versions that are installed; ``llvm`` is what
    ``drjit.detail.llvm_version()`` said.
    """
    lab = Path(lab_dir)
    files = {name: {"bytes": (lab / name).stat().st_size, "sha256": value} for name, value in _hashes(lab).items()}
    made: dict[str, Any] = {"by": "occlib.lab.render", "variant": "llvm_ad_rgb", "spp": spp, "versions": {}}
    for package in ("mitsuba", "drjit", "pyoidn", "numpy", "opencv-python-headless", "scipy"):
        try:
            made["versions"][package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    if llvm:
        made["versions"]["llvm"] = llvm
    made["seeds"] = {p.parent.name: read_yaml(p).get("seed", 0) for p in sorted(lab.glob("*/scene.yaml"))}
    content = {"made": made, "bytes": sum((lab / name).stat().st_size for name in files), "files": files}
    return write_file(lab / "manifest.json", json.dumps(content, indent=1) + "\n")


def verify_manifest(lab_dir: str | Path = LAB) -> list[str]:
    """What differs from the manifest, one line a file; an empty list if nothing does."""
    lab = Path(lab_dir)
    if not lab.is_dir():
        raise ValueError(f"{lab}: no such folder ({lab_recordings()})")
    try:
        expected = {name: entry["sha256"] for name, entry in load_json(lab / "manifest.json")["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return [f"manifest.json: cannot be read ({error})"]
    present = _hashes(lab)
    problems = [f"{name}: missing" for name in expected if name not in present]
    problems += [f"{name}: not in the manifest" for name in present if name not in expected]
    problems += [f"{name}: changed" for name in present if present[name] != expected.get(name, present[name])]
    return sorted(problems)


def _hashes(lab: Path) -> dict[str, str]:
    """SHA-256 of each file that the manifest vouches for: not itself, and no download that was cut off."""
    return {n: v for n, v in file_hashes(lab).items() if n != "manifest.json" and not n.endswith(".part")}
