"""Publish the map, and listen to it (section 2: "it updates the environment map and broadcast it within the environment").

ZeroMQ (https://zeromq.org) over TCP; what is sent is in :mod:`occlib.live.messages`. Nothing leaves the machine unless there are
keys: beyond loopback every connection is encrypted and both ends are authenticated by CurveZMQ
(https://rfc.zeromq.org/spec/26).
"""

from __future__ import annotations

import ipaddress
import math
import os
import re
import secrets
import socket
import stat
import struct
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from occlib.base.extras import lazy_extra
from occlib.geometry import Floor
from occlib.live.messages import LAST, MAX_CELLS, MAX_HEADER, TOPIC, Message, decode, encode, short

if TYPE_CHECKING:
    import zmq
    from zmq import auth
    from zmq.utils import z85
else:
    zmq, auth, z85 = lazy_extra("zmq", "live"), lazy_extra("zmq.auth", "live"), lazy_extra("zmq.utils.z85", "live")

__all__ = ["Listener", "Message", "Publisher", "decode", "encode", "keygen"]


Keys: TypeAlias = str | Path


_QUEUE = 8  # maps that wait for a slow listener; what comes then is dropped


_HEARTBEAT_MS = 5000


def keygen(folder: str | Path, name: str) -> tuple[Path, Path]:
    """Make a pair of keys: ``NAME.key``, public, to be given away, and ``NAME.key_secret``, for its owner only.

    Returns
    -------
    The paths of the public and of the secret file. The format is that of CZMQ certificates.

    Raises
    ------
    ValueError
        A name that is no file name, one of the files is there already, or the folder cannot be written.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}", name):
        raise ValueError(f"name: expected letters, digits, '.', '_' or '-', got {short(name)}")
    paths = Path(folder) / f"{name}.key", Path(folder) / f"{name}.key_secret"
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        if there := next((path for path in paths if os.path.lexists(path)), None):
            raise ValueError(f"{there}: is there already, and is not overwritten")
        with tempfile.TemporaryDirectory(dir=folder, prefix=".keygen.") as hidden:  # which only its owner may enter
            for made, path, mode in zip(auth.create_certificates(hidden, name), paths, (0o644, 0o600), strict=True):
                os.chmod(made, mode)
                os.rename(made, path)
    except OSError as error:
        raise ValueError(f"{folder}: cannot write ({error.strerror})") from None
    return paths


def _load_key(path: Keys, *, secret: bool = False) -> tuple[bytes, bytes]:
    """The public and the secret key in a file; the latter is empty unless asked for."""
    try:
        public, private = auth.load_certificate(Path(path))
        z85.decode(public)
        valid = len(public) == 40 and (not secret or zmq.curve_public(private or b"") == public)
    except OSError as error:
        raise ValueError(f"{path}: cannot read the key ({error.strerror or 'no such file'})") from None
    except (ValueError, KeyError, struct.error, zmq.ZMQError):
        valid = False
    if not valid:
        raise ValueError(f"{path}: expected a {'secret' if secret else 'public'} key as keygen makes it")
    return public, (private or b"") if secret else b""


def _allowed(allowed: Keys | Iterable[Keys]) -> frozenset[bytes]:
    """The public keys, 32 bytes each, in a folder's ``*.key`` or in the files named."""
    if isinstance(allowed, str | Path):
        if not Path(allowed).is_dir():
            raise ValueError(f"allowed: expected a folder of public keys, got {allowed}")
        allowed = sorted(Path(allowed).glob("*.key"))
    keys = frozenset(z85.decode(_load_key(path)[0]) for path in allowed)
    if not keys:
        raise ValueError("allowed: expected at least one public key (NAME.key), got none")
    return keys


