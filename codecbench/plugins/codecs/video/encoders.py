"""Capabilities of FFmpeg's encoders, and the FFmpeg options of their parameters.

Low latency means one packet per frame at once: no look-ahead, no B-frames, no frame threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from codecbench.core.contracts.params import Params
from codecbench.plugins.codecs.quantizer import DepthParams

PixelFormat = Literal["gray", "yuv420p", "yuv444p", "rgb"]
RATES: Final = ("crf", "qp", "bitrate_kbps")
_ANY_BITRATE: Final = (1.0, 1e6)
_X26X_PRESETS: Final = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo",
)  # fmt: skip
_FFMPEG_FORMATS: Final = {"rgb": "bgr0"}
_ALL_YUV: Final[tuple[PixelFormat, ...]] = ("gray", "yuv420p", "yuv444p")

Options = dict[str, str]


@dataclass(frozen=True)
class Encoder:
    """One of FFmpeg's encoders."""

    name: str
    """FFmpeg's name of the encoder."""
    decoder: str
    """FFmpeg's name of the decoder."""
    options: Callable[[VideoParams], Options]
    """Returns the FFmpeg options beyond rate, size and gop."""
    rates: dict[str, tuple[float, float]]
    """The supported ones of RATES, with least and greatest value."""
    usual: dict[str, float | int | str]
    """Default rate and preset."""
    presets: tuple[str | int, ...] = ()
    pixel_formats: tuple[PixelFormat, ...] = _ALL_YUV
    depth_bits: tuple[int, ...] = ()
    """Bits of the gray samples as which it codes 16-bit frames; empty if it does not."""
    integral: bool = False
    """Whether `crf` has to be a whole number."""
    intra_only: bool = False
    """Whether no frame refers to another."""
    intra_refresh: bool = False
    recovers: bool = False
    """Whether it marks recovery points of intra refresh."""
    slices: int = 0
    """Slices of a packet, each with a checksum; 0 for none."""
    looks_ahead: bool = True
    """Whether it can hold frames back to code them better."""
    bounds_any: bool = True
    """Whether `vbv_ms` bounds the bit rate when it looks ahead."""
    asynchronous: bool = False
    """Whether it returns packets when its threads finish them, at times that depend on the machine's load."""
    least_side: int = 2
    """Smaller frames are padded: x265 is not deterministic with one block in a row and overruns memory below that."""
    hardware: str = ""
    """Hardware that it needs, in words, if only opening it shows whether that is there."""

    def faults(self, params: VideoParams) -> Iterator[str]:
        """Yield what this encoder does not support of the parameters, each with the supported values."""
        names = [name for name in RATES if getattr(params, name) is not None]
        if len(names) > 1:
            yield f"{' and '.join(names)} are given; set only one of {', '.join(self.rates)}"
        yield from (fault for name in names for fault in self._rate_faults(name, getattr(params, name)))
        if params.preset not in (self.presets or (None,)):
            yield f"{self.name} has no preset {params.preset!r}; it has {_join(self.presets)}"
        if params.pixel_format not in self.pixel_formats:
            allowed = _join(self.pixel_formats)
            yield (
                f"{self.name} does not support pixel_format {params.pixel_format!r}, only {allowed}"
                " (gray frames get neutral chroma and decode to gray)"
            )
        if params.depth is not None and params.depth.depth_bits not in self.depth_bits:
            yield f"{self.name} does not support depth_bits {params.depth.depth_bits}, only {_join(self.depth_bits)}"
        if params.intra_refresh and not self.intra_refresh:
            yield f"{self.name} does not support intra_refresh; libx264 does"
        if params.intra_refresh and params.pixel_format == "gray":
            yield f"{self.name} crashes on gray with intra_refresh; set pixel_format to yuv420p, which costs under 2 %"
        if params.intra_refresh and params.latency != "low":
            yield "intra_refresh needs frames that are sent in order; set `latency: low`"
        if self.intra_only and params.gop != 1:
            yield f"{self.name} codes independent frames; set gop to 1 or intra_only, not {params.gop}"
        if params.intra_refresh and params.gop < 2:
            yield "intra_refresh takes `gop` frames; set gop to 2 or more"
        if params.latency == "any" and not self.looks_ahead:
            yield f"{self.name} never delays frames; set `latency: low`"
        if params.bitrate_kbps is None and _sets_vbv(params):
            yield "vbv_ms bounds a bit rate; set bitrate_kbps too"
        elif params.latency == "any" and not self.bounds_any and _sets_vbv(params):
            yield f"{self.name} ignores vbv_ms when it looks ahead; leave it out, or set `latency: low`"

    def _rate_faults(self, name: str, value: float) -> Iterator[str]:
        if name not in self.rates:
            yield f"{self.name} does not support {name}; supported rates: {_join(tuple(self.rates))}"
            return
        least, most = self.rates[name]
        if not least <= value <= most:
            yield f"{name} of {self.name} must be within {least:g}..{most:g}, got {value:g}"
        if name == "crf" and self.integral and value != int(value):
            yield f"crf of {self.name} must be a whole number, got {value:g}"

    def settings(self, params: VideoParams) -> Options:
        """All FFmpeg options by name."""
        options = {"g": str(params.gop), "threads": "1", **self.options(params)}
        if params.bitrate_kbps is not None:
            bits = round(params.bitrate_kbps * 1000)
            options |= {"b": str(bits), "bufsize": str(round(bits * params.vbv_ms / 1000))}
            options |= {} if self is _SVT_AV1 and params.latency == "any" else {"maxrate": str(bits)}
        return options

    def coded_size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height with padding: even, for chroma of half size, and at least `least_side`."""
        wide, high = (max(side + side % 2, self.least_side) for side in (width, height))
        return wide, high

    def ffmpeg_format(self, params: VideoParams, bits: int = 8) -> str:
        """FFmpeg's name of the pixel format of frames of 8 or 16 bits."""
        if bits == 16 and params.depth is not None:
            return f"{'yuv420p' if params.intra_refresh else 'gray'}{params.depth.depth_bits}le"
        return _FFMPEG_FORMATS.get(params.pixel_format, params.pixel_format)


