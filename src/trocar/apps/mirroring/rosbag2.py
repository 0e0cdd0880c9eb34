"""Messages of a rosbag 2 with SQLite files, in the order of their times."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from trocar.apps.mirroring.rosbag1 import Told
from trocar.errors import LogError


def sqlite_topics(path: Path) -> dict[str, str]:
    """Return {topic: type} of a file.

    Raises:
        LogError: it is no such file
    """
    with closing(_open(path)) as base:
        try:
            rows = base.execute("SELECT name, type FROM topics").fetchall()
        except sqlite3.Error as error:
            raise LogError(str(path), f"is no file of a rosbag 2: {error}") from error
    return {str(name): str(kind) for name, kind in rows}


def sqlite_messages(path: Path, topics: Collection[str]) -> Iterator[Told]:
    """Read the messages of these topics; no more of them than one is in memory at a time.

    Raises:
        LogError: the file is damaged
    """
    with closing(_open(path)) as base:
        try:
            named = base.execute("SELECT id, name, type FROM topics").fetchall()
            known = {i: (str(name), str(kind)) for i, name, kind in named if name in topics}
            marks = ", ".join("?" * len(known))
            asked = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN"
            rows = base.execute(f"{asked} ({marks}) ORDER BY timestamp", list(known))
            for topic, time, data in rows:
                yield Told(*known[topic], int(time), bytes(data))
        except sqlite3.Error as error:
            raise LogError(str(path), f"cannot be read: {error}") from error


def _open(path: Path) -> sqlite3.Connection:
    try:
        return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
    except sqlite3.Error as error:
        raise LogError(str(path), f"cannot be read: {error}") from error
