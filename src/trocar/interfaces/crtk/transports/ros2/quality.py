"""Quality of service: what an endpoint promises and asks for, and what it says of itself."""

from __future__ import annotations

import ctypes as ct
from dataclasses import dataclass

from trocar.interfaces.crtk.transports.ros2 import library
from trocar.interfaces.crtk.transports.ros2.library import Library

XCDR1 = (ct.c_int16 * 1)(0)
KEEP_LAST = 0


@dataclass(frozen=True)
class Quality:
    """Quality of service: reliable, which every subscriber's wish is compatible with.

    Args:
        depth: how many messages are kept for a subscriber that lags, or wait at ours
        latched: whether late subscribers get the last message (TRANSIENT_LOCAL)
        user_data: of the endpoint
        best_effort: of a reader: takes what is promised by halves, too
    """

    depth: int
    latched: bool = False
    user_data: bytes = b""
    best_effort: bool = False


def quality_of(lib: Library, quality: Quality) -> int:
    """Return a new dds_qos_t."""
    quick = lib.quick
    wish = quick.dds_create_qos()
    quick.dds_qset_reliability(wish, 0 if quality.best_effort else 1, 0)
    quick.dds_qset_durability(wish, int(quality.latched))
    quick.dds_qset_history(wish, KEEP_LAST, quality.depth)
    all_of_it = [library.UNLIMITED] * 3
    quick.dds_qset_durability_service(wish, 0, KEEP_LAST, 1, *all_of_it)
    quick.dds_qset_data_representation(wish, 1, XCDR1)
    quick.dds_qset_userdata(wish, quality.user_data, len(quality.user_data))
    return wish


def user_data_of(lib: Library, endpoint: int | None) -> bytes | None:
    """Return what an endpoint's quality of service carries, and free the endpoint."""
    if not endpoint:
        return None
    qos = library.Endpoint.from_address(endpoint).qos
    data, size = ct.c_void_p(), ct.c_size_t()
    try:
        if not lib.quick.dds_qget_userdata(qos, ct.byref(data), ct.byref(size)):
            return b""
        found = ct.string_at(data, size.value) if data.value else b""
        lib.quick.dds_free(data)
        return found
    finally:
        lib.quick.dds_builtintopic_free_endpoint(endpoint)
