"""A growing MCAP file: whole chunks, each on its way to the disk before the next one is made.

The records are the mcap library's. Its Writer takes messages one by one, some 10 us each; a chunk
that was made in one piece costs a tenth.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.recording.library import mcap_library

Bytes = NDArray[np.uint8]
Numbers = NDArray[np.uint64]

MAGIC = b"\x89MCAP0\r\n"
#: Opcodes of records that are laid out here. Source: MCAP specification 1, "Records".
MESSAGE, MESSAGE_INDEX = 0x05, 0x07
#: Little-endian layout of a message before its data, and of a message index before its entries.
MESSAGE_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
     ("log", "<u8"), ("publish", "<u8")]
)  # fmt: skip
INDEX_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("bytes", "<u4")]
)  # fmt: skip
#: zstd's level. Source: measured on full_cart in motion: 1 takes two thirds of what 3 does, and the
#: file is 2 % larger.
LEVEL = 1


@dataclass(frozen=True, eq=False)
class Part:
    """Messages that follow one another in a chunk.

    Attributes:
        data: message records, bytes
        times: of each message [ns], (k,)
        channels: of each message, (k,)
        offsets: of each message in `data`, (k,)
    """

    data: bytes
    times: Numbers
    channels: Numbers
    offsets: Numbers


def messages(items: Sequence[tuple[int, int, bytes]]) -> Part:
    """Lay out messages, each (channel, time [ns], data)."""
    pieces: list[bytes] = []
    at: list[int] = []
    end = 0
    for channel, time, data in items:
        head = np.zeros(1, MESSAGE_HEAD)
        length = MESSAGE_HEAD.itemsize - 9 + len(data)
        head[0] = (MESSAGE, length, channel, 0, time, time)
        pieces += [head.tobytes(), data]
        at.append(end)
        end += MESSAGE_HEAD.itemsize + len(data)
    columns = np.array([(time, channel) for channel, time, _ in items], np.uint64).reshape(-1, 2)
    return Part(b"".join(pieces), columns[:, 0], columns[:, 1], np.array(at, np.uint64))


class McapFile:
    """Writes chunk after chunk; without `finish` the file is readable to its last whole chunk.

    Args:
        stream: a binary file, open for writing
        profile: as MCAP has it: whose messages these are
        library: who writes
    """

    def __init__(self, stream: IO[bytes], profile: str, library: str) -> None:
        self._mcap = mcap_library("recording")
        self._packer = self._mcap.zstandard.ZstdCompressor(level=LEVEL)
        self._stream = stream
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._chunks: list[Any] = []
        self._metadata: list[Any] = []
        self._counts: dict[int, int] = {}
        self._news: list[Any] = []
        self.size = 0
        self._write(MAGIC)
        self._put(self._mcap.records.Header(profile, library))
        self._stream.flush()

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Name a kind of message; return its number."""
        record = self._mcap.records.Schema
        found = record(id=len(self._schemas) + 1, name=name, encoding=encoding, data=text.encode())
        self._schemas.append(found)
        self._news.append(found)
        return found.id

    def channel(self, topic: str, encoding: str, schema: int = 0) -> int:
        """Open a channel; return its number."""
        record = self._mcap.records.Channel
        found = record(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            metadata={},
            schema_id=schema,
        )
        self._channels.append(found)
        self._news.append(found)
        return found.id

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write names and values of the whole file."""
        offset = self.size
        self._put(self._mcap.records.Metadata(name=name, metadata=values))
        self._metadata.append(
            self._mcap.records.MetadataIndex(offset=offset, length=self.size - offset, name=name)
        )

    def chunk(self, parts: Sequence[Part]) -> None:
        """Pack messages into a chunk and hand it to the system."""
        news = self._bytes(*self._news)
        parts = [part for part in parts if len(part.times)]
        if not parts:
            return
        plain = b"".join([news, *(part.data for part in parts)])
        starts = np.cumsum([len(news), *(len(part.data) for part in parts[:-1])]).astype(np.uint64)
        times = np.concatenate([part.times for part in parts])
        channels = np.concatenate([part.channels for part in parts])
        offsets = np.concatenate([p.offsets + s for p, s in zip(parts, starts, strict=True)])
        first, last = int(times.min()), int(times.max())
        packed = self._packer.compress(plain)
        chunk = self._mcap.records.Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(plain),
            uncompressed_size=len(plain),
        )
        where = self.size
        self._put(chunk)
        length = self.size - where
        places, indices = self._index(times, channels, offsets)
        self._write(indices)
        self._stream.flush()
        self._news.clear()
        self._chunks.append(
            self._mcap.records.ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=where,
                chunk_length=length,
                message_index_offsets=places,
                message_index_length=len(indices),
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(plain),
            )
        )

    def finish(self) -> None:
        """Write the summary that lets a reader jump."""
        records, opcode = self._mcap.records, self._mcap.opcode.Opcode
        self._put(records.DataEnd(0))
        begin = self.size
        groups = (
            (opcode.SCHEMA, self._schemas),
            (opcode.CHANNEL, self._channels),
            (opcode.STATISTICS, [self._statistics()]),
            (opcode.CHUNK_INDEX, self._chunks),
            (opcode.METADATA_INDEX, self._metadata),
        )
        summary, offsets = b"", []
        for code, group in groups:
            data = self._bytes(*group)
            offsets.append(records.SummaryOffset(code, begin + len(summary), len(data)))
            summary += data
        table = begin + len(summary)
        summary += self._bytes(*offsets)
        footer = self._bytes(
            records.Footer(summary_start=begin, summary_offset_start=table, summary_crc=0)
        )
        crc = zlib.crc32(footer[:-4], zlib.crc32(summary))  # its own four bytes are the last
        self._write(summary + footer[:-4] + crc.to_bytes(4, "little") + MAGIC)
        self._stream.flush()

    def _index(
        self, times: Numbers, channels: Numbers, offsets: Numbers
    ) -> tuple[dict[int, int], bytes]:
        """Return where each channel's index stands in the file, and the indices."""
        order = np.argsort(channels, kind="stable")
        entries = np.stack([times[order], offsets[order]], axis=1).astype("<u8")
        ids, counts = np.unique(channels, return_counts=True)
        heads = np.zeros(len(ids), INDEX_HEAD)
        heads["opcode"], heads["channel"] = MESSAGE_INDEX, ids
        heads["bytes"] = 16 * counts
        heads["length"] = INDEX_HEAD.itemsize - 9 + heads["bytes"]
        raw, names = heads.tobytes(), entries.tobytes()
        places: dict[int, int] = {}
        pieces: list[bytes] = []
        at, done, size = self.size, 0, INDEX_HEAD.itemsize
        for row, (channel, count) in enumerate(zip(ids.tolist(), counts.tolist(), strict=True)):
            places[channel] = at
            piece = raw[row * size : (row + 1) * size] + names[16 * done : 16 * (done + count)]
            pieces.append(piece)
            at += len(piece)
            done += count
            self._counts[channel] = self._counts.get(channel, 0) + count
        return places, b"".join(pieces)

    def _statistics(self) -> Any:
        return self._mcap.records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            schema_count=len(self._schemas),
        )

    def _bytes(self, *records: Any) -> bytes:
        builder = self._mcap.data_stream.RecordBuilder()
        for record in records:
            record.write(builder)
        return builder.end()

    def _put(self, record: Any) -> None:
        self._write(self._bytes(record))

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self.size += len(data)
