"""Disturbance observers and caps of a lab's PID files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.descriptions.records import Observer
from trocar.errors import DescriptionError
from trocar.robot.dvrk_config import import_dvrk
from trocar.simulation import World

FILE = "pid/sawControllersPID-PSM-Si.json"
#: share/pid/sawControllersPID-PSM-Si.json of sawIntuitiveResearchKit@9e535e6: P, D, nominal mass,
#: cut-off and largest output of each joint and disc.
ROWS = (
    (600.0, 30.0, 0.01, 50.0, 10.0),
    (600.0, 30.0, 0.01, 50.0, 10.0),
    (6000.0, 200.0, 0.005, 20.0, 15.0),
    *[(6.0, 0.08, 0.0005, 10.0, -1.0)] * 2,
    (6.0, 0.08, 0.0005, 0.0, -1.0),
    (6.0, 0.08, 0.0005, 10.0, -1.0),
)


def entries(**changes: Any) -> list[dict[str, Any]]:
    """Return a PID file's entries; those of the yaw differ, None takes one away."""
    found = [
        {
            "index": k,
            "p_gain": p,
            "d_gain": d,
            "use_disturbance_observer": True,
            "nominal_mass": mass,
            "disturbance_cutoff": cutoff,
            "pid_max_output": most,
        }
        for k, (p, d, mass, cutoff, most) in enumerate(ROWS)
    ]
    found[0] = {k: v for k, v in {**found[0], **changes}.items() if v is not None}
    return found


def imported(folder: Path, **changes: Any) -> Any:
    """Import an Si system with such a file; return what `import_dvrk` does."""
    path = lab.lab(folder / "in", "Si", {FILE: {"pid": entries(**changes)}})
    return import_dvrk(path, folder / "rig.toml")


def test_observers_and_caps_of_the_dvrks_own_file_are_those_of_the_built_in_arm(tmp_path: Path):
    control = imported(tmp_path).rig.arm("PSM1").arm.control["dvrk"]
    own = World("psm_si").arm("PSM1").description.control["dvrk"]
    assert control.observer == own.observer
    discs = np.array([[[o.mass, o.cutoff] for o in c.disc_observer] for c in (control, own)])
    np.testing.assert_array_equal(*discs[:, [0, 1, 3]])
    np.testing.assert_array_equal(discs[:, 2, 1], 0.0)
    assert control.pid_output_max == own.pid_output_max


def test_a_lab_changes_and_leaves_out_observers(tmp_path: Path):
    found = imported(tmp_path, nominal_mass=0.02, disturbance_cutoff=30.0, pid_max_output=-1.0)
    control = found.rig.arm("PSM1").arm.control["dvrk"]
    assert control.observer["yaw"] == Observer(0.02, 30.0)
    assert set(control.pid_output_max) == {"pitch", "insertion"}
    assert control.observer["pitch"] == Observer(0.01, 50.0)
    world = World(str(tmp_path / "rig.toml"))
    assert world.servos.disturbance is not None
    assert world.servos.disturbance.discs.sum() == 9  # of three PSMs
    off = imported(tmp_path / "off", use_disturbance_observer=False)
    assert set(off.rig.arm("PSM1").arm.control["dvrk"].observer) == {"pitch", "insertion"}
    World(str(tmp_path / "off" / "rig.toml")).step(5)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"nominal_mass": None},
            r"nominal_mass: is missing; allowed: 0 or more, for use_",
        ),
        ({"disturbance_cutoff": None}, r"pid\[0\].disturbance_cutoff: is missing; allowed: 0 or"),
        (
            {"disturbance_cutoff": -1.0},
            r"disturbance_cutoff: got -1.0; allowed: 0 or more",
        ),
        (
            {"use_disturbance_observer": "yes"},
            r"observer: got 'yes'; allowed: true",
        ),
        ({"pid_max_output": 0.0}, r"pid\[0\].pid_max_output: got 0; allowed: above 0, or below 0"),
    ],
)
def test_wrong_entries_of_observers_are_named(tmp_path: Path, changes: dict[str, Any], said: str):
    with pytest.raises(DescriptionError, match=said):
        imported(tmp_path, **changes)