_INTRA_ONLY = "intra_only"


def _frames_from_gop(value: Any) -> Any:
    return 1 if value == _INTRA_ONLY else value


Gop = Annotated[int, BeforeValidator(_frames_from_gop, json_schema_input_type=int | Literal["intra_only"])]


class VideoParams(Params):
    """Set a video encoder's rate, by one of `crf`, `qp` and `bitrate_kbps`, and how it codes.

    A missing rate, preset or pixel format gets the encoder's default.
    """

    encoder_name: ClassVar[str]
    """FFmpeg's name of the encoder."""

    crf: float | None = Field(
        None, description="constant quality, on the encoder's scale: higher values give smaller files"
    )
    qp: int | None = Field(
        None, description="constant quantizer, on the encoder's scale: higher values give smaller files"
    )
    bitrate_kbps: float | None = Field(None, description="bit rate at the sequence's frame rate, in kbit/s")
    vbv_ms: float = Field(1000, ge=20, le=10000, description="size of the rate control buffer, in ms at the bit rate")
    preset: str | int | None = Field(None, description="trade-off of time for size, by the encoder's own name")
    gop: Gop = Field(30, ge=1, le=1000, description="frames from one keyframe to the next; intra_only is 1")
    intra_refresh: bool = Field(
        False, description="instead of keyframes, move a column of intra blocks over `gop` frames"
    )
    pixel_format: PixelFormat = Field(
        "yuv420p",
        description="coded samples: gray, chroma at half or full size, or rgb; 16-bit frames are always gray",
    )
    threads: Literal[1] = Field(1, description="encoder threads; with one its bytes are reproducible")
    latency: Literal["low", "any"] = Field(
        "low", description="low: one packet per frame at once; any: look-ahead and B-frames"
    )

    @property
    def depth(self) -> DepthParams | None:
        """How 16-bit frames are coded; None if they are not."""
        return None

    @classmethod
    def encoder_of(cls, values: Any) -> Encoder | None:
        """The encoder of these unvalidated values; None if there is no such encoder."""
        return ENCODERS[cls.encoder_name]

    @property
    def traits(self) -> Encoder:
        """The encoder of these parameters."""
        return ENCODERS[self.encoder_name]

    @model_validator(mode="before")
    @classmethod
    def _fill_in_defaults(cls, values: Any) -> Any:
        if not isinstance(values, dict) or (encoder := cls.encoder_of(values)) is None:
            return values
        usual = dict(encoder.usual)
        if any(values.get(name) is not None for name in RATES):
            usual = {name: value for name, value in usual.items() if name not in RATES}
        return {**usual, **{name: value for name, value in values.items() if name not in usual or value is not None}}

    @model_validator(mode="after")
    def _check_encoder(self) -> Self:
        faults = list(self.traits.faults(self))
        if faults:
            raise ValueError("; ".join(faults))
        return self


