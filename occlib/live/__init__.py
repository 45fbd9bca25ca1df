"""The map on the air: live cameras in, messages out, for anybody and for ROS."""
# fmt: off

from occlib.live.bags import FORMATS as BAG_FORMATS
from occlib.live.bags import check_format as check_bag_format
from occlib.live.bags import grid_message, save_bag
from occlib.live.broadcast import Listener, Publisher, keygen
from occlib.live.capture import Capture, Device, Paired, Player
from occlib.live.drawing import MapPicture, draw_message
from occlib.live.messages import Message, decode, encode
from occlib.live.station import Feed, Published, live_feed, publish_maps, recorded_feed
from occlib.live.topic import MapTopic

__all__ = [
    "BAG_FORMATS", "Capture", "Device", "Feed", "Listener", "MapPicture", "MapTopic", "Message", "Paired", "Player",
    "Published", "Publisher", "check_bag_format", "decode", "draw_message", "encode", "grid_message", "keygen",
    "live_feed", "publish_maps", "recorded_feed", "save_bag",
]
