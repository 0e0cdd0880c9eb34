"""How fast, and how true: what `trocar sim --headless` and `trocar bench` measure."""

from trocar.apps.benchmarks.core import core
from trocar.apps.benchmarks.figure import Figure
from trocar.apps.benchmarks.figures import figures
from trocar.apps.benchmarks.headless import HeadlessReport, run_headless
from trocar.apps.benchmarks.interface import interface
from trocar.apps.benchmarks.recording import recording
from trocar.apps.benchmarks.scope import scope
from trocar.apps.benchmarks.soak import soak
from trocar.apps.benchmarks.startup import startup
from trocar.apps.timing import Table9Row, table9

__all__ = [
    "Figure",
    "HeadlessReport",
    "Table9Row",
    "core",
    "figures",
    "interface",
    "recording",
    "run_headless",
    "scope",
    "soak",
    "startup",
    "table9",
]
