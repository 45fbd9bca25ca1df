"""What the broadcast costs: from the picture to the map in another process, as a ratio to the pipeline's own time; and, with
``--soak``, 100,000 maps to listeners that are killed and started again: longest send, memory, and every gap accounted for.

Run ``python tests/bench_broadcast.py [--soak [N]]``. Not a test: timings belong to a machine, ratios to a table.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, cycle

import cv2
import numpy as np
import pandas as pd
import psutil
from tqdm import tqdm

from occlib.live.broadcast import Listener, Publisher
from occlib.live.messages import encode
from occlib.pipeline import Pipeline, backgrounds_of
from occlib.recordings import open_recording

FRAMES = range(40, 64)
"""Of four_robots: all four drive, some hidden, played forwards and backwards so that nothing jumps."""
COUNT = 300
WARM_UP = 10
SOAK = 100_000
PAUSES = (0.0, 0.0, 0.0, 0.005)
"""What each listener of the soak does between two maps, s: the last is too slow for most of them."""


# --- the other process -----------------------------------------------------------------------------------
def receive(address: str, pause: float) -> None:
    """Print for every map: number, latency in ms, first number, received, missed, mistakes."""
    first, last, mistakes = 0, 0, 0
    with Listener(address, timeout_s=60) as listener:
        print("ready", flush=True)
        for message in listener:
            latency = 1e3 * (time.time() - message.t_capture)
            first = first or message.sequence
            mistakes += message.sequence <= last
            mistakes += listener.received + listener.missed != message.sequence - first + 1
            last = message.sequence
            print(json.dumps([last, latency, first, listener.received, listener.missed, mistakes]), flush=True)
            time.sleep(pause)


class Child:
    """A process that listens, and writes to a file without a name."""

    def __init__(self, address: str, pause: float) -> None:
        self.output = tempfile.TemporaryFile("w+")
        command = [sys.executable, __file__, "--receive", address, str(pause)]
        self.process = subprocess.Popen(command, stdout=self.output)

    def ready(self) -> None:
        """Wait until it listens."""
        while os.fstat(self.output.fileno()).st_size < 6 and self.process.poll() is None:
            time.sleep(0.01)

    def rows(self, end: int = 1 << 40) -> list[list[float]]:
        """Kill it; what it wrote, or only what is in so many bytes at the end."""
        self.process.kill()
        self.process.wait()
        if self.output.closed:
            return []
        with self.output:
            self.output.seek(max(os.fstat(self.output.fileno()).st_size - end, 0))
            return [json.loads(line) for line in self.output if line.startswith("[") and line.endswith("]\n")]


@contextmanager
def listening(address: str, pauses: Sequence[float]) -> Iterator[list[Child]]:
    """Processes that listen, and are killed at the end."""
    children: list[Child] = []
    try:
        children.extend(Child(address, pause) for pause in pauses)
        for child in children:
            child.ready()
        yield children
    finally:
        for child in children:
            child.rows()


# --- latency ---------------------------------------------------------------------------------------------
def latency(rate: float) -> tuple[list[float], list[float], list[float]]:
    """Of each map the pipeline's time, the time of the send and that from capture to received, ms."""
    recording = open_recording("four_robots", ["left", "right"])
    instants = [images for _, images in recording.images(FRAMES)]
    shown = cycle(chain(instants, instants[-2:0:-1]))
    pipeline, own, sends = Pipeline(recording.rig, backgrounds_of(recording)), [], []
    with Publisher() as publisher, listening(publisher.address, [0.0]) as (child,):
        due = time.perf_counter()
        for i in range(COUNT + WARM_UP):
            due += 1 / rate if rate else 0.0
            time.sleep(max(due - time.perf_counter(), 0.0))
            images, taken, begun = next(shown), time.time(), time.perf_counter()
            result = pipeline.process(images, i / 10)
            done = time.perf_counter()
            publisher.send(result.map.data, recording.rig.floor, [o.to_dict() for o in result.objects], taken)
            own.append(1e3 * (done - begun))
            sends.append(1e3 * (time.perf_counter() - done))
        time.sleep(0.5)
        received = {row[0]: row[1] for row in child.rows()}
    if lost := set(range(WARM_UP + 1, COUNT + WARM_UP + 1)) - set(received):
        print(f"{len(lost)} maps did not arrive", file=sys.stderr)
    arrived = [latency for number, latency in received.items() if number > WARM_UP]
    return own[WARM_UP:], sends[WARM_UP:], arrived


