"""Continuous integration does what a reader does: it calls make, and each target that it calls is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def test_there_are_two() -> None:
    assert [path.name for path in WORKFLOWS] == ["book.yml", "tests.yml"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_only_calls_make(path: Path) -> None:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert content["permissions"] == {"contents": "read"}
    for job in content["jobs"].values():
        commands = [step["run"] for step in job["steps"] if "run" in step]
        assert commands and job["timeout-minutes"]
        for command in commands:
            assert re.fullmatch(r"make ([a-z-]+)", command) and command.split()[1] in TARGETS, command


def test_commit_hooks_are_what_lint_runs() -> None:
    """Each hook's tool is called by ``make lint``, too."""
    lint = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    assert lint and len(hooks) >= 5
    for hook in hooks:
        assert f"$(BIN)/{Path(hook['entry'].split()[0]).name}" in lint[1], hook["id"]
