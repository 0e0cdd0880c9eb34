"""Cyclone DDS's C library, which the wheel `cyclonedds` brings: what we call of it.

The wheel's own classes serialise field by field in Python and hold every message against a
description of its type; we have the bytes already. So its C functions are called by ctypes.
Source: dds.h and ddsi_serdata.h of Cyclone DDS 11.0.
"""

from __future__ import annotations

import ctypes as ct
import sys
from functools import cache
from typing import Any

from trocar.errors import InputError, MissingExtraError, TrocarError

I32, U32, I64, U64, SIZE, POINTER = (
    ct.c_int32,
    ct.c_uint32,
    ct.c_int64,
    ct.c_uint64,
    ct.c_size_t,
    ct.c_void_p,
)
FOREVER = 2**63 - 1
UNLIMITED = -1
ANY_STATE = 0x7F
DATA = 2
DATA_AVAILABLE = 1 << 8
PUBLICATION_MATCHED = 1 << 11

# What may wait lets other threads of Python run meanwhile: {name: (result, arguments)}.
WAITING: dict[str, tuple[Any, list[Any]]] = {
    "dds_create_domain": (I32, [U32, ct.c_char_p]),
    "dds_create_participant": (I32, [U32, POINTER, POINTER]),
    "dds_create_topic": (I32, [I32, POINTER, ct.c_char_p, POINTER, POINTER]),
    "dds_create_writer": (I32, [I32, I32, POINTER, POINTER]),
    "dds_create_reader": (I32, [I32, I32, POINTER, POINTER]),
    "dds_create_waitset": (I32, [I32]),
    "dds_waitset_wait": (I32, [I32, POINTER, SIZE, I64]),
    "dds_writecdr": (I32, [I32, POINTER]),
    "dds_delete": (I32, [I32]),
}
# What never waits keeps the others from running: to stop and begin again costs more than it.
QUICK: dict[str, tuple[Any, list[Any]]] = {
    "dds_waitset_attach": (I32, [I32, I32, ct.c_ssize_t]),
    "dds_set_status_mask": (I32, [I32, U32]),
    "dds_get_publication_matched_status": (I32, [I32, POINTER]),
    "dds_get_guid": (I32, [I32, POINTER]),
    "dds_get_entity_sertype": (I32, [I32, POINTER]),
    "dds_get_matched_subscriptions": (I32, [I32, POINTER, SIZE]),
    "dds_get_matched_subscription_data": (POINTER, [I32, U64]),
    "dds_get_matched_publication_data": (POINTER, [I32, U64]),
    "dds_builtintopic_free_endpoint": (None, [POINTER]),
    "dds_qget_userdata": (ct.c_bool, [POINTER, POINTER, POINTER]),
    "dds_free": (None, [POINTER]),
    "dds_strretcode": (ct.c_char_p, [I32]),
    "dds_writecdr": (I32, [I32, POINTER]),
    "dds_takecdr": (I32, [I32, POINTER, U32, POINTER, U32]),
    "ddsi_serdata_from_ser_iov": (POINTER, [POINTER, ct.c_int, SIZE, POINTER, SIZE]),
    "ddsi_serdata_size": (U32, [POINTER]),
    "ddsi_serdata_to_ser": (None, [POINTER, SIZE, SIZE, POINTER]),
    "ddsi_serdata_unref": (None, [POINTER]),
    "dds_create_qos": (POINTER, []),
    "dds_delete_qos": (None, [POINTER]),
    "dds_qset_durability": (None, [POINTER, ct.c_int]),
    "dds_qset_durability_service": (None, [POINTER, I64, ct.c_int, I32, I32, I32, I32]),
    "dds_qset_history": (None, [POINTER, ct.c_int, I32]),
    "dds_qset_reliability": (None, [POINTER, ct.c_int, I64]),
    "dds_qset_userdata": (None, [POINTER, ct.c_char_p, SIZE]),
    "dds_qset_data_representation": (None, [POINTER, U32, POINTER]),
}


class Metadata(ct.Structure):
    """dds_type_meta_ser."""

    _fields_ = (("data", POINTER), ("size", U32))


class Descriptor(ct.Structure):
    """dds_topic_descriptor_t: a topic's type."""

    _fields_ = (
        ("size", U32),
        ("align", U32),
        ("flags", U32),
        ("keys_count", U32),
        ("type_name", ct.c_char_p),
        ("keys", POINTER),
        ("ops_count", U32),
        ("ops", ct.POINTER(U32)),
        ("meta", ct.c_char_p),
        ("type_information", Metadata),
        ("type_mapping", Metadata),
        ("representation", U32),
    )


class Slice(ct.Structure):
    """ddsrt_iovec_t: bytes to send."""

    _fields_ = (("base", ct.c_char_p), ("length", SIZE))


class SampleInfo(ct.Structure):
    """dds_sample_info_t, of which we read whether there is data and who wrote it."""

    _fields_ = (
        ("sample_state", ct.c_int),
        ("view_state", ct.c_int),
        ("instance_state", ct.c_int),
        ("valid_data", ct.c_bool),
        ("source_timestamp", I64),
        ("instance_handle", U64),
        ("publication_handle", U64),
        ("counts", U32 * 5),
    )


class Matched(ct.Structure):
    """dds_publication_matched_status_t."""

    _fields_ = (
        ("total", U32),
        ("total_change", I32),
        ("current", U32),
        ("current_change", I32),
        ("last", U64),
    )


class Endpoint(ct.Structure):
    """dds_builtintopic_endpoint_t, up to its quality of service."""

    _fields_ = (
        ("key", ct.c_uint8 * 16),
        ("participant_key", ct.c_uint8 * 16),
        ("participant", U64),
        ("topic_name", ct.c_char_p),
        ("type_name", ct.c_char_p),
        ("qos", POINTER),
    )


class DdsError(TrocarError):
    """Cyclone DDS refused; `code` is its own."""

    def __init__(self, doing: str, code: int, reason: str) -> None:
        self.code = code
        super().__init__(f"ROS 2: {doing}: Cyclone DDS says: {reason}")


class Library:
    """The functions above, by name: `wait` those that may wait, `quick` those that never do."""

    def __init__(self, wait: ct.CDLL, quick: ct.PyDLL) -> None:
        self.wait = _declare(wait, WAITING)
        self.quick = _declare(quick, QUICK)

    def checked(self, code: int, doing: str) -> int:
        """Return `code`, an entity or a count.

        Raises:
            DdsError: it is negative
        """
        if code < 0:
            raise DdsError(doing, code, self.quick.dds_strretcode(code).decode(errors="replace"))
        return code


def _declare(library: Any, functions: dict[str, tuple[Any, list[Any]]]) -> Any:
    for name, (result, arguments) in functions.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


@cache
def load() -> Library:
    """Load the library.

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: on Windows, whose C structures are others
    """
    if sys.platform == "win32":
        raise InputError("ROS 2: not on Windows yet; allowed: Linux, macOS")
    try:
        from cyclonedds.internal import DDS
    except ImportError:
        raise MissingExtraError("cyclonedds", "ros2", "ROS 2") from None
    path = DDS._dll_handle._name
    return Library(ct.CDLL(path), ct.PyDLL(path))
