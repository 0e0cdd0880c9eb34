"""How short the way is from an action of a policy to 20 ms of motion and its count."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import FrameType

import pytest

import trocar
from trocar.tasks import make_task

#: Python calls of 20 ms, files, and changes of file from call to call: in all, and in `tasks`.
#: Source: measured on needle-pick, CPython 3.11: 120, 24, 76, and 15, 3. The simulation's part
#: (positions, inverse kinematics, two rows of set-points, two steps, one reading) is the rest.
MOST_CALLS, MOST_FILES, MOST_CHANGES = 124, 25, 78
MOST_OWN_CALLS, MOST_OWN_FILES = 16, 3


def path_of(action: Callable[[], object]) -> list[str]:
    """Return the file, in the package, of every Python call of trocar's that an action makes."""
    files: list[str] = []
    ours = Path(trocar.__file__).parent

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(f"{ours}"):
            files.append(Path(frame.f_code.co_filename).relative_to(ours).as_posix())

    before = sys.getprofile()
    gc.disable()  # a collection here would call what others hang on to it
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(before)
        gc.enable()
    return files


@pytest.mark.parametrize("scene", ["needle-reach", "needle-pick"])
def test_a_command_of_a_policy_takes_few_calls(scene: str) -> None:
    task = make_task(scene)
    script = task.policy()
    for _ in range(10):
        task.command(next(script))
    action = next(script)
    files = path_of(lambda: task.command(action))
    changes = sum(one != other for one, other in pairwise(files))
    assert len(files) <= MOST_CALLS, files
    assert len(set(files)) <= MOST_FILES, files
    assert changes <= MOST_CHANGES, files
    own = [file for file in files if file.startswith("tasks/")]
    assert len(own) <= MOST_OWN_CALLS and len(set(own)) <= MOST_OWN_FILES, own
