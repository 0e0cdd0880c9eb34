"""The scripts of objects: Python files whose `before_step` is called before each physics step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import Any

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.modeling.props import run_script, script_error
from trocar.simulation.journal import Journal
from trocar.simulation.parts import Part

log = logging.getLogger(__name__)

#: The function that a script must have.
FUNCTION = "before_step"


class Scripts(Part):
    """Calls `before_step(object, world)` of each object that has a script.

    What a script commands makes no entries in the journal: when a recording is repeated, the script
    commands it again. A script that raises is not called any longer.

    Args:
        rig: its description
        journal: receives an event where a script raises
        world: handed to the scripts

    Attributes:
        running: objects whose scripts are called
        inside: whose script is being called, "" for none
    """

    def __init__(self, rig: RigDescription, journal: Journal, world: Any) -> None:
        self._paths = {prop.name: prop.script for prop in rig.objects if prop.script}
        self._journal, self._world = journal, world
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
            self._run(self._functions)

    def save(self) -> tuple[str, ...] | None:
        """Return the objects whose scripts run, None where none has a script."""
        return self.running if self._paths else None

    def load(self, state: tuple[str, ...]) -> None:
        """Run the scripts of these objects only."""
        self._run(state)

    def _run(self, names: Iterable[str]) -> None:
        self.running = tuple(names)
        self.before_every = 1 if self.running else 0

    def before_step(self) -> None:
        """Call every script with its object and the world."""
        world = self._world
        for name in self.running:
            try:
                with self._called(name):
                    self._functions[name](world.object(name), world)
            except Exception as problem:  # noqa: BLE001  it is code of others; the rest goes on
                text = f"{script_error(self._paths[name], problem)}; {name} is scripted no longer"
                self._run(other for other in self.running if other != name)
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
    def _called(self, name: str) -> Generator[None]:
        self.inside = name
        self._journal.inside += 1
        try:
            yield
        finally:
            self.inside = ""
            self._journal.inside -= 1
