"""Recordings that rosbags writes, with pictures, cameras and poses that are known."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STEP_NS = 40_000_000
START_NS = 1_700_000_000_000_000_000
DELAY_NS = 5_000_000
"""Messages are recorded so much later than their headers say."""

FORMATS = ("bag", "db3", "mcap")


class BagWriter:
    """Writes one recording: `bag` (ROS 1), `db3` or `mcap` (ROS 2).

    compressed: `bz2` or `lz4` for ROS 1, `messages` or, of mcap, `chunks` for ROS 2.
    """

    def __init__(self, path, kind, compressed=None, chunk_bytes=1 << 20):
        self.is_ros1 = kind == "bag"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
            self._writer = Writer1(path)
            self._writer.chunk_threshold = chunk_bytes
            if compressed:
                self._writer.set_compression(Writer1.CompressionFormat[compressed.upper()])
        else:
            storage = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
            self._writer = Writer2(path, version=9, storage_plugin=storage)
            if compressed:
                mode = CompressionMode.STORAGE if compressed == "chunks" else CompressionMode.MESSAGE
                self._writer.set_compression(mode, CompressionFormat.ZSTD)
        self._connections = {}

    def __enter__(self):
        self._writer.open()
        return self

    def __exit__(self, *_):
        self._writer.close()

    def write(self, topic, message, time_ns, cut_bytes=None):
        type_ = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, type_, typestore=self.types)
        serialize = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        self._writer.write(self._connections[topic], time_ns, serialize(message, type_)[:cut_bytes])

    def make(self, name, **values):
        """A message; `package/Name` is found in the msg namespace."""
        package, _, last = name.partition("/")
        return self.types.types[f"{package}/msg/{last}"](**values)

    def header(self, time_ns, frame="camera"):
        stamp = self.make("builtin_interfaces/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        more = {"seq": 7} if self.is_ros1 else {}
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame, **more)

    def image(self, samples, encoding, time_ns, padding=0, big=False):
        """A sensor_msgs/Image of samples (H, W[, C]); rows have `padding` bytes after them."""
        rows = samples.reshape(len(samples), -1)
        rows = np.ascontiguousarray(rows.astype(rows.dtype.newbyteorder(">" if big else "<"))).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
        return self.make(
            "sensor_msgs/Image", header=self.header(time_ns), height=samples.shape[0], width=samples.shape[1],
            encoding=encoding, is_bigendian=int(big), step=rows.shape[1], data=rows.reshape(-1),
        )  # fmt: skip

    def compressed_image(self, content, format_, time_ns):
        data = np.frombuffer(content, np.uint8)
        return self.make("sensor_msgs/CompressedImage", header=self.header(time_ns), format=format_, data=data)

    def camera_info(self, model="plumb_bob", distortion=(0.1, -0.05, 0.001, -0.002, 0.01), size=(32, 24), fx=30.0):
        letters = {"d": distortion, "k": (fx, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1), "r": np.eye(3).reshape(-1)}
        letters["p"] = (fx + 1, 0, 15.0, 0, 0, 32.0, 11.0, 0, 0, 0, 1, 0)
        named = {
            (name.upper() if self.is_ros1 else name): np.array(value, np.float64) for name, value in letters.items()
        }
        region = self.make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.make(
            "sensor_msgs/CameraInfo", header=self.header(START_NS), height=size[1], width=size[0],
            distortion_model=model, binning_x=0, binning_y=0, roi=region, **named,
        )  # fmt: skip

    def pose(self, numbers):
        """A geometry_msgs/Pose of x, y, z, qx, qy, qz, qw."""
        return self.make("geometry_msgs/Pose", position=self._point(numbers), orientation=self._rotation(numbers))

    def transform(self, numbers, parent, child, time_ns):
        x, y, z = numbers[:3]
        translation = self.make("geometry_msgs/Vector3", x=x, y=y, z=z)
        moved = self.make("geometry_msgs/Transform", translation=translation, rotation=self._rotation(numbers))
        header = self.header(time_ns, parent)
        return self.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=moved)

    def transforms(self, *stamped):
        return self.make("tf2_msgs/TFMessage", transforms=list(stamped))

    def _point(self, numbers):
        x, y, z = numbers[:3]
        return self.make("geometry_msgs/Point", x=x, y=y, z=z)

    def _rotation(self, numbers):
        x, y, z, w = numbers[3:]
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def time_ns(number):
    return START_NS + number * STEP_NS


def bag_file(path, kind):
    """The file of a recording, which ROS 2 puts into a folder."""
    return path if kind == "bag" else next(path.glob(f"*.{kind}"))


def picture(number, shape=(24, 32, 3)):
    return np.random.default_rng(number).integers(0, 256, shape, dtype=np.uint8)


def write_pictures(path, kind, count=6, compressed=None, camera=True, topic="/cam/image_raw", **options):
    """`count` pictures of rgb8 and their camera_info; returns the path."""
    with BagWriter(path, kind, compressed, **options) as bag:
        for number in range(count):
            recorded_ns = time_ns(number) + DELAY_NS
            bag.write(topic, bag.image(picture(number), "rgb8", time_ns(number)), recorded_ns)
            if camera:
                bag.write("/cam/camera_info", bag.camera_info(), recorded_ns)
    return path