def latencies() -> None:
    """Print the table of capture to received against the pipeline's own time."""
    rows = {}
    for name, rate in (("at 10 Hz", 10.0), ("without a pause", 0.0)):
        own, sends, arrived = latency(rate)
        pipeline, received = float(np.median(own)), float(np.median(arrived))
        rows[name] = {
            "pipeline (ms)": pipeline,
            "send (ms)": float(np.median(sends)),
            "capture to received (ms)": received,
            "ratio": received / pipeline,
            "at most 1.5 x + 3 ms": 1.5 * pipeline + 3,
        }
    print(f"A VGA pair of four_robots, {COUNT} maps of 400 x 300 cells to another process, medians")
    print(pd.DataFrame(rows).T.round(3).to_string())


# --- soak ------------------------------------------------------------------------------------------------
def soak(count: int) -> None:
    """Send maps without a pause to four listeners of which one is killed and replaced every 5 %."""
    rng = np.random.default_rng(0)
    recording = open_recording("four_robots", ["left", "right"])
    floor = recording.rig.floor
    grid = rng.choice([-1, 0, 100], floor.shape).astype(np.int8)
    thing = {"id": 1, "x": 0.5, "y": 1.0, "vx": 0.1, "vy": 0.0, "area": 0.04, "colour": [9, 9, 9], "label": None}
    objects = [{**thing, "id": i, "hidden_in": ["left"]} for i in range(4)]
    times, idle, memory, reports = np.full(count, 0.0), np.full(count, 0.0), [], list[list[float]]()
    killed = 0

    with Publisher() as publisher, listening(publisher.address, PAUSES) as children:
        for i in tqdm(range(count), unit="map", disable=None):
            begun = time.perf_counter()
            message = publisher.send(grid, floor, objects, time.time())
            sent = time.perf_counter()
            encode(message)  # as long a piece of work without a socket: how long the machine itself makes one wait
            times[i], idle[i] = sent - begun, time.perf_counter() - sent
            if i % (count // 20) == count // 40:
                which = int(rng.integers(len(children)))
                reports.extend(children[which].rows(400)[-1:])
                children[which] = Child(publisher.address, PAUSES[which])
                killed += 1
            if i % (count // 100) == 0:
                memory.append(psutil.Process().memory_info().rss / 2**20)
        time.sleep(1)
        for child in children:
            reports.extend(child.rows(400)[-1:])
    warm = memory[len(memory) // 10 :]
    received, missed = (int(sum(row[k] for row in reports)) for k in (3, 4))
    span = int(sum(row[0] - row[2] + 1 for row in reports))
    print(f"\n{count} maps of {grid.shape[1]} x {grid.shape[0]} cells, {killed} listeners killed and started again")
    print(f"send: median {1e3 * np.median(times):.3f} ms, 99.9 % {1e3 * np.quantile(times, 0.999):.2f} ms, ", end="")
    print(f"longest {1e3 * times.max():.2f} ms; longest encode, which has no socket: {1e3 * idle.max():.2f} ms")
    print(
        f"memory: {warm[0]:.1f} MB when warm, at most {max(warm) - warm[0]:.2f} MB more, {warm[-1] - warm[0]:.2f} at the end"
    )
    print(
        f"{len(reports)} listeners: received {received} + missed {missed} = {received + missed}, range spanned {span}"
    )
    print(f"twice, out of order or miscounted: {int(sum(row[5] for row in reports))}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--soak", nargs="?", type=int, const=SOAK, metavar="N", help=f"send N maps ({SOAK})")
    parser.add_argument("--receive", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.receive:
        receive(args.receive[0], float(args.receive[1]))
        return
    cv2.setNumThreads(1)
    soak(args.soak) if args.soak else latencies()


if __name__ == "__main__":
    main()
