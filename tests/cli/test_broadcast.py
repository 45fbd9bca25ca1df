"""``occlib broadcast`` and ``occlib listen``: processes of their own, interrupted as a terminal or a service does."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.broadcasts import FLOOR, GRID, THINGS
from helpers.commands import fails
from occlib.cli import main
from occlib.live.broadcast import Publisher

pytestmark = pytest.mark.slow


@contextmanager
def broadcasting(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """``occlib broadcast`` in a process of its own, and where it publishes."""
    command = [sys.executable, "-m", "occlib.cli", "broadcast", "--address", "tcp://127.0.0.1:*", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout and process.stderr
    try:
        first = process.stderr.readline()
        assert first.startswith("publishing at tcp://127.0.0.1:"), first + process.stderr.read()
        yield process, first.split()[-1]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def stopped(process: subprocess.Popen[str], how: signal.Signals) -> str:
    """What a command that is interrupted says last; it must leave in peace."""
    process.send_signal(how)
    assert process.wait(5) == 0
    assert process.stdout and process.stderr
    assert process.stderr.read() == ""
    (line,) = process.stdout.read().splitlines()
    return line


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_broadcast_and_listen(
    how: signal.Signals, tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with broadcasting(tiny_recording, "--loop") as (process, address):
        assert main(["listen", address, "--count", "3", "--timeout", "5", "--json", "--maps"]) == 0
        said = capsys.readouterr()
        assert said.err.splitlines() == [f"listening to {address}", "3 maps received, 0 missed, 0 rejected"]
        lines = [json.loads(line) for line in said.out.splitlines()]
        assert [line["sequence"] for line in lines] == [lines[0]["sequence"] + i for i in range(3)]
        for line in lines:
            assert line["t_capture"] <= line["t_sent"] <= time.time()
            assert 0 < line["latency_ms"] < 5000
            assert len(line["objects"]) == 2 and list(line["objects"][0])[:3] == ["id", "x", "y"]
            grid = np.array(line["map"].pop("data")).reshape(60, 80)
            counts = {
                name: int((grid == value).sum()) for name, value in (("free", 0), ("occupied", 100), ("unknown", -1))
            }
            assert line["map"] == {
                "width": 80,
                "height": 60,
                "resolution": 0.05,
                "origin": [0.0, 0.0],
                "counts": counts,
            }
            assert counts["occupied"] > 100
        plot = tmp_path / "map.png"
        assert main(["listen", address, "--count", "2", "--timeout", "5", "--plot", str(plot)]) == 0
        assert cv2.imread(str(plot)) is not None
        assert [line.split()[3:5] for line in capsys.readouterr().out.splitlines()] == [["2", "objects"]] * 2
        assert re.match(r"\d+ maps published; frames dropped: \d+ of left, \d+ of right$", stopped(process, how))
    assert main(["listen", address, "--count", "1", "--timeout", "0.1"]) == 1
    assert capsys.readouterr().err.endswith("\n0 maps received, 0 missed, 0 rejected\n")


def test_listen_tells_what_is_not_seen_now(capsys: pytest.CaptureFixture[str]) -> None:
    with Publisher() as publisher:
        publisher.send(GRID, FLOOR, THINGS[:1], 1.0, THINGS[1:])
        assert main(["listen", publisher.address, "--count", "1", "--timeout", "5"]) == 0
        assert capsys.readouterr().out.endswith("1 objects  1 (0.50, 1.00); not seen now:  2 (0.50, 1.00)\n")
        assert main(["listen", publisher.address, "--count", "1", "--timeout", "5", "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert [[each["id"] for each in said[name]] for name in ("objects", "coasting")] == [[1], [2]]
        publisher.send(GRID, FLOOR, THINGS, 2.0)
        assert main(["listen", publisher.address, "--count", "1", "--timeout", "5", "--json"]) == 0
        assert "coasting" not in json.loads(capsys.readouterr().out)


def test_listen_is_interrupted(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "occlib.cli", "listen", f"ipc://{tmp_path}/nobody"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr and process.stdout
    try:
        assert process.stderr.readline() == f"listening to ipc://{tmp_path}/nobody\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(5) == 0
        assert (process.stdout.read(), process.stderr.read()) == ("", "0 maps received, 0 missed, 0 rejected\n")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def test_in_a_background_job_of_a_script_it_is_kill_that_ends(tmp_path: Path) -> None:
    """A shell without a terminal has its background jobs ignore SIGINT, and ``nohup`` has them ignore SIGHUP."""
    ignoring = "import signal, os, sys; [signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGHUP)]; "
    command = [sys.executable, "-c", ignoring + "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"]
    command += ["-m", "occlib.cli", "listen", f"ipc://{tmp_path}/nobody"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr and process.stdout
    try:
        assert process.stderr.readline() == f"listening to ipc://{tmp_path}/nobody\n"
        for ignored in (signal.SIGINT, signal.SIGHUP):
            process.send_signal(ignored)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.5)
        process.send_signal(signal.SIGTERM)
        assert process.wait(5) == 0
        assert (process.stdout.read(), process.stderr.read()) == ("", "0 maps received, 0 missed, 0 rejected\n")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def test_broadcast_of_live_cameras(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    videos = []
    for name in ("left", "right"):
        videos.append(str(tmp_path / f"{name}.avi"))
        writer = cv2.VideoWriter(videos[-1], cv2.VideoWriter.fourcc(*"MJPG"), 10, (160, 120))
        if not writer.isOpened():
            pytest.skip("this OpenCV cannot write MJPG")
        for frame in [0] * 14 + [0, 1, 2, 3, 4] + [4] * 4:
            writer.write(cv2.imread(str(tiny_recording / f"frames/{name}/{frame:04d}.png")))
        writer.release()
    rig = ["--rig", tiny_recording / "rig.yaml", "--background", tiny_recording / "background"]
    with broadcasting("--device", *videos, *rig) as (process, address):
        assert main(["listen", address, "--count", "2", "--timeout", "5", "--json"]) == 0
        for line in capsys.readouterr().out.splitlines():
            assert len(json.loads(line)["objects"]) == 2
        assert process.wait(8) == 0
        assert process.stdout
        said = process.stdout.read()
        assert re.match(
            r"\d+ maps published; frames dropped: \d+ of left, \d+ of right, skew at most \d+\.\d ms\n$", said
        )


def test_cameras_that_fail_are_named(
    tiny_recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Broken:
        def __init__(self, device: str, *, size: tuple[int, int]) -> None:
            assert (device, size) == ("0", (160, 120))

        def read(self) -> None:
            raise RuntimeError("the driver fell over")

        def release(self) -> None:
            pass

    monkeypatch.setattr("occlib.live.capture.Device", Broken)
    rig = ["--rig", str(tiny_recording / "rig.yaml"), "--background", str(tiny_recording / "background")]
    assert main(["broadcast", "--device", "0", "0", "--address", "tcp://127.0.0.1:*", *rig]) == 0
    said = capsys.readouterr()
    assert said.out == "0 maps published; frames dropped: 0 of left, 0 of right, skew at most 0.0 ms\n"
    for name in ("left", "right"):
        assert f"occlib broadcast: warning: {name}: RuntimeError: the driver fell over\n" in said.err


def test_keys_and_their_use(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("server", "robot"):
        assert main(["broadcast", "keygen", name, "--out", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out.splitlines()[1] == f"{tmp_path / name / name}.key_secret: secret"
    secret, public = tmp_path / "server/server.key_secret", tmp_path / "server/server.key"
    with broadcasting(tiny_recording, "--loop", "--keys", secret, "--allow", tmp_path / "robot") as (_, address):
        keys = ["--keys", str(tmp_path / "robot/robot.key_secret"), "--server-key", str(public)]
        assert main(["listen", address, "--count", "1", "--timeout", "5", *keys]) == 0
        assert main(["listen", address, "--count", "1", "--timeout", "0.3"]) == 1
    assert "is not overwritten" in fails(capsys, "broadcast", "keygen", "robot", "--out", tmp_path / "robot")
    assert fails(capsys, "broadcast", "keygen").startswith("keygen: expected a name")


def test_wrong_broadcasts(tiny_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = ("--rig", tiny_recording / "rig.yaml", "--background", tiny_recording / "background")
    cases: list[tuple[list[object], str]] = [
        (["nowhere"], "nowhere: no such recording folder"),
        ([], "expected either a recording, or --device"),
        ([tiny_recording, "x"], "expected either a recording, or --device"),
        ([tiny_recording, "--device", "97"], "expected either a recording, or --device"),
        ([tiny_recording, "--rate", "-1"], "rate: expected instants a second >= 0, got -1.0"),
        ([tiny_recording, "--rule", "x"], "rule: expected one of"),
        ([tiny_recording, "--address", "tcp://0.0.0.0:*"], "address: expected 127.0.0.1 without keys"),
        ([tiny_recording, "--keys", tmp_path / "no"], "keys, allowed (--keys, --allow): expected both or neither"),
        (
            [tiny_recording, "--keys", tmp_path / "no", "--allow", tiny_recording],
            "allowed: expected at least one public key",
        ),
        (["--device", "97", "98"], "--device: expected --rig and --background"),
        (["--device", "97", *rig], "--device: expected one for each of left, right, got 1"),
        (["--device", "97", "98", *rig], "device 97: cannot be opened"),
        (["--device", "97", "98", *rig[:3], tmp_path], f"--background: {tmp_path} has no pictures of left, right"),
    ]
    for arguments, said in cases:
        assert fails(capsys, "broadcast", *arguments).startswith(said), arguments
    with Publisher() as publisher:
        error = fails(capsys, "broadcast", tiny_recording, "--address", publisher.address)
        assert error.startswith("address: cannot publish at") and "in use" in error
    assert fails(capsys, "listen", "here").startswith("address: expected tcp://HOST:PORT")
    assert fails(capsys, "listen", "--plot", "map.jpg").startswith("--plot: expected a file name that ends in .png")
    assert fails(capsys, "listen", "--count", "0").startswith("--count: expected a number > 0")
    assert fails(capsys, "listen", "--timeout", "nan").startswith("--timeout: expected seconds > 0")
