"""Files of bitstreams: what they hold byte by byte, and that no damage passes for content."""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from pathlib import Path

import pytest

from codecbench.core.engine.storage.bitstream_file import (
    BitstreamDamage,
    BitstreamFile,
    CodedPacket,
    write_bitstreams,
    write_stream,
)

JOB = "ab" * 16
BITSTREAMS = [b"first", b"", b"\x00third\xff" * 40]


def written(bitstreams: list[bytes], job_id: str = JOB) -> bytes:
    stream = io.BytesIO()
    assert write_bitstreams(stream, bitstreams, job_id) == sum(map(len, bitstreams))
    return stream.getvalue()


def test_a_file_is_what_its_format_says() -> None:
    """Spelt out by hand, so that files of today are read in years."""
    start = b"CBBITS\x00\x02" + JOB.encode()
    index, offset = b"", 40
    for bitstream in BITSTREAMS:
        index += struct.pack("<QQI", offset, len(bitstream), zlib.crc32(bitstream))
        offset += len(bitstream)
    body = start + b"".join(BITSTREAMS) + index
    digest = hashlib.blake2b(body, digest_size=16).digest()
    head = struct.pack("<QQI16s", offset, 3, zlib.crc32(index), digest)
    assert written(BITSTREAMS) == body + head + struct.pack("<I", zlib.crc32(head))


@pytest.mark.parametrize("bitstreams", [BITSTREAMS, [b""], []])
def test_bitstreams_come_back_from_a_file_and_from_its_content(bitstreams: list[bytes], tmp_path: Path) -> None:
    content = written(bitstreams)
    (tmp_path / "job.bits").write_bytes(content)
    for source in (content, tmp_path / "job.bits"):
        file = BitstreamFile(source, JOB)
        assert len(file) == len(bitstreams)
        assert [file.read(index) for index in range(len(file))] == bitstreams
        assert [file.size_bytes(index) for index in range(len(file))] == list(map(len, bitstreams))
        assert all(type(file.read(index)) is bytes for index in range(len(file)))


def test_a_file_is_refused_at_every_length_but_its_own(tmp_path: Path) -> None:
    content = written(BITSTREAMS)
    for length in range(len(content)):
        with pytest.raises(BitstreamDamage, match=r"truncated|damaged|footer"):
            BitstreamFile(content[:length], JOB)
    with pytest.raises(BitstreamDamage, match="footer"):
        BitstreamFile(content + b"\0", JOB)
    (tmp_path / "empty.bits").write_bytes(b"")
    with pytest.raises(BitstreamDamage, match=r"empty\.bits: .*\(0 bytes\)"):
        BitstreamFile(tmp_path / "empty.bits", JOB)


def test_every_flipped_bit_is_noticed_and_sound_bitstreams_are_still_read() -> None:
    """Damage of start, index or footer is noticed when the file is opened; of a bitstream, when that one is read."""
    content = written(BITSTREAMS)
    payload = range(40, 40 + sum(map(len, BITSTREAMS)))
    for position in range(len(content)):
        broken = bytearray(content)
        broken[position] ^= 1 << position % 8
        if position not in payload:
            with pytest.raises(BitstreamDamage):
                BitstreamFile(bytes(broken), JOB)
            continue
        file = BitstreamFile(bytes(broken), JOB)
        hurt = 0 if position < 45 else 2
        with pytest.raises(BitstreamDamage, match=f"bitstream {hurt} is damaged"):
            file.read(hurt)
        assert [file.read(index) for index in {0, 1, 2} - {hurt}] == [BITSTREAMS[i] for i in {0, 1, 2} - {hurt}]


