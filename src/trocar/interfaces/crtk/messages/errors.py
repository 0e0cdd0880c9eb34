"""What is said of a message that cannot be used."""

from __future__ import annotations

from trocar.errors import InputError

# As much of a wrong value as an error repeats. Source: our own choice, a line of a terminal.
LONGEST = 60


class MessageError(InputError):
    """A message, or bytes of one, that cannot be used.

    Args:
        kind: the type's name, such as "sensor_msgs/JointState"
        path: the field, such as "header.stamp" or "position[2]"; "" for the whole
        problem: what was got and what is allowed
    """

    def __init__(self, kind: str, path: str, problem: str) -> None:
        self.kind = kind
        self.path = path
        self.problem = problem
        super().__init__(": ".join(filter(None, [kind, path, problem])))


def shown(value: object) -> str:
    """What was got, short enough for one line, however large it is."""
    if value is None or isinstance(value, bool | float):
        return repr(value)
    if isinstance(value, int):
        return repr(value) if value.bit_length() < 128 else "a huge integer"
    if isinstance(value, str):
        return repr(value if len(value) <= LONGEST else value[:LONGEST] + "...")
    if isinstance(value, bytes | bytearray | list | tuple | dict):
        return f"{type(value).__name__} of {len(value)}"
    return type(value).__name__
