"""A rosbag 1 file, read chunk by chunk; one that was not closed up to where it breaks off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any


def rosbag1_reader(path: Path) -> Any:
    """Return rosbags' reader of a file, as a context; `broken` is set where it was not closed."""
    from rosbags import rosbag1
    from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

    class Reader1(rosbag1.Reader):
        """Reads no index of messages: it grows with the recording."""

        broken = False

        def open(self) -> None:
            """Open the file, by its chunks where it has no index."""
            try:
                super().open()
            except rosbag1.ReaderError as error:
                if "not indexed" not in str(error):
                    raise
                self.broken = True
                self.bio = self.path.open("rb")
                self._find_chunks(self.path.stat().st_size)

        def read_index_data(self, pos: int, indexes: Any) -> None:
            """Do nothing."""

        def _find_chunks(self, end: int) -> None:
            """Note the chunks up to the end of the file [bytes], and the topics in them."""
            stream: Any = self.bio
            stream.readline()
            with suppress(rosbag1.ReaderError):  # where the file breaks off
                while True:
                    at = stream.tell()
                    if Header.read(stream).get_uint8("op") == RecordType.CHUNK:
                        stream.seek(at)
                        self._note_chunk(at, end)
                    else:
                        read_bytes(stream, read_uint32(stream))

        def _note_chunk(self, at: int, end: int) -> None:
            """Note the chunk that begins here, and its topics: those of its whole records.

            The size of a chunk is written when it is complete, and is 0 before.
            """
            stream: Any = self.bio
            chunk = self.read_chunk()
            rest = chunk.datasize or end - chunk.datapos
            stream.seek(chunk.datapos)
            plain = BytesIO(chunk.decompressor(read_bytes(stream, rest)))
            size, whole = len(plain.getbuffer()), 0
            with suppress(rosbag1.ReaderError):
                while whole < size:
                    head = Header.read(plain)
                    read_bytes(plain, read_uint32(plain))
                    end_of_record = plain.tell()
                    if head.get_uint8("op") == RecordType.CONNECTION:
                        plain.seek(whole)
                        self.bio = plain
                        self.connections.append(self.read_connection())
                        self.bio = stream
                    whole = end_of_record
            self.chunks[at] = chunk if chunk.datasize else chunk._replace(datasize=whole)

    return Reader1(path)


def rosbag1_messages(
    reader: Any, chosen: Mapping[int, Any]
) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, time of logging [ns] and bytes of messages, in the order of the file.

    Args:
        reader: an open one of `rosbag1_reader`
        chosen: {number: connection} of the topics to read
    """
    from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

    for position in sorted(reader.chunks):
        chunk = reader.chunks[position]
        reader.bio.seek(chunk.datapos)
        plain = BytesIO(chunk.decompressor(read_bytes(reader.bio, chunk.datasize)))
        end = len(plain.getbuffer())
        while plain.tell() < end:
            head = Header.read(plain)
            data = read_bytes(plain, read_uint32(plain))
            if head.get_uint8("op") == RecordType.MSGDATA and head.get_uint32("conn") in chosen:
                found = chosen[head.get_uint32("conn")]
                kind = found.msgtype.replace("/msg/", "/")
                yield found.topic, kind, head.get_time("time"), data
