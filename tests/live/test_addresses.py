"""Addresses: what leaves the machine needs keys, and what is no address is named."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from helpers.broadcasts import SOON, send
from occlib.live.broadcast import Listener, Publisher

OUTSIDE = ["tcp://*:*", "tcp://0.0.0.0:*", "tcp://[::]:*", "tcp://192.168.1.2:*", "tcp://example.org:*", "tcp://eth0:*"]


@pytest.mark.parametrize("address", [*OUTSIDE, "tcp://[::ffff:0.0.0.0]:*", "tcp://127.1:*", "tcp://127.0.0.1.nip.io:*"])
def test_nothing_leaves_the_machine_without_keys(address: str) -> None:
    with pytest.raises(ValueError, match=r"address: expected 127.0.0.1 without keys; .* needs keys and allowed"):
        Publisher(address)
    if "*" not in address[:-1]:
        with pytest.raises(ValueError, match=r"address: expected 127.0.0.1 without keys; .* needs keys and server_key"):
            Listener(address.replace(":*", ":5599"))


def test_with_keys_the_machine_may_be_left(keys: Path) -> None:
    with Publisher("tcp://*:*", keys=keys / "server.key_secret", allowed=keys / "allowed") as publisher:
        sent, port = send(publisher), publisher.address.rpartition(":")[2]
        good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
        with Listener(f"tcp://localhost:{port}", **good) as listener:  # type: ignore[arg-type]
            assert listener.receive(SOON) == sent


@pytest.mark.parametrize("address", ["tcp://localhost:*", "tcp://127.3.2.1:*", "tcp://[::1]:*", "ipc://{}/socket"])
def test_local_addresses(address: str, tmp_path: Path) -> None:
    if "[" in address:
        with socket.socket(socket.AF_INET6) as probe:
            try:
                probe.bind(("::1", 0))
            except OSError:
                pytest.skip("no IPv6 here")
    with Publisher(address.format(tmp_path)) as publisher, Listener(publisher.address) as listener:
        assert send(publisher) == listener.receive(SOON)


@pytest.mark.parametrize(
    "address", ["", "here", "tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:x", "tcp://127.0.0.1:65536", "udp://127.0.0.1:1",
                "inproc://x", "tcp://127.0.0.1:1;tcp://0.0.0.0:1", "tcp://127.0.0.1:1\n", "tcp://user@host:1", "ipc://"]
)  # fmt: skip
def test_wrong_addresses(address: str) -> None:
    for kind in (Publisher, Listener):
        with pytest.raises(ValueError, match=r"address: expected tcp://HOST:PORT or ipc://FILE, got"):
            kind(address)


def test_addresses_that_do_not_work(keys: Path) -> None:
    with (
        Publisher() as publisher,
        pytest.raises(ValueError, match=r"address: cannot publish at .* \(Address .*in use\)"),
    ):
        Publisher(publisher.address)
    with pytest.raises(ValueError, match=r"address: expected tcp://HOST:PORT"):
        Listener("tcp://127.0.0.1:*")
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with pytest.raises(ValueError, match=r"address: unknown host 'nobody.invalid'"):
        Listener("tcp://nobody.invalid:5599", **good)  # type: ignore[arg-type]
