"""The transports that `trocar sim` finds, and which of them its options ask for."""

from __future__ import annotations

from argparse import ArgumentParser
from importlib import import_module
from pathlib import Path

from trocar.cli.serving import add_serving, transport_modules
from trocar.ros import transports

FOLDER = Path(str(transports.__file__)).parent


def requested(*words: str) -> list[str]:
    parser = ArgumentParser()
    add_serving(parser)
    args = parser.parse_args(words)
    return [m.name.rpartition(".")[2] for m in transport_modules() if m.requested(args)]


def test_every_module_that_opens_a_transport_is_found_and_its_options_are_what_it_holds() -> None:
    found = {module.name: module.options for module in transport_modules()}
    files = [path for path in FOLDER.rglob("*.py") if "\ndef open_transport(" in path.read_text()]
    assert len(files) == len(found) == 4
    for name, options in found.items():
        assert options == import_module(name).OPTIONS


def test_a_transport_is_imported_when_one_of_its_options_is_given() -> None:
    assert requested() == ["websocket"]
    assert requested("--ros1", "--ros2") == ["websocket", "ros1", "ros2"]
    assert requested("--foxglove-record", "new.mcap") == ["websocket", "foxglove"]
    assert requested("--foxglove-port", "1234") == ["websocket", "foxglove"]


def test_default_ports_are_the_transports_own() -> None:
    args = ArgumentParser()
    add_serving(args)
    values = args.parse_args([])
    assert values.websocket_port == import_module(f"{transports.__name__}.websocket").PORT
    assert values.foxglove_port == import_module(f"{transports.__name__}.foxglove").PORT
