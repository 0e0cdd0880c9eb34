"""MuJoCo's warnings as records of the log `trocar.mujoco`, one a minute of each kind.

Without this, MuJoCo appends them to MUJOCO_LOG.TXT in the working folder, and prints them.
"""

from __future__ import annotations

import logging
import re

import mujoco

#: Time between two records of a kind [s]. Source: our own choice.
PERIOD_S = 60.0

_log = logging.getLogger("trocar.mujoco")


class OnceAMinute(logging.Filter):
    """Passes one record a minute of each kind, with the number of those left out since the last.

    Messages that differ by their numbers alone are of one kind.
    """

    def __init__(self) -> None:
        super().__init__()
        self._last: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record is due."""
        message = record.getMessage()
        kind = re.sub(r"[-+.\d]+", "#", message)
        last, left_out = self._last.get(kind, (None, 0))
        if last is not None and record.created < last + PERIOD_S:
            self._last[kind] = last, left_out + 1
            return False
        self._last[kind] = record.created, 0
        if left_out:
            record.msg, record.args = f"{message} ({left_out} more since the last)", None
        return True


def log_mujoco_warnings() -> None:
    """Send MuJoCo's warnings to the log, unless the program has a handler of its own."""
    if mujoco.get_mju_user_warning() is None:
        if not _log.filters:
            _log.addFilter(OnceAMinute())
        mujoco.set_mju_user_warning(_warned)


def _warned(message: str) -> None:
    _log.warning("MuJoCo: %s", " ".join(message.split()))
