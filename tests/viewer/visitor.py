"""A browser without a picture: reads the page off the wire, and sends what a person's would."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from trocar.viewer.channel import LABEL
from trocar.viewer.server import LocalServer, address, run_there

PATIENCE_S = 60.0
"""Time within which something has to come [s]."""


@dataclass
class Widget:
    """A widget, or a command of the palette, as it was sent.

    Attributes:
        uuid: its number on the wire
        kind: of its message, as "GuiSliderMessage"
        props: as they are now: value, options, content, visible, disabled, ...
    """

    uuid: str
    kind: str
    props: dict[str, Any]

    @property
    def value(self) -> Any:
        """The value that is shown."""
        return self.props["value"]

    @property
    def options(self) -> tuple[str, ...]:
        """The buttons of a group, or the rows of a list."""
        return tuple(self.props["options"])


@dataclass
class Node:
    """A node of the scene.

    Attributes:
        kind: of its message, as "LabelMessage"
        props: as they are now
        position, wxyz, visible: where it stands in its parent, and whether it is shown
    """

    kind: str
    props: dict[str, Any]
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    visible: bool = True


@dataclass
class Visitor:
    """An open connection to the page; each reading is of all that was sent before it.

    Attributes:
        server: of the page
        who: number of the browser
        widgets: {uuid: widget}, in the order in which they were made
        nodes: {name: node of the scene}
        acknowledged: numbers of the uploads of which the server took a part
    """

    server: LocalServer
    socket: Connection
    who: int = -1
    widgets: dict[str, Widget] = field(default_factory=dict)
    nodes: dict[str, Node] = field(default_factory=dict)
    acknowledged: set[str] = field(default_factory=set)
    _steps: Iterator[int] = field(default_factory=lambda: count(1))

    # ------------------------------------------------------------------ reading

    def read(self) -> Visitor:
        """Take in all that was sent until now; return self."""
        found = self.server.get_clients()[self.who]
        marks = [uuid.uuid4().hex for _ in range(2)]

        def mark() -> list[Any]:
            made = [
                owner.gui.add_html(text)
                for owner, text in zip((self.server, found), marks, strict=True)
            ]
            self.server.flush()
            found.flush()
            return made

        made = run_there(self.server, mark)
        self.wait(lambda: {*marks} <= {w.props.get("content") for w in self.widgets.values()})
        run_there(self.server, lambda: [handle.remove() for handle in made])
        return self

    def wait(self, met: Callable[[], object]) -> None:
        """Wait until something holds, and take in what is sent meanwhile."""
        end = time.monotonic() + PATIENCE_S
        while not met():
            assert time.monotonic() < end, "in vain"
            with suppress(TimeoutError):
                self._take(self.socket.recv(timeout=0.02))

    def all(self, label: str) -> list[Widget]:
        """Return the widgets of a label, in the order in which they were made."""
        self.read()
        return [w for w in self.widgets.values() if w.props.get("label") == label]

    def widget(self, label: str) -> Widget:
        """Return the widget of a label that was made last."""
        found = self.all(label)
        assert found, f"no widget {label!r}"
        return found[-1]

    def text(self, key: str) -> str:
        """Return the HTML of the element of our own with a key that was made last; "": hidden."""
        self.read()
        shown = [
            w.props["content"]
            for w in self.widgets.values()
            if f'data-trocar="{key}"' in w.props.get("content", "") and w.props["visible"]
        ]
        return shown[-1] if shown else ""

    def node(self, name: str) -> Node | None:
        """Return a node of the scene; None where there is none."""
        return self.read().nodes.get(name)

    # ------------------------------------------------------------------ acting

    def use(self, label: str, value: object) -> None:
        """Give the widget of a label a value, or press the button of a group."""
        self.give(self.widget(label), value)

    def give(self, widget: Widget, value: object) -> None:
        """Give a widget a value, whether or not the page offers it."""
        widget.props["value"] = value  # the server sends it to other browsers
        self.send("GuiUpdateMessage", uuid=widget.uuid, updates={"value": value})

    def report(self, width: int = 1920, query: str = "") -> None:
        """Report the width of the window [CSS px] and the query of the page, as client.js does."""
        self.use(LABEL, json.dumps({"width": width, "frames": None, "query": query}))

    def press(self, words: str) -> None:
        """Press an element of our own that sends words."""
        self.use(LABEL, json.dumps({"press": words}))

    def trigger(self, name: str) -> Widget:
        """Trigger a command of the palette, as its key does; return it."""
        command = self.widget(name)
        self.send("CommandTriggerMessage", uuid=command.uuid)
        return command

    def drag(self, name: str, position: tuple[float, float, float]) -> None:
        """Drag a handle in the scene to a position [m]."""
        node = self.node(name)
        assert node is not None, f"no node {name}"
        node.position = position
        self.send("TransformControlsDragStartMessage", name=name)
        moved = {"name": name, "wxyz": node.wxyz, "position": position}
        self.send("TransformControlsUpdateMessage", **moved)
        self.send("TransformControlsDragEndMessage", name=name)

    def upload(self, label: str, name: str, content: bytes, size: int | None = None) -> str:
        """Upload a file, announced with a size; return the number of the transfer."""
        source, number = self.widget(label).uuid, uuid.uuid4().hex
        both = {"source_component_uuid": source, "transfer_uuid": number}
        self.send(
            "FileTransferStartUpload", **both, filename=name, mime_type="",
            part_count=int(bool(content)), size_bytes=len(content) if size is None else size,
        )  # fmt: skip
        if content:
            self.send("FileTransferPart", **both, part_index=0, content=content)
        self.read()
        return number

    def send(self, kind: str, **fields: object) -> None:
        """Send a message, and wait until the server has acted on it: it takes them in turn."""
        self.socket.send(msgspec.msgpack.encode({"type": kind, **fields}))
        step = float(next(self._steps))
        self.socket.send(msgspec.msgpack.encode(_camera(step)))

        def acted() -> bool:
            client = self.server.get_clients().get(self.who)
            return client is not None and float(client.camera.position[0]) == step

        self.wait(acted)

    # ------------------------------------------------------------------ the wire

    def _take(self, batch: str | bytes) -> None:
        """Take in a batch: its lengths, zstd of msgpack, buffers at multiples of 8 bytes."""
        assert isinstance(batch, bytes)
        end = 16 + int.from_bytes(batch[8:16], "little")
        found = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(batch[16:end]))
        buffers: list[bytes] = []
        for length in found["binaryBufferLengths"]:
            begin = end + -end % 8
            end = begin + length
            buffers.append(batch[begin:end])
        for message in found["messages"]:
            self._apply(_filled(message, buffers))

    def _apply(self, message: dict[str, Any]) -> None:
        kind, props = message["type"], message.get("props")
        key: Any = message.get("uuid", message.get("name"))
        if kind == "FileTransferPartAck":
            self.acknowledged.add(message["transfer_uuid"])
        elif kind == "ResetGuiMessage":
            self.widgets.clear()
        elif kind in ("GuiRemoveMessage", "RemoveCommandMessage"):
            self.widgets.pop(key, None)
        elif kind == "RemoveSceneNodeMessage":
            self.nodes.pop(key, None)
        elif kind in ("GuiUpdateMessage", "CommandUpdateMessage") and key in self.widgets:
            self.widgets[key].props.update(message["updates"])
        elif kind == "SceneNodeUpdateMessage" and key in self.nodes:
            self.nodes[key].props.update(message["updates"])
        elif kind == "SetPositionMessage" and key in self.nodes:
            self.nodes[key].position = tuple(message["position"])
        elif kind == "SetOrientationMessage" and key in self.nodes:
            self.nodes[key].wxyz = tuple(message["wxyz"])
        elif kind == "SetSceneNodeVisibilityMessage" and key in self.nodes:
            self.nodes[key].visible = message["visible"]
        elif props is not None and "uuid" in message:
            own = {"value": message["value"]} if "value" in message else {}
            self.widgets[key] = Widget(key, kind, {**props, **own})
        elif props is not None:
            self.nodes[key] = Node(kind, props)


def _filled(value: Any, buffers: list[bytes]) -> Any:
    """Return a message with its arrays, which are flat on the wire."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], value["dtype"])
        return {key: _filled(one, buffers) for key, one in value.items()}
    return [_filled(one, buffers) for one in value] if isinstance(value, list) else value


def _camera(step: float) -> Mapping[str, object]:
    return {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (step, 0.0, 0.0),
        "fov": 1.0,
        "near": 0.01,
        "far": 100.0,
        "image_height": 700,
        "image_width": 860,
        "look_at": (0.0, 0.0, 1.0),
        "up_direction": (0.0, 0.0, 1.0),
    }


@contextmanager
def visiting(server: LocalServer, query: str = "") -> Iterator[Visitor]:
    """Visit a page while the `with` block lasts.

    Args:
        server: of the page
        query: that the browser shows, as "token=..."
    """
    before = {*server.get_clients()}
    with connect(
        f"{address(server)}/?{query}".replace("http", "ws", 1),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        compression=None,
        max_size=None,
        max_queue=None,
        ping_interval=None,
    ) as socket:
        visitor = Visitor(server, socket)
        socket.send(msgspec.msgpack.encode(_camera(0.0)))
        visitor.wait(lambda: {*server.get_clients()} - before)
        (visitor.who,) = {*server.get_clients()} - before
        yield visitor
    end = time.monotonic() + PATIENCE_S
    while visitor.who in server.get_clients():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.001)
