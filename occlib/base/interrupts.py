"""What signals do to long work: end it as Ctrl-C does, or wait until files are in place."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM and SIGHUP (``timeout``, a closing terminal) end the work as Ctrl-C does.

    What the parent process has told us to ignore stays ignored, as everywhere: SIGHUP under ``nohup``, SIGINT in a
    script's background job. SIGTERM always ends the work.
    """
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    ignored = hangup is not None and signal.getsignal(hangup) == signal.SIG_IGN
    with _handling(signal.default_int_handler, "SIGTERM", *([] if ignored else ["SIGHUP"])):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let nothing but ``kill -9`` stop what must not be left half-done."""
    with _handling(signal.SIG_IGN, "SIGINT", "SIGTERM", "SIGHUP"):
        yield


@contextmanager
def _handling(handler: Any, *signals: str) -> Iterator[None]:
    names = set(signals) & set(dir(signal))
    if threading.current_thread() is not threading.main_thread():
        names = set()
    previous = {name: signal.signal(getattr(signal, name), handler) for name in names}
    try:
        yield
    finally:
        for name, previous_handler in previous.items():
            signal.signal(getattr(signal, name), previous_handler)
