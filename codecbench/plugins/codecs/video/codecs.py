"""The video codecs and their parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal, TypeVar

from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, StreamCodec
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.plugins.codecs.quantizer import DepthBits, DepthQuantization, QuantizerKind
from codecbench.plugins.codecs.video.encoders import (
    ENCODERS,
    DepthVideoParams,
    Encoder,
    Gop,
    PixelFormat,
    VideoParams,
)
from codecbench.plugins.codecs.video.library import open_encoder, require, versions
from codecbench.plugins.codecs.video.recipes import recipes
from codecbench.plugins.codecs.video.sessions import VideoDecoder, VideoEncoder

V = TypeVar("V", bound=VideoParams)
_TRIAL_SIZE = (640, 480)
_WITH_DEPTH = Capabilities(bits=(8, 16))
_REMARKS = {
    "gray": "color is not coded (gray)",
    "yuv420p": "color, if any, is coded at half size (yuv420p)",
    "yuv444p": "color is coded at full size (yuv444p)",
    "rgb": "",
}


class VideoCodec(StreamCodec[V]):
    """Base class of the video codecs. Raises Unsupported if PyAV, the encoder or its hardware is missing."""

    version = "1"
    capabilities = Capabilities()
    magic: ClassVar[bytes]
    """First four bytes of its keyframe packets."""
    sends_extradata: ClassVar[bool] = False
    """Whether the decoder needs a header that the encoder does not write into its packets."""

    def __init__(self, params: V) -> None:
        super().__init__(params)
        require(params.traits)
        if params.depth is None:
            self.capabilities = Capabilities()  # type: ignore[misc]
        if params.traits.hardware:
            open_encoder(params, *_TRIAL_SIZE, frame_rate_hz=30)

    def encoder(self, frame_rate_hz: float) -> VideoEncoder:
        return VideoEncoder(self.params, self.magic, frame_rate_hz, sends_extradata=self.sends_extradata)

    def decoder(self) -> VideoDecoder:
        return VideoDecoder(self.params.traits, self.magic)

    def is_low_delay(self) -> bool:
        return self.params.latency == "low"

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        if scene.bits == 16:
            note = f"Other stacks take quantized depth as {self.params.traits.ffmpeg_format(self.params, 16)} only."
            return tuple(replace(recipe, note=note) for recipe in super().recipes(scene))
        return tuple(recipes(self.params, scene))

    def remark(self) -> str:
        return _REMARKS[self.params.pixel_format]

    def remark_at(self, bits: int) -> str:
        depth = self.params.depth
        return self.remark() if bits == 8 or depth is None else depth.depth_remark

    def libraries(self) -> dict[str, str]:
        return versions()


class H264Params(DepthVideoParams):
    """Encode H.264 with x264 (default: preset veryfast, crf 23) or a hardware encoder."""

    encoder: Literal["libx264", "h264_nvenc", "h264_v4l2m2m", "h264_vaapi"] = Field(
        "libx264", description="FFmpeg's name of the encoder"
    )
    depth_bits: DepthBits = 10
    depth_quantization: DepthQuantization = 15.0

    @classmethod
    def encoder_of(cls, values: Any) -> Encoder | None:
        return ENCODERS.get(str(values.get("encoder", "libx264")))

    @property
    def traits(self) -> Encoder:
        return ENCODERS[self.encoder]


class H264(VideoCodec[H264Params]):
    """H.264 (ITU-T H.264, ISO/IEC 14496-10) by x264, or by an encoder in hardware."""

    name = "h264"
    version = "2"
    capabilities = _WITH_DEPTH
    params_type = H264Params
    examples = (
        {},
        {"qp": 30, "pixel_format": "yuv444p", "gop": 5},
        {"latency": "any", "gop": 8},
        {"intra_refresh": True, "gop": 4, "bitrate_kbps": 200},
    )
    magic = b"V264"


class HevcParams(DepthVideoParams):
    """Encode HEVC (H.265) with x265; default: preset veryfast, crf 28."""

    encoder_name = "libx265"


class Hevc(VideoCodec[HevcParams]):
    """HEVC (ITU-T H.265, ISO/IEC 23008-2) by x265."""

    name = "hevc"
    capabilities = _WITH_DEPTH
    params_type = HevcParams
    examples = ({}, {"qp": 30, "pixel_format": "yuv444p", "gop": 5}, {"latency": "any", "gop": 8})
    magic = b"V265"


class Av1Params(VideoParams):
    """Encode AV1 with SVT-AV1; default: preset 8 of 0 (small) to 13 (fast), crf 35."""

    encoder_name = "libsvtav1"


class Av1(VideoCodec[Av1Params]):
    """AV1 by SVT-AV1, decoded by dav1d."""

    name = "av1"
    version = "2"
    params_type = Av1Params
    examples = ({}, {"crf": 20, "gop": 5}, {"latency": "any", "gop": 8})
    magic = b"VAV1"


class Vp9Params(VideoParams):
    """Encode VP9 with libvpx; default: preset (its cpu-used) 7 of 0 (small) to 9 (fast), crf 32."""

    encoder_name = "libvpx-vp9"


class Vp9(VideoCodec[Vp9Params]):
    """VP9 by libvpx."""

    name = "vp9"
    params_type = Vp9Params
    examples = ({}, {"qp": 20, "pixel_format": "yuv444p", "gop": 5}, {"latency": "any", "gop": 8})
    magic = b"VVP9"


class MjpegParams(VideoParams):
    """Encode each frame as a JPEG with FFmpeg; default: qp 5 of 1 (large) to 31 (small)."""

    encoder_name = "mjpeg"
    gop: Gop = Field(1, ge=1, description="always 1: frames are independent")


class Mjpeg(VideoCodec[MjpegParams]):
    """Motion JPEG: each packet is a JPEG. The difference from it shows what inter-frame coding is worth."""

    name = "mjpeg"
    params_type = MjpegParams
    examples = ({}, {"qp": 2, "pixel_format": "yuv444p"})
    magic = b"VJPG"


class Ffv1Params(DepthVideoParams):
    """Encode FFV1 (RFC 9043) with FFmpeg, lossless in its pixel format."""

    encoder_name = "ffv1"
    quantizer: QuantizerKind = "none"
    depth_bits: DepthBits = 16
    depth_quantization: DepthQuantization = 100.0
    pixel_format: PixelFormat = Field("rgb", description="rgb is always lossless; other formats may lose color")


class Ffv1(VideoCodec[Ffv1Params]):
    """FFV1, version 3 (RFC 9043): lossless; its statistics continue from frame to frame within a GOP."""

    name = "ffv1"
    capabilities = _WITH_DEPTH
    params_type = Ffv1Params
    examples = ({}, {"pixel_format": "gray", "gop": 5})
    magic = b"VFF1"
    sends_extradata = True

    def is_lossless(self) -> bool:
        return self.params.pixel_format == "rgb" and self.params.quantizer == "none"
