"""Recordings of coded video as the ecosystem's own libraries write them, with frames that are known."""

from __future__ import annotations

import base64
import json
from fractions import Fraction

import numpy as np
from bag_files import DELAY_NS, BagWriter, time_ns
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from mcap.writer import Writer as McapWriter
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags.typesys import get_types_from_msg

from codecbench.plugins.codecs.video.library import load_av, preserve_scheduling

DEFINITIONS = {
    "foxglove_msgs/msg/CompressedVideo": "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\n"
    "string format",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "std_msgs/Header header\nint32 width\nint32 height\n"
    "string encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data",
}
ENCODERS = {
    "h264": ("libx264", {"preset": "ultrafast", "tune": "zerolatency"}),
    "h265": ("libx265", {"preset": "ultrafast", "tune": "zerolatency", "x265-params": "log-level=none"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "cpu-used": "8", "lag-in-frames": "0"}),
    "av1": ("libsvtav1", {"preset": "12", "svtav1-params": "pred-struct=1:lookahead=0"}),
}
SIZE = (64, 48)


def scene(number):
    """A picture that moves by its number and has its number as its brightness in the left half."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    image = np.stack([(3 * x + 5 * number) % 256, (4 * y) % 256, np.full_like(x, 90)], axis=2).astype(np.uint8)
    image[:, : SIZE[0] // 2] = 10 + 6 * number
    return image


def encode(format_="h264", count=30, gop=10, options=None, pixel_format="yuv420p", picture=scene):
    """(number of the frame, packet) in the order of the encoder."""
    av = load_av()
    name, usual = ENCODERS[format_]
    context = av.CodecContext.create(name, "w")
    context.width, context.height = SIZE
    context.pix_fmt, context.framerate, context.time_base = pixel_format, Fraction(25), Fraction(1, 25)
    context.gop_size, context.options = gop, usual if options is None else options
    packets = []
    with preserve_scheduling():
        for number in [*range(count), None]:
            frame = None
            if number is not None:
                frame = av.VideoFrame.from_ndarray(picture(number), format="rgb24").reformat(format=pixel_format)
                frame.pts = number
            packets += [(packet.pts, bytes(packet)) for packet in context.encode(frame)]
    return packets


def write_video(path, packets, format_, how, cut=()):
    """Write packets as `protobuf`, `json`, `foxglove_msgs`, `ffmpeg` or `ffmpeg db3`; returns the recording's path.

    cut: places of messages of ROS that end after 40 bytes.
    """
    if how == "protobuf":
        with open(path, "wb") as stream, ProtobufWriter(stream) as writer:
            for place, (number, data) in enumerate(packets):
                message = CompressedVideo(frame_id="camera", data=data, format=format_)
                message.timestamp.FromNanoseconds(time_ns(number))
                writer.write_message("/camera/video", message, time_ns(place), time_ns(number))
    elif how == "json":
        with open(path, "wb") as stream:
            _write_json(McapWriter(stream), packets, format_)
    else:
        package, _, storage = how.partition(" ")
        type_ = next(name for name in DEFINITIONS if name.startswith(package))
        with BagWriter(path, storage or "mcap") as bag:
            bag.types.register(get_types_from_msg(DEFINITIONS[type_], type_))
            for place, (number, data) in enumerate(packets):
                header, content = bag.header(time_ns(number)), np.frombuffer(data, np.uint8)
                if how == "foxglove_msgs":
                    values = {"timestamp": header.stamp, "frame_id": "camera", "format": format_}
                else:
                    values = {"header": header, "width": SIZE[0], "height": SIZE[1], "pts": number, "flags": 0}
                    values |= {"encoding": f"{format_};yuv420p;bgr8;bgr8", "is_bigendian": False}
                message = bag.types.types[type_](**values, data=content)
                bag.write("/camera/video", message, time_ns(place) + DELAY_NS, 40 if place in cut else None)
    return path


def _write_json(writer, packets, format_):
    writer.start()
    schema = writer.register_schema("foxglove.CompressedVideo", "jsonschema", b"{}")
    channel = writer.register_channel("/camera/video", "json", schema)
    for place, (number, data) in enumerate(packets):
        stamp = {"sec": time_ns(number) // 10**9, "nsec": time_ns(number) % 10**9}
        fields = {"timestamp": stamp, "frame_id": "camera", "format": format_}
        content = json.dumps({**fields, "data": base64.b64encode(data).decode()}).encode()
        writer.add_message(channel, time_ns(place), content, time_ns(number))
    writer.finish()