def _endpoint(address: str, *, secure: bool, listening: bool) -> str:
    """The address for ZeroMQ, if it stays on this machine or is ``secure``."""
    if not isinstance(address, str):
        raise ValueError(f"address: expected text, got {type(address).__name__}")
    if re.fullmatch(r"ipc://\S+", address):
        return address
    parts = re.fullmatch(r"tcp://(\[[0-9A-Fa-f:.]+\]|[\w.*-]+):(\*|[0-9]{1,5})", address, re.ASCII)
    if not parts or (listening and "*" in address) or (parts[2] != "*" and int(parts[2]) > 65535):
        raise ValueError(f"address: expected tcp://HOST:PORT or ipc://FILE, got {short(address)}")
    host = "127.0.0.1" if parts[1] == "localhost" else parts[1]
    try:
        local = ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:  # a name may lead anywhere
        local = False
    if not local and not secure:
        needed = "server_key (--keys, --server-key)" if listening else "allowed (--keys, --allow)"
        raise ValueError(f"address: expected 127.0.0.1 without keys; {short(address)} needs keys and {needed}")
    if listening and not local:
        try:
            socket.getaddrinfo(host.strip("[]"), None)
        except (OSError, UnicodeError):
            raise ValueError(f"address: unknown host {short(host)}") from None
    return f"tcp://{host}:{parts[2]}"


def _check_unused(endpoint: str) -> None:
    """ZeroMQ deletes whatever is at the path of an ipc address: only a socket that nobody answers may go."""
    path = endpoint.removeprefix("ipc://")
    if path == endpoint or path[0] in "@*" or not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(os.lstat(path).st_mode):
        raise ValueError(f"address: {short(path)} is there already, and is no socket")
    with socket.socket(socket.AF_UNIX) as probe:
        if probe.connect_ex(path) == 0:
            raise ValueError(f"address: cannot publish at {short(endpoint)} (Address already in use)")


