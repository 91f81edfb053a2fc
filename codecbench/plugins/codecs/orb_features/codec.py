"""`orb_features`: ORB features to packets and back, intra or inter frame."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from codecbench.core.contracts.codec import Capabilities, FeatureCodec
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.features import FeatureDecoder, FeatureEncoder, Features, FeatureSet
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image, gray_from_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet
from codecbench.plugins.codecs.orb_features.bitstream import (
    MAX_ANGLE_BITS,
    MAX_KEYPOINTS,
    MAX_STEP,
    Memory,
    pack,
    unpack,
)
from codecbench.plugins.codecs.orb_features.keypoints import PARTS, SCALE_FACTOR, CodedKeypoints
from codecbench.plugins.slam_backends.keypoints import features_of, keypoints_of
from codecbench.slam.features.extractor import FeatureExtractor, Keypoints
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options

LEVELS = 8
COPIED_BITS = 32
"""With `lossy`, a descriptor that differs from its reference in at most so many bits becomes equal to it."""
FINEST_STEP_PX = 1.0 / PARTS
_MAX_SIDE = 0xFFFF


def _check_step(value: float) -> float:
    if value != FINEST_STEP_PX and value != int(value):
        raise ValueError(f"{value:g} is neither {FINEST_STEP_PX:g}, which loses nothing, nor a whole number of pixels")
    return value


class OrbFeaturesParams(Params):
    """Set how many ORB features are sent, and how exactly.

    features: how many the SLAM's extractor looks for, spread over the image. position_step_px: grid of positions in
    pixels of the feature's pyramid level; 0.25 is lossless. angle_bits: bits per turn. descriptor: `raw`, `coded`
    (lossless) or `lossy`: a descriptor that is close to an earlier one is replaced by it. mode: `intra`, each set is
    independent, or `inter`, predicted from the set before. gop: with `inter`, sets from one keyframe to the next.
    """

    features: Annotated[int, Field(ge=100, le=MAX_KEYPOINTS)] = 1000
    position_step_px: Annotated[float, Field(gt=0.0, le=MAX_STEP), AfterValidator(_check_step)] = FINEST_STEP_PX
    angle_bits: Annotated[int, Field(ge=1, le=MAX_ANGLE_BITS)] = MAX_ANGLE_BITS
    descriptor: Literal["raw", "coded", "lossy"] = "coded"
    mode: Literal["intra", "inter"] = "intra"
    gop: Annotated[int, Field(ge=1, le=10_000)] = 30


class OrbFeatures(FeatureCodec[OrbFeaturesParams]):
    """Extracts the features of our SLAM and sends all that it reads: everything except the response.

    Pixels, octaves and descriptors are decoded to the bit if position_step_px is 0.25 and the descriptor not `lossy`;
    angles are rounded to `angle_bits`. Features are ordered by level, in reading order of pixels within each.
    """

    name = "orb_features"
    version = "3"
    params_type = OrbFeaturesParams
    capabilities = Capabilities(thread_safe=False)
    examples = (
        {},
        {"descriptor": "raw", "angle_bits": 16},
        {"mode": "inter", "gop": 5},
        {"mode": "inter", "gop": 5, "descriptor": "lossy", "position_step_px": 2, "angle_bits": 8},
    )
    kernels = ("codecbench.slam.features", "codecbench.plugins.codecs.orb_features")

    def __init__(self, params: OrbFeaturesParams) -> None:
        super().__init__(params)
        self._extractors: dict[tuple[int, ...], FeatureExtractor] = {}

    def is_lossless(self) -> bool:
        params = self.params
        rounded = params.position_step_px != FINEST_STEP_PX or params.angle_bits != MAX_ANGLE_BITS
        return params.descriptor != "lossy" and not rounded

    def extract(self, image: Image) -> Features:
        gray = gray_from_image(check_image(image))
        if gray.shape not in self._extractors:
            height, width = gray.shape
            camera = Camera(width, height, float(width), float(width), width / 2, height / 2)  # no lens to undo
            options = Options(features=self.params.features, levels=LEVELS, scale_factor=SCALE_FACTOR)
            self._extractors[gray.shape] = FeatureExtractor(camera, options)
        return features_of(self._extractors[gray.shape].find(gray))

    def encoder(self) -> FeatureEncoder:
        return OrbFeatureEncoder(self.params)

    def decoder(self) -> FeatureDecoder:
        return OrbFeatureDecoder()


class OrbFeatureEncoder(FeatureEncoder):
    """An encoding session."""

    def __init__(self, params: OrbFeaturesParams) -> None:
        self._params = params
        self._memory: Memory | None = None
        self._pushed = 0

    def push(self, features: Features) -> Packet:
        """Encode a set.

        Raises ValueError for more than MAX_KEYPOINTS features, or an image size or a pyramid that cannot be coded.
        """
        keypoints = keypoints_of(features)
        _check_codable(keypoints)
        params = self._params
        starts = params.mode == "intra" or self._pushed % params.gop == 0
        finest = params.position_step_px == FINEST_STEP_PX
        step, parts = (1, PARTS) if finest else (int(params.position_step_px), 1)
        coded = CodedKeypoints.from_keypoints(keypoints, LEVELS, step, parts, params.angle_bits)
        like = COPIED_BITS if params.descriptor == "lossy" else 0
        data, self._memory = pack(coded, None if starts else self._memory, params.descriptor != "raw", like)
        self._pushed += 1
        return Packet(data, self._pushed - 1, starts)


class OrbFeatureDecoder(FeatureDecoder):
    """A decoding session, from any keyframe on."""

    def __init__(self) -> None:
        self._memory: Memory | None = None
        self._next = 0

    def push(self, packet: Packet | Loss) -> FeatureSet:
        """Decode a packet; the set is missing if the packet, or one that it refers to, was lost.

        Raises BitstreamError for damaged or foreign bytes; the session continues with the next keyframe.
        """
        memory, self._memory = self._memory, None
        frame = self._next if isinstance(packet, Loss) else packet.frame
        self._next = frame + 1
        if isinstance(packet, Loss):
            return FeatureSet(frame, None)
        unpacked = unpack(packet.data, memory)
        if unpacked is None:
            return FeatureSet(frame, None)
        if packet.starts != unpacked.starts:
            raise BitstreamError(f"orb_features: packet {frame} contradicts its own `starts`")
        self._memory = unpacked.memory
        return FeatureSet(frame, features_of(unpacked.coded.keypoints()))


def _check_codable(keypoints: Keypoints) -> None:
    width, height = keypoints.size
    if len(keypoints) > MAX_KEYPOINTS or max(width, height) > _MAX_SIDE or not 0 < width * height <= MAX_PIXELS:
        raise ValueError(
            f"orb_features: {len(keypoints)} keypoints of {width}x{height} pixels; at most {MAX_KEYPOINTS} of an image "
            f"of at most {_MAX_SIDE} a side and {MAX_PIXELS} pixels can be coded"
        )
    if len(keypoints) and not 0 <= int(keypoints.octaves.min()) <= int(keypoints.octaves.max()) < LEVELS:
        levels = f"{keypoints.octaves.min()} to {keypoints.octaves.max()}"
        raise ValueError(f"orb_features: keypoints of levels {levels}; a pyramid of {LEVELS} levels can be coded")
    low, high = keypoints.pixels.min(initial=0.0), (keypoints.pixels - keypoints.size).max(initial=-1.0)
    if low < 0.0 or high > -1.0 + 1e-9:
        raise ValueError("orb_features: a position is not between the centers of the first and the last pixel")
