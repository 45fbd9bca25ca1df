"""Who is let in: garbage at the port, strangers, keys of one's own."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import time
from pathlib import Path

import numpy as np
import pytest
import zmq

from helpers.broadcasts import NEVER, SOON, fake, meet, message, send
from occlib.live.broadcast import Listener, Publisher, keygen
from occlib.live.messages import LAST, encode


# --- who is let in -------------------------------------------------------------------------------------
def attack(address: str) -> None:
    """10,000 pieces of garbage at a publisher's port, as bytes and as ZeroMQ messages of every kind that might get through."""
    rng, port = np.random.default_rng(5), int(address.rpartition(":")[2])
    greeting = b"\xff" + bytes(8) + b"\x7f\x03\x01NULL" + bytes(16) + bytes(32)
    with contextlib.ExitStack() as stack:
        kinds = (zmq.DEALER, zmq.PUB, zmq.SUB, zmq.XSUB)
        sockets = {kind: stack.enter_context(fake(kind, address, sndtimeo=0)) for kind in kinds}
        sockets[zmq.SUB].subscribe(b"")
        for i in range(2500):
            kind = kinds[i % 4]
            for _ in range(3):
                with contextlib.suppress(zmq.Again):
                    if kind == zmq.SUB:
                        sockets[kind].subscribe(rng.bytes(int(rng.integers(1, 2000))))
                    else:
                        start = (b"", b"\x00", b"\x01", b"\x01" + LAST)[int(rng.integers(4))]
                        sockets[kind].send(start + rng.bytes(int(rng.integers(0, 3000))))
            if i % 25 == 0:
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1) as raw:
                    raw.sendall(greeting if i % 50 else b"")
                    for _ in range(25):
                        raw.sendall(rng.bytes(int(rng.integers(1, 400))))


def test_garbage_at_the_port_is_ignored() -> None:
    with Publisher() as publisher, Listener(publisher.address) as listener:
        meet(publisher, listener)
        missed = listener.missed
        attack(publisher.address)
        for _ in range(3):
            assert send(publisher) == listener.receive(SOON)
        assert (listener.missed, listener.rejected) == (missed, 0)
        with Listener(publisher.address) as late:
            assert late.receive(SOON) is not None


def test_a_huge_subscription_is_cut_off() -> None:
    with Publisher() as publisher, fake(zmq.SUB, publisher.address) as bare:
        with bare.get_monitor_socket(zmq.EVENT_DISCONNECTED) as monitor:
            bare.subscribe(bytes(2000))
            assert monitor.poll(int(SOON * 1000))
            bare.disable_monitor()


def test_encrypted(keys: Path) -> None:
    secure = {"keys": keys / "server.key_secret", "allowed": keys / "allowed"}
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with contextlib.ExitStack() as stack:
        publisher = stack.enter_context(Publisher(**secure))  # type: ignore[arg-type]
        listener = stack.enter_context(Listener(publisher.address, **good))  # type: ignore[arg-type]
        meet(publisher, listener)
        missed = listener.missed
        outsiders = [
            Listener(publisher.address),
            Listener(publisher.address, keys=keys / "stranger.key_secret", server_key=keys / "server.key"),
            Listener(publisher.address, keys=keys / "good.key_secret", server_key=keys / "stranger.key"),
        ]
        for outsider in outsiders:
            stack.enter_context(outsider)
        attack(publisher.address)
        for _ in range(3):
            assert send(publisher) == listener.receive(SOON)
        end = time.monotonic() + 2 * NEVER
        while time.monotonic() < end:
            sent = send(publisher)
            assert listener.receive(SOON) == sent
            assert [outsider.receive(0.01) for outsider in outsiders] == [None, None, None]
        assert [(o.received, o.rejected, o.repeats) for o in outsiders] == [(0, 0, 0)] * 3
        assert (listener.missed, listener.rejected) == (missed, 0)
        late = stack.enter_context(Listener(publisher.address, **good))  # type: ignore[arg-type]
        assert late.receive(SOON) == sent


