"""The map as a ROS 2 topic, without ROS: the same bytes, over DDS.

Needs the extra ``ros2``: ``pip install "occlib[ros2]"``, which is Cyclone DDS (https://cyclonedds.io), one of the
middlewares of ROS 2. What ROS calls ``/map`` is ``rt/map`` in DDS.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any

from occlib.base import checks
from occlib.base.extras import import_extra
from occlib.live.bags import TYPE, grid_message
from occlib.mapping import OccupancyMap

TOPIC = "rt/map"


class MapTopic:
    """The topic ``/map`` of type ``nav_msgs/OccupancyGrid`` on this machine's ROS 2 network.

    Reliable, transient local and keep last 1, like that of ``map_server``: whoever joins late, as ``ros2 topic echo /map``
    does, gets the last map at once, for as long as the topic is open.

    Parameters
    ----------
    domain
        ``ROS_DOMAIN_ID`` of the robots, 0 to 232.
    topic
        Its DDS name.

    Raises
    ------
    ValueError
        In one line: the extra is missing, another domain, or DDS cannot be started (no network).

    Notes
    -----
    Where DDS listens is set by ``CYCLONEDDS_URI``, as for ROS 2 with ``rmw_cyclonedds_cpp``.

    Examples
    --------
    ::

        with MapTopic(domain=42) as topic:
            topic.send(grid, time_s=0.1)
    """

    def __init__(self, domain: int = 0, *, topic: str = TOPIC) -> None:
        checks.whole("domain", domain, least=0, most=232, unit="a ROS_DOMAIN_ID")
        self.domain, self.topic = domain, topic
        self._types = message_types()
        self._writer, self._participant = self._open()

    def _open(self) -> tuple[Any, Any]:
        from cyclonedds.core import DDSException
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        try:
            participant = DomainParticipant(self.domain)
            return DataWriter(
                participant, Topic(participant, self.topic, self._types[TYPE], qos=latched())
            ), participant
        except DDSException as error:
            raise ValueError(f"domain: DDS does not start in domain {self.domain} ({error})") from None

    def send(self, grid: OccupancyMap, time_s: float) -> None:
        """Publish a map; ``time_s`` is its stamp, 0 to below 2**31 s."""
        if self._writer is None:
            raise ValueError("topic: expected an open topic, got a closed one")
        message = grid_message(self._types, grid, time_s)
        message.data = message.data.tolist()  # it takes no array
        self._writer.write(message)

    def close(self) -> None:
        """Leave the network; late joiners get nothing any more."""
        self._writer = self._participant = None

    def __enter__(self) -> MapTopic:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def latched() -> Any:
    """The quality of service that ``map_server`` offers and asks for."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
    )


def message_types() -> dict[str, Any]:
    """The DDS types that make up ``nav_msgs/OccupancyGrid``, by their ROS names; their fields are those of ROS 2."""
    import_extra("cyclonedds.idl", "ros2")
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import float32, float64, int8, int32, uint32
    from cyclonedds.idl.types import sequence as sequence_type

    sequence: Any = sequence_type  # for mypy: generic through its metaclass
    made: dict[str, Any] = {}

    def struct(package: str, name: str, **fields: Any) -> Any:
        made_type = make_idl_struct(f"{name}_", f"{package}.msg.dds_.{name}_", fields)  # Cyclone says . for ::
        made[f"{package}/msg/{name}"] = made_type
        return made_type

    time = struct("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
    header = struct("std_msgs", "Header", stamp=time, frame_id=str)
    point = struct("geometry_msgs", "Point", x=float64, y=float64, z=float64)
    turn = struct("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
    pose = struct("geometry_msgs", "Pose", position=point, orientation=turn)
    info = struct(
        "nav_msgs", "MapMetaData", map_load_time=time, resolution=float32, width=uint32, height=uint32, origin=pose
    )
    struct("nav_msgs", "OccupancyGrid", header=header, info=info, data=sequence[int8])
    return made