class _Connected:
    """A ZeroMQ socket with a context of its own, closed at the end of a ``with`` block."""

    def __init__(self, kind: int, endpoint: str) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(kind)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.IPV6, int("[" in endpoint or kind == zmq.SUB))
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, _HEARTBEAT_MS)  # a robot that is out of reach is let go
        self._socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 2 * _HEARTBEAT_MS)

    def close(self) -> None:
        """Leave; may be called twice."""
        self._socket.close(linger=0)
        self._context.term()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Publisher(_Connected):
    """Sends maps to whoever listens, and never waits for anybody.

    A listener that is slow loses messages; one that is dead is forgotten; one that joins late gets the last map at once.
    Whatever else reaches the port is ignored. Who is let in is trusted not to flood it: ZeroMQ bounds the size of a frame, but not the
    number of subscriptions or of frames in a message.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``, port ``*`` for any that is free, or ``ipc://FILE``. Anything but this machine's loopback needs keys.
    keys
        The publisher's ``NAME.key_secret``. With it, everything is encrypted.
    allowed
        The listeners that are let in: a folder of public keys (``*.key``), or their paths. Read once. Goes with ``keys``.

    Attributes
    ----------
    address : str
        Where it publishes, with the real port.
    session : str
        32 hexadecimal digits, new each time.
    sequence : int
        Number of the last message; 0 before the first.

    Raises
    ------
    ValueError
        One line: an address that is wrong, in use or not loopback without keys; keys that cannot be read.

    Examples
    --------
    >>> with Publisher() as publisher, Listener(publisher.address) as listener:
    ...     sent = publisher.send(np.zeros((2, 3), np.int8), Floor((0, 3), (0, 2), 1.0), [], time.time())
    ...     listener.receive(5.0) == sent
    True
    """

    def __init__(
        self,
        address: str = "tcp://127.0.0.1:*",
        *,
        keys: Keys | None = None,
        allowed: Keys | Iterable[Keys] | None = None,
    ) -> None:
        if (keys is None) != (allowed is None):
            raise ValueError("keys, allowed (--keys, --allow): expected both or neither")
        endpoint = _endpoint(address, secure=keys is not None, listening=False)
        self._allowed = frozenset[bytes]() if allowed is None else _allowed(allowed)
        pair = None if keys is None else _load_key(keys, secret=True)
        _check_unused(endpoint)
        super().__init__(zmq.XPUB, endpoint)
        self.session, self.sequence = secrets.token_hex(16), 0
        self._last: list[bytes] | None = None
        self._waiting = deque[list[bytes]](maxlen=_QUEUE)  # only while the other thread has the socket
        self._lock, self._numbering, self._stop = threading.Lock(), threading.Lock(), threading.Event()
        self._zap = self._context.socket(zmq.REP)
        self._thread = threading.Thread(target=self._serve, name="occlib-broadcast", daemon=True)
        self._socket.setsockopt(zmq.XPUB_VERBOSE, 1)  # tell of a subscription that comes again, on a new connection
        self._socket.setsockopt(zmq.SNDHWM, _QUEUE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, 1024)  # of what comes in
        try:
            self._zap.bind("inproc://zeromq.zap.01")
            if pair is not None:
                self._socket.curve_publickey, self._socket.curve_secretkey = pair
                self._socket.curve_server = True
                self._socket.setsockopt(zmq.ZAP_DOMAIN, b"occlib")
                self._socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # nobody gets in unless somebody asks who it is
            self._thread.start()
            self._socket.bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(
                f"address: cannot publish at {short(address)} ({zmq.strerror(error.errno or 0)})"
            ) from None
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def send(
        self,
        data: npt.NDArray[np.int8],
        floor: Floor,
        objects: Sequence[Mapping[str, Any]],
        t_capture: float,
        coasting: Sequence[Mapping[str, Any]] = (),
    ) -> Message:
        """Send a map, without waiting.

        Parameters
        ----------
        data, floor, objects, t_capture, coasting
            As in :class:`Message`.

        Returns
        -------
        What was sent.

        Raises
        ------
        ValueError
            One of them is wrong, or the publisher is closed. Nothing is sent, and the number is not used up.
        """
        with self._numbering:
            if self._stop.is_set():
                raise ValueError("publisher: expected an open one, got one that is closed")
            message = Message(self.sequence + 1, t_capture, time.time(), data, floor, objects, self.session, coasting)
            self._waiting.append(encode(message))
            self.sequence = message.sequence
        self._work(16)
        return message

    def close(self) -> None:
        """Stop publishing; may be called twice."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        with self._lock:
            self._zap.close(linger=0)
            super().close()

    # The socket is used by two threads, one at a time: the lock is the memory barrier that zmq_socket(3) asks for. Its file
    # descriptor only tells of news that nobody has looked at yet, so whoever uses the socket looks for subscriptions.
    def _work(self, most: int) -> bool:
        """Send what waits, and answer; whether there may be more to answer. Leaves it to the other thread if that is at it."""
        more = False
        while self._lock.acquire(blocking=False):
            try:
                while self._waiting and not self._socket.closed:
                    self._last = self._waiting.popleft()
                    self._socket.send_multipart(self._last, zmq.DONTWAIT)
                more = not self._socket.closed and self._answer(most)
            finally:
                self._lock.release()
            if (
                not self._waiting or self._stop.is_set()
            ):  # else it came just before the release, and is left to this thread
                return more
        return False

    def _serve(self) -> None:
        """In a thread: answer subscriptions between two maps, and say who is let in."""
        poller = zmq.Poller()
        poller.register(self._zap, zmq.POLLIN)
        poller.register(self._socket.fileno(), zmq.POLLIN)
        while not self._stop.wait(0.005):  # rarely enough not to be in the way of the other thread
            poller.poll(100)
            with suppress(zmq.Again):
                while True:
                    self._zap.send_multipart(self._verdict(self._zap.recv_multipart(zmq.DONTWAIT)))
            while self._work(64) and not self._stop.is_set():
                pass

    def _verdict(self, request: Sequence[bytes]) -> list[bytes]:
        """Whether a client is let in (https://rfc.zeromq.org/spec/27)."""
        good = len(request) == 7 and request[5] == b"CURVE" and request[6] in self._allowed
        status = [b"200", b"OK"] if good else [b"400", b"not allowed"]
        return [b"1.0", request[1] if len(request) > 1 else b"", *status, b"", b""]

    def _answer(self, most: int) -> bool:
        """Send the last map to those who have just come; whether there may be more of them."""
        for _ in range(most):
            try:
                asked = self._socket.recv(zmq.DONTWAIT)
            except zmq.Again:
                return False
            if self._last and re.fullmatch(b"\x01" + re.escape(LAST) + b"[0-9a-f]{32}", asked):
                self._socket.send_multipart([asked[1:], *self._last[1:]], zmq.DONTWAIT)
        return True


class Listener(_Connected):
    """Receives maps: each once, in order, and counts what it misses. Connects again by itself when the publisher restarts.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT`` or ``ipc://FILE``. Anything but this machine's loopback needs keys.
    keys, server_key
        The listener's ``NAME.key_secret`` and the publisher's public ``NAME.key``. Both or neither.
    timeout_s
        How long the iterator waits for the next message before it ends; for ever if ``None``.
    latest
        Skip to the newest message that is there.

    Attributes
    ----------
    received, missed, skipped, repeats, rejected : int
        Messages handed out; numbers left out between two that came; come, but older than a newer one that was there
        (``latest`` only); come again; malformed. What a publisher sent before the first message from it counts as nothing.

    Raises
    ------
    ValueError
        One line: a wrong address, an unknown host, or keys that cannot be read.
    """

    def __init__(
        self,
        address: str,
        *,
        keys: Keys | None = None,
        server_key: Keys | None = None,
        timeout_s: float | None = None,
        latest: bool = False,
    ) -> None:
        if (keys is None) != (server_key is None):
            raise ValueError("keys, server_key (--keys, --server-key): expected both or neither")
        endpoint = _endpoint(address, secure=keys is not None, listening=True)
        pair = None if keys is None or server_key is None else (_load_key(keys, secret=True), _load_key(server_key)[0])
        super().__init__(zmq.SUB, endpoint)
        self.timeout_s, self.latest = timeout_s, latest
        self.received = self.missed = self.skipped = self.repeats = self.rejected = 0
        self._sessions: list[str] = []
        self._sequence = 0
        self._socket.setsockopt(zmq.RCVHWM, 4 * _QUEUE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, max(MAX_HEADER, MAX_CELLS))
        self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        if pair is not None:
            (self._socket.curve_publickey, self._socket.curve_secretkey), self._socket.curve_serverkey = pair
        self._socket.subscribe(TOPIC)
        self._socket.subscribe(LAST + secrets.token_hex(16).encode())
        try:
            self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(
                f"address: cannot connect to {short(address)} ({zmq.strerror(error.errno or 0)})"
            ) from None

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """The next message, or ``None`` if there is none for ``timeout_s`` seconds (``None``: wait for ever)."""
        if self._socket.closed or (timeout_s is not None and math.isnan(timeout_s)):
            what = (
                "timeout_s: expected seconds, got nan" if not self._socket.closed else "listener: expected an open one"
            )
            raise ValueError(what)
        end = math.inf if timeout_s is None else time.monotonic() + timeout_s
        found, more = None, 4 * _QUEUE if self.latest else 0
        while found is None or more:
            left = 0.0 if found else min(max(end - time.monotonic(), 0.0), 3600.0)
            if self._socket.poll(math.ceil(left * 1000)):
                message = self._take()
                if found and message:
                    self.skipped, more = self.skipped + 1, more - 1
                found = message or found
            elif found:
                break
            if found is None and time.monotonic() >= end:
                break
        self.received += found is not None
        return found

    def __iter__(self) -> Iterator[Message]:
        while (message := self.receive(self.timeout_s)) is not None:
            yield message

    def _take(self) -> Message | None:
        """The message that has come, if it is one, and new."""
        try:
            message = decode(self._socket.recv_multipart())
        except ValueError:
            self.rejected += 1
            return None
        new = message.session not in self._sessions
        if not new and (message.session != self._sessions[-1] or message.sequence <= self._sequence):
            self.repeats += 1
            return None
        self._sessions = [*self._sessions[-99:], message.session] if new else self._sessions
        self.missed += 0 if new else message.sequence - self._sequence - 1
        self._sequence = message.sequence
        return message
