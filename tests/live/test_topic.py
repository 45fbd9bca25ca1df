"""The map as a ROS 2 topic: the bytes of ROS, and a late joiner in another process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from typing import Any

import numpy as np
import pytest

from occlib.geometry import Floor
from occlib.live.bags import TYPE, grid_message
from occlib.live.topic import TOPIC, MapTopic, latched, message_types
from occlib.mapping import OccupancyMap

pytest.importorskip("cyclonedds.core", reason="cyclonedds is not installed: pip install 'occlib[ros2]'")

FLOOR = Floor((-1.5, 0.5), (2.0, 3.25), 0.25)
GRID = OccupancyMap(np.random.default_rng(5).integers(-1, 101, FLOOR.shape).astype(np.int8), FLOOR)
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "</Domain></CycloneDDS>"
)
LISTENER = """
    import json, sys
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from occlib.live.topic import TOPIC, latched, message_types
    participant = DomainParticipant(int(sys.argv[1]))
    topic = Topic(participant, TOPIC, message_types()["nav_msgs/msg/OccupancyGrid"])
    for message in DataReader(participant, topic, qos=latched()).take_iter(timeout=duration(seconds=10)):
        stamp, info = message.header.stamp, message.info
        print(json.dumps([stamp.sec, stamp.nanosec, message.header.frame_id, info.width, info.height, info.resolution,
                          info.origin.position.x, info.origin.position.y, info.origin.orientation.w, message.data]))
        break
"""


@pytest.fixture
def topic(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A topic on the loopback interface in a domain of its own, closed afterwards."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    try:
        opened = MapTopic(domain=100 + os.getpid() % 100)  # not at random: pytest-xdist workers differ, too
    except ValueError as error:
        pytest.skip(f"no network for DDS here: {error}")
    with opened:
        yield opened


def listen(domain: int) -> list[Any]:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LISTENER), str(domain)],
        capture_output=True,
        text=True,
        timeout=40,
        check=True,
    )
    return json.loads(done.stdout) if done.stdout else []


@pytest.mark.slow
def test_a_late_joiner_gets_the_last_map_only(topic: Any) -> None:
    topic.send(OccupancyMap(np.zeros(FLOOR.shape, np.int8), FLOOR), 1.0)
    topic.send(GRID, 2.25)
    *meta, data = listen(topic.domain)
    assert meta == [2, 250_000_000, "map", 8, 5, 0.25, -1.5, 2.0, 1.0]
    assert data == GRID.data.ravel().tolist()


def test_a_closed_topic_sends_nothing(topic: Any) -> None:
    with topic as same:
        assert same is topic
    with pytest.raises(ValueError, match="topic: expected an open topic, got a closed one"):
        topic.send(GRID, 0.0)


def test_the_bytes_are_those_of_ros() -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    expected = bytes(store.serialize_cdr(grid_message(store.types, GRID, 2.25), TYPE))
    message = grid_message(message_types(), GRID, 2.25)
    message.data = message.data.tolist()
    assert message.serialize() == expected


def test_the_types_have_the_names_of_ros() -> None:
    names = {kind: made.__idl__.idl_transformed_typename for kind, made in message_types().items()}
    assert names[TYPE] == "nav_msgs::msg::dds_::OccupancyGrid_"
    assert names == {kind: kind.replace("/msg/", "::msg::dds_::") + "_" for kind in names}
    assert TOPIC == "rt/map"


def test_the_quality_of_service_is_that_of_map_server() -> None:
    from cyclonedds.core import Policy

    assert latched()[Policy.History] == Policy.History.KeepLast(1)
    assert latched()[Policy.Durability] == Policy.Durability.TransientLocal
    assert isinstance(latched()[Policy.Reliability], Policy.Reliability.Reliable)


def test_wrong_domains_are_named() -> None:
    for domain in (-1, 233, 1.5, True):
        with pytest.raises(ValueError, match="domain: expected a ROS_DOMAIN_ID from 0 to 232"):
            MapTopic(domain=domain)  # type: ignore[arg-type]
