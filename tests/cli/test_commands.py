"""The command line as a whole: commands are found, help is quick and true, and every way in is the same."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from occlib import cli
from occlib.cli import build_parser, commands, main
from occlib.cli.options import CommandParser, add_command
from occlib.cli.settings import add_settings, settings_of
from occlib.pipeline import PROFILES, settings_for
from occlib.settings import list_settings

SHARED = {"__init__", "__main__", "commands", "options", "settings"}


def help_of(*command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """``--help`` without white space: lines may break anywhere."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as leave:
        main([*command, "--help"])
    assert leave.value.code == 0
    return "".join(capsys.readouterr().out.split())


def test_every_module_is_a_command() -> None:
    modules = {path.stem for path in Path(cli.__file__).parent.glob("*.py")} - SHARED
    assert sorted(modules) == sorted(commands.COMMANDS)


def test_a_command_is_one_module_and_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = ModuleType("occlib.cli.fly")

    def fly(args: argparse.Namespace) -> int:
        print(f"{args.height} m")
        return 3

    def add(all_commands: commands.argparse._SubParsersAction[CommandParser]) -> None:
        add_command(all_commands, "fly", "Take off.", fly).add_argument("height", type=int)

    module.add = add  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "occlib.cli.fly", module)
    monkeypatch.setattr(commands, "COMMANDS", (*commands.COMMANDS, "fly"))
    assert "flyTakeoff." in help_of(capsys=capsys)
    assert main(["fly", "7"]) == 3
    assert capsys.readouterr().out == "7 m\n"


def test_help_imports_nothing_slow() -> None:
    code = (
        "import sys\n"
        "from occlib.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n    pass\n"
        "slow = [n for n in ('numpy', 'cv2', 'numba', 'pandas', 'matplotlib', 'scipy', 'zmq') if n in sys.modules]\n"
        "print(slow, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"
    assert done.stdout.startswith("usage: occlib ")


@pytest.mark.slow
def test_python_m_is_the_same_command() -> None:
    run = [sys.executable, "-m", "occlib.cli"]
    done = subprocess.run([*run, "data", "list"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("ufes-lab: ")
    done = subprocess.run([*run, "render", "nothing"], capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("occlib render: nothing: no such scene")


def test_help_lists_what_there_is(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROFILES, "night", PROFILES["and"])
    for command in ("run", "broadcast"):
        assert "--profileNAMErecommended(default),and,paper,night" in help_of(command, capsys=capsys)
    assert "trinary(default),scale,raw" in help_of("run", capsys=capsys)
    assert "mcap,ros2,ros1" in help_of("run", capsys=capsys)
    said = help_of("compare", capsys=capsys)
    assert "ssd,sad,ncc,zncc,sed;allbydefault" in said
    assert "0isbestforssd,sad,sed;1forncc,zncc." in said
    assert "otsu,madorascore" in said and "components(default),nms" in said
    assert "gain,offset,gradient,noise," in help_of("sweep", capsys=capsys)
    assert "ufes-lab,opencv-checkerboard" in help_of("data", capsys=capsys)


def test_help_does_without_an_extra(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "occlib.study", None)
    assert "--conditionsNAME[NAME...]allbydefault" in help_of("sweep", capsys=capsys)


@pytest.mark.parametrize("command", [["run", "recording", "--out", "out"], ["broadcast", "recording"]])
def test_options_become_settings(command: list[str]) -> None:
    parse = build_parser().parse_args
    assert settings_of(parse(command)) == PROFILES["recommended"]
    chosen = parse([*command, "--profile", "and", "--rule", "or", "--threshold", "1e2"])
    assert settings_of(chosen) == settings_for("and", rule="or", threshold=100.0)
    assert settings_of(parse([*command, "--threshold", "triangle"])) == settings_for(threshold="triangle")


def test_settings_can_be_added_to_any_command() -> None:
    parser = CommandParser()
    add_settings(parser)
    assert settings_of(parser.parse_args(["--profile", "paper"])) == PROFILES["paper"]


def test_settings_are_set_by_name_and_listed_with_their_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    parse = build_parser().parse_args
    chosen = parse(["run", "x", "--out", "y", "--set", "finder.cost=0.2", "--set", "confirm_s=0"])
    assert settings_of(chosen) == settings_for(**{"finder.cost": 0.2, "tracker.confirm_s": 0.0})
    for wrong in ("finder.cost", "=2", "finder.cost=", "rule=and"):
        with pytest.raises(ValueError, match=f"--set: expected NAME=VALUE, as in finder.cost=0.2, got '{wrong}'"):
            settings_of(parse(["run", "x", "--out", "y", "--set", wrong]))
    for profile in PROFILES:
        with pytest.raises(SystemExit) as leave:
            main(["run", "--profile", profile, "--help-settings"])
        assert leave.value.code == 0
        listed = capsys.readouterr().out
        for name in list_settings(PROFILES[profile]):
            assert f"\n{name}=" in listed
        lines = listed.splitlines()
        assert all(
            lines[i + 1].startswith("    ") for i, line in enumerate(lines) if "=" in line and line[0] not in " p"
        )
