"""The command line as a whole: help, wrong usage, pipes, and commands without a file of their own here."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from typing import Any

import pytest

from helpers.commands import fails
from occlib import __version__
from occlib.base.checks import Notice
from occlib.cli import build_parser, main
from occlib.cli.commands import _notices


def commands() -> list[str]:
    return list(next(a for a in build_parser()._actions if isinstance(a.choices, dict)).choices)  # type: ignore[arg-type]


@pytest.mark.parametrize("command", [[], *([name] for name in commands())])
def test_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main([*command, "--help"])
    assert leave.value.code == 0
    assert capsys.readouterr().out.startswith(" ".join(["usage: occlib", *command]))


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(["--version"])
    assert leave.value.code == 0
    assert capsys.readouterr().out == f"occlib {__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["fly"], ["run"], ["run", "x"], ["evaluate", "x"], ["run", "x", "--out"]])
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main(arguments)
    assert leave.value.code == 2
    assert "occlib" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.slow
def test_a_reader_that_leaves_is_no_error() -> None:
    command = [
        sys.executable,
        "-c",
        "import sys; from occlib.cli import main; input(); sys.exit(main(['data', 'list']))",
    ]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdin and process.stdout and process.stderr
        process.stdout.close()
        process.stdin.write("\n")
        process.stdin.close()
        assert process.stderr.read() == ""
        assert process.wait(30) == 141


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["data", "fetch"], "data fetch: expected a name, one of ufes-lab, opencv-checkerboard"),
        (["data", "fetch", "nothing"], "nothing: not a public recording; there are ufes-lab, opencv-checkerboard"),
        (["render", "nothing"], "nothing: no such scene"),
        (["reproduce", "nothing"], "notebook 'nothing': expected one of|no notebook"),
    ],
)
def test_other_commands_say_what_is_wrong(
    capfd: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert re.search(message, fails(capfd, *arguments))


def test_a_notice_is_one_line_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    with _notices("run"):
        for text in ("a is short", "b is short", "a is short"):
            warnings.warn(text, Notice, stacklevel=1)
        with pytest.raises(UserWarning, match="another"):  # an error in tests, as outside
            warnings.warn("another", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == "occlib run: warning: a is short\nocclib run: warning: b is short\n"
    with pytest.raises(Notice):
        warnings.warn("later", Notice, stacklevel=1)


def test_data_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "list"]) == 0
    names = [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()]
    assert {"ufes-lab", "opencv-checkerboard"} <= set(names)
