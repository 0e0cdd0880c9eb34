"""Record a world into a file that standard tools open and `trocar replay` repeats."""

from __future__ import annotations

import atexit
import json
import platform
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Self

import mujoco
import numpy as np

from trocar import __version__
from trocar.descriptions.calibrated import rig_overlays
from trocar.descriptions.overlay import overlay_text
from trocar.errors import InputError
from trocar.simulation.recording.extras import Extra
from trocar.simulation.recording.fingerprint import rig_fingerprint
from trocar.simulation.recording.library import mcap_library
from trocar.simulation.recording.sampler import Sampler
from trocar.simulation.recording.values import plain
from trocar.simulation.recording.writers import ProcessWriter, ThreadWriter

if TYPE_CHECKING:
    from trocar.simulation.world import World

#: Of our own channels; a reader refuses what it does not know.
FORMAT = 2


class Recorder:
    """Records a world from when it is made until `stop`, or for a `with` block.

    Args:
        world: is recorded; commands and steps go on as always
        file: what to write to: a path, or a binary file that is open for writing
        overwrite: replace a file that exists

    Raises:
        InputError: the file exists or cannot be written, or the world is being recorded already
        MissingExtraError: the library for MCAP is not installed
    """

    def __init__(
        self, world: World, file: str | Path | IO[bytes], *, overwrite: bool = False
    ) -> None:
        mcap_library("recording")
        self.file = _label(file)
        if world.recorder is not None:
            raise InputError(f"{self.file}: the world is recorded into {world.recorder.file} now")
        try:
            about = _about(world), world.time, world.timestep
            writer = (
                ProcessWriter(Path(file).expanduser(), *about, overwrite=overwrite)
                if isinstance(file, str | Path)
                else ThreadWriter(file, self.file, *about)
            )
            writer.past(world.past.entries if world.past.complete else ())
        except FileExistsError as error:
            raise InputError(
                f"{self.file}: exists already; allowed: a new file, or overwriting it"
                " (--overwrite, overwrite=True)"
            ) from error
        except OSError as error:
            raise InputError(
                f"{self.file}: cannot be written: {error.strerror or error}"
            ) from error
        self._world, self._writer = world, writer
        self._sampler = Sampler(world, writer)
        writer.recycle = self._sampler.recycle
        self._sampler.start()
        self._stopped = False
        #: How many messages of others were left out.
        self.left_out = 0
        world.recorder = self
        atexit.register(self.stop)

    @property
    def rows(self) -> int:
        """Physics periods recorded so far, the state at the beginning included."""
        return self._sampler.count

    @property
    def size(self) -> int:
        """Bytes in the file so far."""
        return self._writer.size

    @property
    def failure(self) -> str:
        """Why the file could not be written to its end; "" while all is well."""
        return self._writer.failure

    def add(self, extra: Extra) -> bool:
        """Write a message of somebody else as well; from any thread.

        Returns:
            False where the recording has ended or cannot follow: the message is left out
        """
        left_out = self._stopped or not self._writer.add(extra)
        self.left_out += left_out
        return not left_out

    def stop(self) -> None:
        """End the recording and close the file; a second time nothing happens."""
        if self._stopped:
            return
        self._stopped = True
        atexit.unregister(self.stop)
        self._world.recorder = None
        self._sampler.stop()
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


def versions() -> dict[str, str]:
    """Return what the last bits of a motion may depend on beside the recording."""
    return {
        "trocar": __version__,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "machine": platform.machine(),
    }


def _about(world: World) -> dict[str, str]:
    """Return what a replay has to know of a world, and what it can compare."""
    return {
        "format": str(FORMAT),
        **versions(),
        "rig": world.first_rig.name,
        "rig_source": world.rig_source,
        "rig_fingerprint": rig_fingerprint(world.first_rig),
        "arguments": json.dumps({k: plain(v) for k, v in world.arguments.items()}),
        **_calibration(world),
        "timestep_s": repr(world.timestep),
        "start_s": repr(world.time),
        "start_period": str(world.periods),
        "repeatable": world.past.why_not or "yes",
    }


def _calibration(world: World) -> dict[str, str]:
    """Return the overlays that the arms carry, whole, so that their files may change or go."""
    overlays = rig_overlays(world.first_rig)
    texts = {arm: [overlay.file, overlay_text(overlay)] for arm, overlay in overlays.items()}
    return {"calibration": json.dumps(texts)} if texts else {}


def _label(file: str | Path | IO[bytes]) -> str:
    if isinstance(file, str | Path):
        return str(file)
    return str(getattr(file, "name", "the recording"))
