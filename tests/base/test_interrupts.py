"""What signals do to a piece of work, in this process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import pytest

from occlib.base.interrupts import stoppable, uninterrupted

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows has no such signals")
HANDLERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def as_in_a_terminal() -> Iterator[None]:
    """Nothing is ignored at first, whatever this run of tests was started from."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in HANDLERS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", HANDLERS)
def test_work_is_ended_as_by_ctrl_c(number: signal.Signals) -> None:
    before = [signal.getsignal(each) for each in HANDLERS]
    with pytest.raises(KeyboardInterrupt), stoppable():
        signal.raise_signal(number)
    assert [signal.getsignal(each) for each in HANDLERS] == before


def test_what_the_parent_ignores_stays_ignored_but_for_a_kill() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with pytest.raises(KeyboardInterrupt), stoppable():
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGINT)
        reached = True
        signal.raise_signal(signal.SIGTERM)
    assert reached
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


def test_nothing_stops_what_must_not_be_left_half_done() -> None:
    before = [signal.getsignal(each) for each in HANDLERS]
    with uninterrupted():
        for number in HANDLERS:
            signal.raise_signal(number)
    assert [signal.getsignal(each) for each in HANDLERS] == before


def test_a_thread_leaves_the_handlers_of_the_process_alone() -> None:
    seen = []

    def work() -> None:
        with stoppable(), uninterrupted():
            seen.extend(signal.getsignal(each) for each in HANDLERS)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler] * 3
