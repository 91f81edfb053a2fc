"""The codecs that ship with codecbench, by reference: a codec's module is imported when a cell needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.codecs"


def _imagecodecs(name: str, target: str, summary: str, module: str = "imagecodecs") -> PluginSpec:
    path = f"{_HERE}.{module}:{target}"
    return PluginSpec(name, path, summary, requires=("imagecodecs",), extra="codecbench[codecs]")


def _video(name: str, target: str, summary: str) -> PluginSpec:
    return PluginSpec(name, f"{_HERE}.video.codecs:{target}", summary, requires=("av",), extra="codecbench[video]")


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [
        PluginSpec("raw", f"{_HERE}.raw:Raw", "raw pixels: the baseline, and a template for new codecs"),
        PluginSpec("png", f"{_HERE}.png:Png", "PNG through OpenCV, lossless"),
        PluginSpec("jpeg", f"{_HERE}.jpeg:Jpeg", "JPEG through OpenCV's libjpeg-turbo, by quality 1-100"),
        PluginSpec(
            "jpeg_qf",
            f"{_HERE}.jpeg_qf:JpegQf",
            "codecbench's own baseline JPEG, by a factor on the quantization table",
        ),
        PluginSpec("jpeg2000", f"{_HERE}.jpeg2000:Jpeg2000", "JPEG 2000 through glymur and OpenJPEG"),
        PluginSpec(
            "multilevel", f"{_HERE}.multilevel:Multilevel", "multi-level minimization of quantized DCT coefficients"
        ),
        PluginSpec(
            "multilevel_stream",
            f"{_HERE}.multilevel.stream:MultilevelStream",
            "inter-frame multi-level codec that reuses the table of the frame before",
        ),
        PluginSpec(
            "orb_features",
            f"{_HERE}.orb_features.codec:OrbFeatures",
            "ORB features instead of images",
        ),
        _imagecodecs("jpegxl", "JpegXl", "JPEG XL through imagecodecs and libjxl"),
        _imagecodecs("jpegls", "JpegLs", "JPEG-LS through imagecodecs and CharLS, lossless or near-lossless"),
        _imagecodecs("htj2k", "Htj2k", "High-Throughput JPEG 2000 through imagecodecs and OpenJPH"),
        _imagecodecs("webp", "Webp", "WebP through imagecodecs and libwebp"),
        _imagecodecs("avif", "Avif", "AVIF through imagecodecs and libavif"),
        PluginSpec("rvl", f"{_HERE}.rvl:Rvl", "RVL of 16-bit depth frames, lossless, as ROS 2 sends it"),
        _imagecodecs("zstd", "Zstd", "Zstandard of the pixels through imagecodecs, lossless", "arrays"),
        _imagecodecs("lz4", "Lz4", "LZ4 of the pixels through imagecodecs, lossless", "arrays"),
        _imagecodecs("lerc", "Lerc", "LERC of 16-bit frames through imagecodecs, by the largest error", "arrays"),
        _imagecodecs("zfp", "Zfp", "ZFP of 16-bit frames through imagecodecs, by the largest error", "arrays"),
        _video("h264", "H264", "H.264 video through PyAV and x264, or a hardware encoder"),
        _video("hevc", "Hevc", "HEVC video through PyAV and x265"),
        _video("av1", "Av1", "AV1 video through PyAV and SVT-AV1"),
        _video("vp9", "Vp9", "VP9 video through PyAV and libvpx"),
        _video("mjpeg", "Mjpeg", "Motion JPEG through PyAV: video of independent frames"),
        _video("ffv1", "Ffv1", "FFV1 video through PyAV, lossless"),
    ]
