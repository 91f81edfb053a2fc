"""The settings of video codecs, by the names of the field; `encoders` says which encoder can do what."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from codecbench.core.contracts.params import Params
from codecbench.plugins.codecs.video.encoders import ENCODERS, RATES, Encoder, PixelFormat

_INTRA_ONLY = "intra_only"


def _frames_from_gop(value: Any) -> Any:
    return 1 if value == _INTRA_ONLY else value


Gop = Annotated[int, BeforeValidator(_frames_from_gop, json_schema_input_type=int | Literal["intra_only"])]


class VideoParams(Params):
    """What an encoder is asked for: a rate by one of `crf`, `qp` and `bitrate_kbps`, and how it codes.

    Where no rate, preset or pixel format is given, it is the encoder's usual one. encoder_name: FFmpeg's name.
    """

    encoder_name: ClassVar[str]

    crf: float | None = Field(None, description="constant quality, on the encoder's scale: the higher, the smaller")
    qp: int | None = Field(None, description="constant quantiser, on the encoder's scale: the higher, the smaller")
    bitrate_kbps: float | None = Field(None, description="bit rate at the sequence's frame rate")
    vbv_ms: float = Field(1000, ge=20, le=10000, description="buffer that bounds a bit rate, as time at that rate")
    preset: str | int | None = Field(None, description="the encoder's trade of time for size, by its own name")
    gop: Gop = Field(30, ge=1, le=1000, description="frames from start to start; intra_only is 1")
    intra_refresh: bool = Field(False, description="a column of intra blocks that moves over `gop` frames, no starts")
    pixel_format: PixelFormat = Field("yuv420p", description="what is coded: gray, or chroma at half or full size")
    threads: Literal[1] = Field(1, description="threads of the encoder; with one its bytes repeat")
    latency: Literal["low", "any"] = Field("low", description="low: each packet at once; any: look-ahead, B-frames")

    @classmethod
    def encoder_of(cls, values: Any) -> Encoder | None:
        """The encoder that these values ask for, where they do so validly."""
        return ENCODERS[cls.encoder_name]

    @property
    def traits(self) -> Encoder:
        """What is known of the encoder that these settings are for."""
        return ENCODERS[self.encoder_name]

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: Any) -> Any:
        if not isinstance(values, dict) or (encoder := cls.encoder_of(values)) is None:
            return values
        usual = dict(encoder.usual)
        if any(values.get(name) is not None for name in RATES):
            usual = {name: value for name, value in usual.items() if name not in RATES}
        return {**usual, **{name: value for name, value in values.items() if name not in usual or value is not None}}

    @model_validator(mode="after")
    def _the_encoder_can(self) -> Self:
        faults = list(self.traits.faults(self))
        if faults:
            raise ValueError("; ".join(faults))
        return self


class H264Params(VideoParams):
    """H.264, by x264 (preset veryfast, crf 23) or by an encoder in hardware."""

    encoder: Literal["libx264", "h264_nvenc", "h264_v4l2m2m", "h264_vaapi"] = Field(
        "libx264", description="FFmpeg's name of the encoder"
    )

    @classmethod
    def encoder_of(cls, values: Any) -> Encoder | None:
        return ENCODERS.get(str(values.get("encoder", "libx264")))

    @property
    def traits(self) -> Encoder:
        return ENCODERS[self.encoder]


class HevcParams(VideoParams):
    """HEVC (H.265), by x265: preset veryfast, crf 28."""

    encoder_name = "libx265"


class Av1Params(VideoParams):
    """AV1, by SVT-AV1: preset 8 of 0 (small) to 13 (fast), crf 35."""

    encoder_name = "libsvtav1"


class Vp9Params(VideoParams):
    """VP9, by libvpx: preset (its cpu-used) 7 of 0 (small) to 9 (fast), crf 32."""

    encoder_name = "libvpx-vp9"


class MjpegParams(VideoParams):
    """Motion JPEG, by FFmpeg: a JPEG for each picture, at qp 5 of 1 (large) to 31."""

    encoder_name = "mjpeg"
    gop: Gop = Field(1, ge=1, description="1: each picture stands alone")


class Ffv1Params(VideoParams):
    """FFV1 (RFC 9043), by FFmpeg: lossless of what it is given."""

    encoder_name = "ffv1"
    pixel_format: PixelFormat = Field("rgb", description="rgb keeps every sample; the others what their format keeps")
