"""The optional libraries that recordings are written and read with, asked for when needed."""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

from trocar.errors import MissingExtraError


class Mcap(NamedTuple):
    """What is used of mcap, and the compression that its files are packed with."""

    records: ModuleType
    data_stream: ModuleType
    opcode: ModuleType
    stream_reader: ModuleType
    exceptions: ModuleType
    zstandard: ModuleType


def mcap_library(purpose: str) -> Mcap:
    """Import mcap.

    Raises:
        MissingExtraError: it is not installed; `purpose` says what needs it
    """
    try:
        import zstandard
        from mcap import data_stream, exceptions, opcode, records, stream_reader
    except ImportError as error:
        raise MissingExtraError("mcap", "record", purpose) from error
    return Mcap(records, data_stream, opcode, stream_reader, exceptions, zstandard)