def test_a_listener_with_keys_believes_nobody_else(keys: Path) -> None:
    """Neither a publisher in clear, nor one with another key, at the address of the right one."""
    good = {"keys": keys / "good.key_secret", "server_key": keys / "server.key"}
    with fake(zmq.PUB, "tcp://127.0.0.1:*", bind=True) as bare:
        with Listener(bare.getsockopt_string(zmq.LAST_ENDPOINT), **good) as listener:  # type: ignore[arg-type]
            end = time.monotonic() + NEVER
            while time.monotonic() < end:
                bare.send_multipart(encode(message()))
                assert listener.receive(0.01) is None
            assert (listener.received, listener.rejected, listener.repeats) == (0, 0, 0)
    with Publisher(keys=keys / "stranger.key_secret", allowed=keys / "allowed") as publisher:
        with Listener(publisher.address, **good) as listener:  # type: ignore[arg-type]
            send(publisher)
            assert listener.receive(NEVER) is None


def test_two_publishers_have_lists_of_their_own(keys: Path) -> None:
    with contextlib.ExitStack() as stack:
        for name, stranger in (("good", "stranger"), ("stranger", "good")):
            allowed = [keys / f"{name}.key"]
            publisher = stack.enter_context(Publisher(keys=keys / "server.key_secret", allowed=allowed))
            send(publisher)
            for who, gets in ((name, True), (stranger, False)):
                own = {"keys": keys / f"{who}.key_secret", "server_key": keys / "server.key"}
                with Listener(publisher.address, **own) as listener:  # type: ignore[arg-type]
                    assert (listener.receive(SOON if gets else NEVER) is not None) == gets


# --- keys ----------------------------------------------------------------------------------------------
def test_keys_are_made_once_and_the_secret_is_kept(tmp_path: Path) -> None:
    umask = os.umask(0)
    try:
        public, secret = keygen(tmp_path / "new", "robot-1")
    finally:
        os.umask(umask)
    assert (public.name, secret.name) == ("robot-1.key", "robot-1.key_secret")
    if os.name == "posix":
        assert [stat.S_IMODE(path.stat().st_mode) for path in (public, secret)] == [0o644, 0o600]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["robot-1.key", "robot-1.key_secret"]
    assert "secret-key" not in public.read_text()
    before = public.read_bytes(), secret.read_bytes()
    for gone in (None, public):
        if gone:
            gone.unlink()
        with pytest.raises(ValueError, match="is there already, and is not overwritten"):
            keygen(tmp_path / "new", "robot-1")
    assert secret.read_bytes() == before[1]
    for name in ("", "../x", "a/b", ".hidden", "a b", "x" * 200, "\n"):
        with pytest.raises(ValueError, match="name: expected letters, digits"):
            keygen(tmp_path, name)
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="cannot write"):
        keygen(tmp_path / "file", "x")


def test_wrong_keys(keys: Path, tmp_path: Path) -> None:
    (tmp_path / "wrong.key").write_bytes(b'public-key = "\xff\xfe"\n')
    swapped = (keys / "server.key_secret").read_text().replace("secret-key", "x").replace("public-key", "secret-key")
    (tmp_path / "swapped").write_text(swapped.replace("    x", "    public-key"))
    secret, public = keys / "good.key_secret", keys / "server.key"
    for wrong in (keys / "server.key", tmp_path / "wrong.key", tmp_path / "swapped", __file__):
        with pytest.raises(ValueError, match="expected a secret key as keygen makes it"):
            Publisher(keys=wrong, allowed=keys / "allowed")
    with pytest.raises(ValueError, match=r"wrong.key: expected a public key as keygen makes it"):
        Listener("tcp://127.0.0.1:1", keys=secret, server_key=tmp_path / "wrong.key")
    with pytest.raises(ValueError, match=r"wrong.key: expected a public key"):
        Publisher(keys=secret, allowed=tmp_path)
    for path, reason in ((tmp_path / "none", "no such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ValueError, match=rf"cannot read the key \({reason}\)"):
            Listener("tcp://127.0.0.1:1", keys=path, server_key=public)
    with pytest.raises(ValueError, match="allowed: expected a folder of public keys"):
        Publisher(keys=secret, allowed=tmp_path / "none")
    for nobody in (keys / "nobody", []):
        if nobody:
            (keys / "nobody").mkdir()
        with pytest.raises(ValueError, match=r"allowed: expected at least one public key \(NAME.key\), got none"):
            Publisher(keys=secret, allowed=nobody)
    with pytest.raises(ValueError, match=r"keys, allowed .--keys, --allow.: expected both or neither"):
        Publisher(keys=secret)
    with pytest.raises(ValueError, match=r"keys, server_key .--keys, --server-key.: expected both or neither"):
        Listener("tcp://127.0.0.1:1", server_key=public)