def test_a_footer_whose_checksum_is_right_must_fit_the_file() -> None:
    """A footer that counts more or fewer than there are is refused, and so is one that points elsewhere."""
    content = written(BITSTREAMS)
    offset, count, crc, digest, _ = struct.unpack("<QQI16sI", content[-40:])
    for wrong in ((offset, count + 1), (offset, count - 1), (offset + 20, count), (offset - 20, count)):
        head = struct.pack("<QQI16s", *wrong, crc, digest)
        with pytest.raises(BitstreamDamage, match="footer"):
            BitstreamFile(content[:-40] + head + struct.pack("<I", zlib.crc32(head)), JOB)
    moved = struct.pack("<QQI16s", offset - 20, count + 1, crc, digest)
    with pytest.raises(BitstreamDamage, match="index"):
        BitstreamFile(content[:-40] + moved + struct.pack("<I", zlib.crc32(moved)), JOB)


def test_whose_bitstreams_they_are_is_checked() -> None:
    with pytest.raises(BitstreamDamage, match=f"job {JOB}, not of {'cd' * 16}"):
        BitstreamFile(written(BITSTREAMS), "cd" * 16)
    with pytest.raises(BitstreamDamage, match="job short, "):
        BitstreamFile(written(BITSTREAMS, "short"), JOB)
    assert BitstreamFile(written(BITSTREAMS, "short"), "short").read(0) == b"first"


def stream_of(*frames: int) -> bytes:
    stream = io.BytesIO()
    write_stream(stream, [CodedPacket(bytes([frame]), frame, True, frame + 1) for frame in frames], JOB)
    return stream.getvalue()


def test_packets_of_a_stream_are_one_of_each_frame_in_any_order() -> None:
    file = BitstreamFile(stream_of(0, 2, 1), JOB)
    assert file.is_stream
    assert [packet.frame for packet in file.packets] == [0, 2, 1]
    for wrong in ((0, 0), (0, 2), (1,)):
        with pytest.raises(BitstreamDamage, match="one packet"):
            BitstreamFile(stream_of(*wrong), JOB)


def test_recovery_points_are_kept_and_earlier_files_have_none() -> None:
    """The earlier format, spelt out by hand: its entries lack the last number, and nothing else differs."""
    packets = [CodedPacket(b"a", 0, True, 1), CodedPacket(b"b", 1, False, 2, 0), CodedPacket(b"c", 2, False, 3, 29)]
    stream = io.BytesIO()
    write_stream(stream, packets, JOB)
    assert BitstreamFile(stream.getvalue(), JOB).packets == tuple(packet.sent_packet for packet in packets)
    body = b"CBSTRM\x00\x01" + JOB.encode() + b"abc"
    entries = [
        struct.pack("<QQIII?", 40 + i, 1, zlib.crc32(packet.data), i, i + 1, i == 0) for i, packet in enumerate(packets)
    ]
    index = b"".join(entries)
    digest = hashlib.blake2b(body + index, digest_size=16).digest()
    head = struct.pack("<QQI16s", 43, 3, zlib.crc32(index), digest)
    earlier = BitstreamFile(body + index + head + struct.pack("<I", zlib.crc32(head)), JOB)
    assert [(packet.frame, packet.starts, packet.recovery_frames) for packet in earlier.packets] == [
        (0, True, None), (1, False, None), (2, False, None),
    ]  # fmt: skip
    assert earlier.read(2) == b"c"


def test_what_is_no_file_of_bitstreams_is_refused_with_its_name(tmp_path: Path) -> None:
    content = written(BITSTREAMS)
    with pytest.raises(BitstreamDamage, match=r"bitstreams: .*earlier version"):
        BitstreamFile(b"CBBITS\x00\x01" + content[8:], JOB)
    with pytest.raises(BitstreamDamage, match="bitstreams: not a file"):
        BitstreamFile(b"CBBITS\x00\x03" + content[8:], JOB)
    with pytest.raises(BitstreamDamage, match=r"none\.bits: missing"):
        BitstreamFile(tmp_path / "none.bits", JOB)
    (tmp_path / "link.bits").symlink_to(tmp_path / "none.bits")
    with pytest.raises(BitstreamDamage, match=r"link\.bits: .*link"):
        BitstreamFile(tmp_path / "link.bits", JOB)
