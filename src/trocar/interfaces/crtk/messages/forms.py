"""Messages of which only the stamp and some numbers change: cut once, then filled in.

A form is a message's bytes with gaps. They are found by writing the message once with marks where
its stamp and its numbers belong, so that a form is what the encoder writes, whatever it writes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk.messages.binary import cdr_encode, ros1_encode
from trocar.interfaces.crtk.messages.checking import Message

Array = NDArray[np.float64]
#: What a form is filled in from: a stamp, then a table of numbers, each as written.
Source = bytes | list[bytes]

#: A stamp and numbers that no message has. Source: our own choice.
STAMP = (1234567890, 123456789)
FIRST = 987654321.5
NUMBER = Struct("<d")


@dataclass(frozen=True)
class Packing:
    """How a transport writes messages.

    Attributes:
        encode: writes a whole message of a type
        stamp: writes a stamp as it stands in a message
        number: writes one number as it stands in a message
        source: writes a stamp and a table of numbers, to fill in forms from
        cut: where in it numbers first to last (exclusive) of the table are
    """

    encode: Callable[[str, Message], bytes]
    stamp: Callable[[int, int], bytes]
    number: Callable[[float], bytes]
    source: Callable[[tuple[int, int], Array], Source]
    cut: Callable[[int, int], list[Any]]
    stamp_cut: Any = 0


def _binary(encode: Callable[[str, Message], bytes], stamp: Struct) -> Packing:
    """Return a packing whose stamps and numbers are eight bytes each."""
    return Packing(
        encode,
        stamp.pack,
        NUMBER.pack,
        lambda when, table: stamp.pack(*when) + table.tobytes(),
        lambda first, last: [slice(8 + 8 * first, 8 + 8 * last)],
        slice(0, 8),
    )


ROS1_PACKING = _binary(ros1_encode, Struct("<II"))
CDR_PACKING = _binary(cdr_encode, Struct("<iI"))


@dataclass(frozen=True)
class Form:
    """A message with gaps.

    Attributes:
        text: the message, with %b in each gap
        pick: takes what belongs there from a source
    """

    text: bytes
    pick: Callable[[Source], tuple[bytes, ...]]

    def filled(self, source: Source) -> bytes:
        """Return the message."""
        return self.text % self.pick(source)


def marks(count: int) -> Array:
    """Return numbers to write a message with, each of which marks where one belongs."""
    return np.arange(FIRST, FIRST + count)


def form(packing: Packing, kind: str, message: Message, where: Sequence[int]) -> Form:
    """Return the form of a message; one without a header has no gap for a stamp.

    Args:
        packing: how it is written
        kind: its type
        message: written with `STAMP` and `marks`, in the order in which they are written
        where: which number of the table belongs at each mark

    Raises:
        ValueError: the message is not written with the marks
    """
    head, rest, stamps = b"", packing.encode(kind, message), []
    if "header" in message:
        head, rest = _halved(rest.partition(packing.stamp(*STAMP)))
        stamps = [packing.stamp_cut]
    texts: list[bytes] = []
    for mark in reversed(marks(len(where)).tolist()):  # words, which may be anything, come before
        rest, behind = _halved(rest.rpartition(packing.number(mark)))
        texts.append(behind)
    last, *texts = [*texts, rest]
    pieces, runs = [head] if stamps else [], list[list[int]]()
    for piece, index in zip(reversed(texts), where, strict=True):
        if not piece and runs and runs[-1][1] == index:
            runs[-1][1] += 1
        else:
            runs.append([index, index + 1])
            pieces.append(piece)
    pieces.append(last)
    cuts = [cut for first, last in runs for cut in packing.cut(first, last)]
    text = b"%b".join(piece.replace(b"%", b"%%") for piece in pieces)
    return Form(text, itemgetter(*stamps, *cuts))


def _halved(parts: tuple[bytes, bytes, bytes]) -> tuple[bytes, bytes]:
    before, mark, after = parts
    if not mark:
        raise ValueError("a mark is not where it should be")
    return before, after