class DepthVideoParams(VideoParams, DepthParams):
    """Parameters of a codec that codes 16-bit frames too, as gray samples of `depth_bits`."""

    @property
    def depth(self) -> DepthParams | None:
        return self if self.traits.depth_bits else None


def _join(values: tuple[str | int, ...]) -> str:
    return ", ".join(map(str, values)) if values else "none"


def _sets_vbv(params: VideoParams) -> bool:
    return bool(params.vbv_ms != type(params).model_fields["vbv_ms"].default)


def _quality(params: VideoParams) -> Options:
    return {name: f"{value:g}" for name in ("crf", "qp") if (value := getattr(params, name)) is not None}


def _x264_options(params: VideoParams) -> Options:
    """Options of x264. With look-ahead its macroblock tree is off, because that is not deterministic."""
    options = {"preset": str(params.preset), "sc_threshold": "0", "chroma_sample_location": "center"}
    options |= {"tune": "zerolatency"} if params.latency == "low" else {"mbtree": "0"}
    if params.intra_refresh:
        options["intra-refresh"] = "1"
    return options | _quality(params)


def _x265_options(params: VideoParams) -> Options:
    """Options of x265. The note on its settings is off, because it adds 2 kB to every keyframe."""
    x265_params = {"frame-threads": 1, "pools": "none", "log-level": "none", "info": 0, "open-gop": 0, "scenecut": 0}
    x265_params |= {"min-keyint": params.gop}
    options = {"preset": str(params.preset), "chroma_sample_location": "center"}
    options["x265-params"] = ":".join(f"{name}={value}" for name, value in x265_params.items())
    if params.latency == "low":
        options["tune"] = "zerolatency"
    return options | _quality(params)


def _svt_av1_options(params: VideoParams) -> Options:
    svt_params = "lp=1:scd=0" + (":pred-struct=1:lookahead=0" if params.latency == "low" else "")
    return {"preset": str(params.preset), "svtav1-params": svt_params} | _quality(params)


def _vp9_options(params: VideoParams) -> Options:
    is_low = params.latency == "low"
    options = {"cpu-used": str(params.preset), "keyint_min": str(params.gop), "row-mt": "0"}
    options |= {"deadline": "realtime" if is_low else "good", "lag-in-frames": "0" if is_low else "16"}
    if params.crf is not None:
        options |= {"crf": f"{params.crf:g}", "b": "0"}
    elif params.qp is not None:
        options |= {"crf": str(params.qp), "b": "0", "qmin": str(params.qp), "qmax": str(params.qp)}
    elif is_low:
        options["minrate"] = str(round((params.bitrate_kbps or 0) * 1000))
    return options


