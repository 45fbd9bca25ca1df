"""What other programs are built on: import paths, signatures, commands and their options. None changes silently."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import occlib.matching
import occlib.occlusion
import occlib.pipeline
from occlib.cli import build_parser, main

ROOT = Path(__file__).resolve().parents[1]
NO_DEFAULT = inspect.Parameter.empty

SIGNATURES: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (
        occlib.matching.similarity,
        {"image": NO_DEFAULT, "template": NO_DEFAULT, "method": "ssd", "mask": None},
    ),
    (
        occlib.matching.find,
        {"image": NO_DEFAULT, "template": NO_DEFAULT, "method": "ssd", "threshold": None, "mask": None},
    ),
    (occlib.occlusion.fuse, {"evidence": NO_DEFAULT, "rule": "and"}),
    (occlib.pipeline.Pipeline, {"rig": NO_DEFAULT, "backgrounds": NO_DEFAULT, "settings": ...}),
    (occlib.pipeline.Pipeline.process, {"self": NO_DEFAULT, "images": NO_DEFAULT, "time": NO_DEFAULT}),
]
"""The positional parameters of the contract, in their order; ``...``: some default. More may follow, if they have one."""

COMMANDS: dict[str, tuple[list[str], list[str]]] = {
    "reproduce": (
        ["NOTEBOOK", "-p", "--fast", "--jobs", "--check"],
        ["00 11 -p seed 3 -p fast 1", "--jobs 2 --check --fast", ""],
    ),
    "run": (
        ["RECORDING", "--out", "--cameras", "--profile", "--rule", "--threshold", "--frames", "--maps"],
        [
            "robot --out DIR",
            "robot --out DIR --cameras A B --profile paper --rule and --threshold otsu --maps",
            "robot --out DIR --profile recommended --frames 40:149:4",
        ],
    ),
    "evaluate": (
        ["OBJECTS.jsonl", "TRUTH.json", "--roi", "--radius", "--json"],
        ["OBJECTS.jsonl TRUTH.json", "OBJECTS.jsonl TRUTH.json --roi NAME --radius 0.5 --json"],
    ),
    "compare": (
        ["IMAGE", "TEMPLATE", "--methods"],
        ["IMAGE TEMPLATE", "IMAGE TEMPLATE --methods ssd sad ncc zncc sed"],
    ),
    "calibrate": (
        ["IMAGE", "--pattern", "--square", "--out"],
        ["a.png b.png --pattern 9x6 --square 0.025", "a.png --pattern 9x6 --square 0.025 --out camera.yaml"],
    ),
    "sweep": ([], [""]),
    "broadcast": (["RECORDING"], ["robot"]),
    "listen": ([], [""]),
    "render": (["SCENE"], ["robot"]),
    "data": (["fetch"], ["fetch ufes-lab"]),
}
"""Of each command what its help must name, and lines that must be understood."""


@pytest.mark.parametrize(("function", "expected"), SIGNATURES, ids=[f.__qualname__ for f, _ in SIGNATURES])
def test_signature(function: Callable[..., Any], expected: dict[str, Any]) -> None:
    parameters = list(inspect.signature(function).parameters.values())
    assert [p.name for p in parameters[: len(expected)]] == list(expected)
    for parameter, default in zip(parameters, expected.values(), strict=False):
        assert parameter.kind == parameter.POSITIONAL_OR_KEYWORD
        assert (parameter.default is not NO_DEFAULT) if default is ... else (parameter.default == default), parameter
    assert all(parameter.default is not NO_DEFAULT for parameter in parameters[len(expected) :])


def test_methods_and_what_is_best() -> None:
    methods = occlib.matching.METHODS
    assert list(methods)[:5] == ["ssd", "sad", "ncc", "zncc", "sed"]
    assert [methods[name].higher_is_better for name in list(methods)[:5]] == [False, False, True, True, False]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_names_the_options(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leave:
        main([command, "--help"])
    assert leave.value.code == 0
    usage = capsys.readouterr().out.partition("\n\n")[0]
    words = set(re.split(r"[\s\[\]{},|]+", usage))
    assert usage.startswith(f"usage: occlib {command} ")
    assert set(COMMANDS[command][0]) - words == set()


@pytest.mark.parametrize(("command", "line"), [(name, line) for name, (_, lines) in COMMANDS.items() for line in lines])
def test_lines_are_understood(command: str, line: str) -> None:
    args = build_parser().parse_args([command, *line.split()])
    assert args.command == command
    given = [str(value) for value in vars(args).values()]
    for word in line.replace("-p seed 3 -p fast 1", "").split():
        assert word.startswith("-") or any(word in value for value in given), word


def test_every_command_is_listed_here() -> None:
    (commands,) = (set(action.choices) for action in build_parser()._actions if isinstance(action.choices, dict))
    assert commands == set(COMMANDS)


def test_an_error_is_one_line_and_not_zero(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "nowhere", "--out", "runs/nowhere"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("occlib run: ") and said.err.count("\n") == 1


def test_continuous_integration_runs_the_test_command_of_the_readme() -> None:
    lines = [line for line in (ROOT / ".ci/run").read_text().splitlines() if line and not line.startswith("#")]
    assert "make test" in lines
    assert re.search(r"^    make test\b", (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
