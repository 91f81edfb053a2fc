"""A feature codec: OpenCV's ORB, deflated with the previous set as dictionary."""

import struct
import zlib

import cv2
import numpy as np
from pydantic import Field

from codecbench import (
    BitstreamError,
    Capabilities,
    FeatureCodec,
    FeatureDecoder,
    FeatureEncoder,
    Features,
    FeatureSet,
    Image,
    Loss,
    Packet,
    Params,
    check_image,
    gray_from_image,
)

_HEADER = struct.Struct("<4s?HHHI")  # magic, starts, width, height, features, CRC-32 of the previous set
_CRC_BYTES = 4
_MOST = 0xFFFF
_SMALLEST_SIDE = 64  # pixels; OpenCV's pyramid needs them
_FEATURE = np.dtype(
    [("pixel", "<f4", 2), ("octave", "u1"), ("angle", "<f4"), ("response", "<f4"), ("descriptor", "u1", 32)]
)


class CornersParams(Params):
    features: int = Field(default=600, ge=10, le=5000, description="how many are looked for")
    gop: int = Field(default=10, ge=1, description="sets from one that stands alone to the next")


class Corners(FeatureCodec[CornersParams]):
    name = "corners"
    version = "1"
    params_type = CornersParams
    capabilities = Capabilities(lossless=True, thread_safe=False)
    examples = ({}, {"gop": 3})

    def extract(self, image: Image) -> Features:
        gray = gray_from_image(check_image(image))
        size = (gray.shape[1], gray.shape[0])
        found, descriptors = (), None
        if min(size) >= _SMALLEST_SIDE:
            found, descriptors = cv2.ORB.create(self.params.features).detectAndCompute(gray, None)
        if not found or descriptors is None:
            return Features.none(size)
        angles = np.radians([point.angle for point in found]).astype(np.float32)  # as sent
        return Features(
            size,
            cv2.KeyPoint.convert(found).astype(np.float64),
            np.array([point.octave for point in found], np.int32),
            angles.astype(np.float64),
            np.array([point.response for point in found], np.float64),
            descriptors,
        )

    def encoder(self) -> FeatureEncoder:
        return CornersEncoder(self.params)

    def decoder(self) -> FeatureDecoder:
        return CornersDecoder()


class CornersEncoder(FeatureEncoder):
    def __init__(self, params: CornersParams) -> None:
        self.params = params
        self.last = b""
        self.pushed = 0

    def push(self, features: Features) -> Packet:
        count, highest = len(features), int(features.octaves.max(initial=0))
        if max(count, *features.size) > _MOST or highest > 0xFF:
            raise ValueError(
                f"corners: {count} features, {features.size} pixels, level {highest}: more than can be sent"
            )
        starts = self.pushed % self.params.gop == 0
        before = b"" if starts else self.last
        self.last, self.pushed = _rows(features).tobytes(), self.pushed + 1
        header = _HEADER.pack(b"CRNR", starts, *features.size, count, zlib.crc32(before))
        deflate = zlib.compressobj(zdict=before) if before else zlib.compressobj()
        content = header + deflate.compress(self.last) + deflate.flush()
        return Packet(content + _crc(content), self.pushed - 1, starts)


class CornersDecoder(FeatureDecoder):
    def __init__(self) -> None:
        self.last: bytes | None = None
        self.next = 0

    def push(self, packet: Packet | Loss) -> FeatureSet:
        frame = self.next if isinstance(packet, Loss) else packet.frame
        last, self.last, self.next = self.last, None, frame + 1
        if isinstance(packet, Loss):
            return FeatureSet(frame, None)
        content = packet.data[:-_CRC_BYTES]
        if len(content) < _HEADER.size or content[:4] != b"CRNR" or packet.data[-_CRC_BYTES:] != _crc(content):
            raise BitstreamError("corners: damaged, truncated or foreign")
        _, starts, width, height, count, before = _HEADER.unpack_from(content)
        if starts:
            last = b""
        elif last is None or zlib.crc32(last) != before:
            return FeatureSet(frame, None)  # the previous set is lost
        rows = _inflated(content[_HEADER.size :], last, count * _FEATURE.itemsize)
        features = _features((width, height), np.frombuffer(rows, _FEATURE))
        self.last = rows
        return FeatureSet(frame, features)


def _rows(features: Features) -> np.ndarray:
    rows = np.zeros(len(features), _FEATURE)
    rows["pixel"], rows["octave"], rows["angle"] = features.pixels, features.octaves, features.angles
    rows["response"], rows["descriptor"] = features.responses, features.descriptors
    return rows


def _features(size: tuple[int, int], rows: np.ndarray) -> Features:
    try:
        return Features(
            size,
            rows["pixel"].astype(np.float64),
            rows["octave"].astype(np.int32),
            rows["angle"].astype(np.float64),
            rows["response"].astype(np.float64),
            np.ascontiguousarray(rows["descriptor"]),
        )
    except ValueError as error:
        raise BitstreamError(f"corners: {error}") from None


def _inflated(data: bytes, before: bytes, size: int) -> bytes:
    inflate = zlib.decompressobj(zdict=before) if before else zlib.decompressobj()
    try:
        content = inflate.decompress(data, size + 1)
    except zlib.error as error:
        raise BitstreamError(f"corners: {error}") from None
    if len(content) != size or not inflate.eof or inflate.unused_data:
        raise BitstreamError(f"corners: the content is not {size} bytes")
    return content


def _crc(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CRC_BYTES, "little")
