"""The map on the air: live cameras in, messages out, for anybody and for ROS."""
# fmt: off

from occlib.live.bags import grid_message, save_bag
from occlib.live.broadcast import Listener, Publisher, keygen
from occlib.live.capture import Capture, Device, Paired, Player
from occlib.live.messages import Message, decode, encode
from occlib.live.topic import MapTopic

__all__ = [
    "Capture", "Device", "Listener", "MapTopic", "Message", "Paired", "Player", "Publisher", "decode", "encode",
    "grid_message", "keygen", "save_bag",
]