def _mjpeg_options(params: VideoParams) -> Options:
    return {"qmin": str(params.qp), "qmax": str(params.qp)}


def _ffv1_options(params: VideoParams) -> Options:
    return {"level": "3", "slices": str(params.traits.slices), "slicecrc": "1"}


def _nvenc_options(params: VideoParams) -> Options:
    options = {"preset": str(params.preset), "forced-idr": "1", "no-scenecut": "1"}
    options |= {"tune": "ull", "zerolatency": "1", "delay": "0", "bf": "0"} if params.latency == "low" else {}
    if params.crf is not None:
        options |= {"rc": "vbr", "cq": f"{params.crf:g}", "b": "0"}
    elif params.qp is not None:
        options |= {"rc": "constqp", "qp": str(params.qp)}
    return options


def _bitrate_options(params: VideoParams) -> Options:
    return {"bf": "0"}


_SVT_AV1: Final = Encoder(
    "libsvtav1", "libdav1d", _svt_av1_options, {"crf": (1, 63), "qp": (1, 63), "bitrate_kbps": _ANY_BITRATE},
    {"crf": 35, "preset": 8}, tuple(range(14)), ("yuv420p",), integral=True, bounds_any=False,
    asynchronous=True, least_side=64,
)  # fmt: skip

ENCODERS: Final = {
    encoder.name: encoder
    for encoder in (
        Encoder(
            "libx264", "h264", _x264_options, {"crf": (0, 51), "qp": (0, 51), "bitrate_kbps": _ANY_BITRATE},
            {"crf": 23, "preset": "veryfast"}, _X26X_PRESETS, intra_refresh=True, recovers=True,
            depth_bits=(10,),
        ),
        Encoder(
            "libx265", "hevc", _x265_options, {"crf": (0, 51), "qp": (0, 51), "bitrate_kbps": _ANY_BITRATE},
            {"crf": 28, "preset": "veryfast"}, _X26X_PRESETS, depth_bits=(10, 12), least_side=72,
        ),
        _SVT_AV1,
        Encoder(
            "libvpx-vp9", "vp9", _vp9_options, {"crf": (0, 63), "qp": (0, 63), "bitrate_kbps": _ANY_BITRATE},
            {"crf": 32, "preset": 7}, tuple(range(10)), ("yuv420p", "yuv444p"), integral=True,
            bounds_any=False,
        ),
        Encoder(
            "mjpeg", "mjpeg", _mjpeg_options, {"qp": (1, 31)}, {"qp": 5}, (), ("yuv420p", "yuv444p"), intra_only=True,
            looks_ahead=False,
        ),
        Encoder(
            "ffv1", "ffv1", _ffv1_options, {}, {}, (), ("gray", "yuv420p", "yuv444p", "rgb"), depth_bits=(10, 12, 16),
            slices=4, looks_ahead=False,
        ),
        Encoder(
            "h264_nvenc", "h264", _nvenc_options, {"crf": (0, 51), "qp": (0, 51), "bitrate_kbps": _ANY_BITRATE},
            {"crf": 23, "preset": "p4"}, tuple(f"p{effort}" for effort in range(1, 8)), ("yuv420p", "yuv444p"),
            least_side=146, hardware="an NVIDIA GPU and its driver",
        ),
        Encoder(
            "h264_v4l2m2m", "h264", _bitrate_options, {"bitrate_kbps": _ANY_BITRATE}, {"bitrate_kbps": 2000}, (),
            ("yuv420p",), looks_ahead=False, least_side=64, hardware="a V4L2 encoder of the board, as /dev/video*",
        ),
        Encoder(
            "h264_vaapi", "h264", _bitrate_options, {"bitrate_kbps": _ANY_BITRATE}, {"bitrate_kbps": 2000}, (),
            ("yuv420p",), looks_ahead=False, least_side=64, hardware="a GPU with a VA-API driver, as /dev/dri",
        ),
    )
}  # fmt: skip
