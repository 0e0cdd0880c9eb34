"""The scripts of objects: Python files whose `before_step` is called before each physics step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.modeling.props import run_script, script_error
from trocar.simulation.journal import Journal

log = logging.getLogger(__name__)

#: The function that a script must have.
FUNCTION = "before_step"


class Scripts:
    """Calls `before_step(object, world)` of each object that has a script.

    What a script commands makes no entries in the journal: when a recording is repeated, the script
    commands it again. A script that raises is not called any longer.

    Args:
        rig: its description
        journal: receives an event where a script raises

    Attributes:
        running: objects whose scripts are called
        inside: whose script is being called, "" for none
    """

    def __init__(self, rig: RigDescription, journal: Journal) -> None:
        self._paths = {prop.name: prop.script for prop in rig.objects if prop.script}
        self._journal = journal
        self._functions: dict[str, Callable[[Any, Any], object]] = {}
        self.inside = ""
        self.running: tuple[str, ...] = ()

    def begin(self) -> None:
        """Run every file anew, so that nothing of what a script kept is left.

        Raises:
            DescriptionError: a file is no Python, raises, or has no `before_step`
        """
        if self._paths:
            with self._called(", ".join(self._paths)):
                self._functions = {name: run_script(p, FUNCTION) for name, p in self._paths.items()}
            self.running = tuple(self._functions)

    def keep(self, running: Iterable[str]) -> None:
        """Call the scripts of these objects only."""
        self.running = tuple(running)

    def call(self, world: Any) -> None:
        """Call every script with its object and the world."""
        for name in self.running:
            try:
                with self._called(name):
                    self._functions[name](world.object(name), world)
            except Exception as problem:  # noqa: BLE001  it is code of others; the rest goes on
                text = f"{script_error(self._paths[name], problem)}; {name} is scripted no longer"
                self.running = tuple(other for other in self.running if other != name)
                log.warning("%s", text)
                self._journal.event(name, "error", text=text)

    def check_outside(self, verb: str) -> None:
        """Reject what a script must not do.

        Raises:
            InputError: a script is being called
        """
        if self.inside:
            raise InputError(f"{verb}: got a call by the script of {self.inside}; allowed: outside")

    @contextmanager
    def _called(self, name: str) -> Iterator[None]:
        self.inside = name
        self._journal.inside += 1
        try:
            yield
        finally:
            self.inside = ""
            self._journal.inside -= 1
