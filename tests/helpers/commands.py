"""Commands run in this process: their results, or the one line that says what is wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlib.cli import main

Array = np.ndarray[Any, Any]
RESULTS = ("objects.jsonl", "map.pgm", "map.yaml", "overview.png")


def error_lines(capture: pytest.CaptureFixture[str]) -> list[str]:
    """What a command said on stderr, progress bars aside."""
    lines = re.split(r"[\r\n]+", capture.readouterr().err)
    return [line for line in lines if line.strip() and not re.search(r"\d+%\||frame/s|file/s", line)]


def fails(capture: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on stderr of a command that must fail, without its ``occlib COMMAND: ``."""
    capture.readouterr()
    assert main([str(a) for a in arguments]) not in (0, None)
    lines = error_lines(capture)
    assert len(lines) == 1, lines
    start = f"occlib {arguments[0]}: "
    assert lines[0].startswith(start)
    assert len(lines[0]) < 400
    assert not re.search("Traceback|Errno", lines[0])
    return lines[0].removeprefix(start)


def run(recording: Path, out: Path, *options: object) -> list[dict[str, Any]]:
    """``occlib run`` that must succeed: the lines of objects.jsonl."""
    assert main(["run", str(recording), "--out", str(out), *map(str, options)]) == 0
    return [json.loads(line) for line in (out / "objects.jsonl").read_text(encoding="utf-8").splitlines()]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
