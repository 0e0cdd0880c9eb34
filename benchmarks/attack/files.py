"""Damaged files of every format that trocar reads: read, or refused with one clear error."""

from __future__ import annotations

import logging
import random
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.attack import Tally
from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.cameras import load_camera
from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.fixtures import read_fixtures
from trocar.descriptions.overlay import Overlay, read_overlay, write_overlay
from trocar.errors import TrocarError
from trocar.formats.importing import import_file
from trocar.formats.surfaces import read_surface
from trocar.recording import open_recording, record
from trocar.robot.calibration import read_tracks
from trocar.robot.calibration.camera_views import read_views
from trocar.robot.calibration.touches import read_touches
from trocar.robot.dvrk_config import import_dvrk
from trocar.robot.follow import open_bag
from trocar.robot.identification.logs import read_motion
from trocar.robot.mocap import MocapSettings, simulate_tracks, write_tracks
from trocar.robot.mocap.touches import TouchSettings, write_touches
from trocar.robot.mocap.view_files import write_views
from trocar.robot.mocap.views import ViewSettings
from trocar.robot.recordings import read_arm_motion, recorded_joints
from trocar.robot.samples import write_samples
from trocar.simulation import World
from trocar.tasks.scoring import score_recording

#: A file that takes longer to read or to refuse has failed. Source: the project's goal. [s]
LONGEST_S = 5.0
#: What takes the place of numbers, and of other pieces of a text.
NUMBERS = ("nan", "-inf", "1e999", "9" * 5000, "-0", "1e-320", "0x10", '"1"', "[]", "true", "")
PIECES = ("[" * 20_000, '"' * 3, "\x00", "\ufeff", "../" * 50, "a" * 100_000, "=", "{", "<a>", ",")

#: Small files of formats that trocar reads and has none of.
FIXTURES = """schema = 1

[[fixture]]
name = "line"
kind = "tube"
arm = "PSM1"
mode = "force"
frame = "world"
points_mm = [[0.0, 0.0, 156.5], [20.0, 4.0, 150.0]]
clearance_mm = 0.3
stiffness_n_per_m = 1000.0
"""
SDF = """<sdf version="1.7"><model name="m">
<link name="base"><inertial><mass>1</mass></inertial></link>
<link name="tip"><pose>0 0 0.2 0 0 0</pose><inertial><mass>0.5</mass></inertial></link>
<joint name="turn" type="revolute"><parent>base</parent><child>tip</child>
<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
</model></sdf>
"""
MJCF = """<mujoco><worldbody><body name="base"><geom size="0.05" mass="1"/>
<body name="tip" pos="0 0 0.2"><joint name="turn" axis="0 1 0" range="-60 60" limited="true"/>
<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" mass="0.5"/></body></body></worldbody>
</mujoco>
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
STL = """solid s
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
endsolid s
"""

#: How a file is read: its path, and a folder for what is made of it.
Read = Callable[[Path, Path], object]


@contextmanager
def _silent() -> Iterator[None]:
    """Log no warnings of damaged files."""
    log = logging.getLogger("trocar")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)


def attack(seed: int, seconds: float) -> Tally:
    """Damage valid files in random ways and read them."""
    rng, tally = random.Random(seed), Tally("files")
    end = time.monotonic() + seconds
    with _silent(), tempfile.TemporaryDirectory() as folder:
        samples = written(Path(folder) / "samples")
        for file, read in samples:  # an undamaged file that is refused would try nothing
            read(file, _empty(Path(folder) / "out"))
        while time.monotonic() < end:
            file, read = rng.choice(samples)
            there = _empty(Path(folder) / "case")
            shutil.copytree(file.parent, there, dirs_exist_ok=True)
            damaged = there / file.name
            how = damage(damaged, rng)
            tally.tried += 1
            begun = time.monotonic()
            try:
                read(damaged, _empty(Path(folder) / "out"))
            except TrocarError:
                pass
            except Exception as error:  # noqa: BLE001  whatever else comes is the finding
                tally.failed.append(f"case {tally.tried}, {file.name}, {how}: {error!r:.300}")
            if time.monotonic() - begun > LONGEST_S:
                took = f"took {time.monotonic() - begun:.1f} s"
                tally.failed.append(f"case {tally.tried}, {file.name}, {how}: {took}")
    return tally


def written(folder: Path) -> list[tuple[Path, Read]]:
    """Write one small valid file of each format, each in a folder of its own, with its reader."""
    folder.mkdir(parents=True)
    psm, found = load_arm("psm"), list[tuple[Path, Read]]()

    def add(name: str, read: Read, make: Callable[[Path], object]) -> None:
        own = folder / str(len(found))
        own.mkdir()
        make(own / name)
        found.append((own / name, read))

    def copied(source: Path) -> Callable[[Path], object]:
        return partial(shutil.copy, source)

    given = folder / "given"
    given.mkdir()
    write_samples(given)
    data = Path(psm.file).parent.parent
    add("rig.toml", lambda file, _: load_rig(file), copied(data / "rigs" / "psm.toml"))
    add("arm.toml", lambda file, _: load_arm(file), copied(Path(psm.file)))
    add(
        "overlay.toml",
        lambda file, _: read_overlay(file),
        lambda file: write_overlay(file, Overlay("psm")),
    )
    made = simulate_tracks(psm, MocapSettings("kinematic", duration_s=6.0, rate_hz=10.0))
    for layout in ("tidy", "motive"):
        add(
            f"{layout}.csv",
            lambda file, _: read_tracks(file),
            lambda file, layout=layout: write_tracks(file, made, layout),
        )
    touches = TouchSettings(count=6)
    add(
        "touches.toml",
        lambda file, _: read_touches(file),
        lambda file: write_touches(file, {"PSM1": ("psm", psm)}, touches),
    )
    views = folder / "views"
    write_views(views, load_rig("two_psm_ecm"), ViewSettings("PSM1", count=3))
    for name in ("views.toml", "corners.csv"):
        found.append((views / name, lambda file, _: read_views(file.parent / "views.toml")))
    add("rec.mcap", lambda file, _: open_recording(file), _record)
    add("score.mcap", lambda file, _: score_recording(file), _record)
    add("motion.csv", lambda file, _: read_motion(file, psm), _log)
    add("scene.toml", lambda file, _: load_scene(file), copied(data / "scenes" / "peg-board.toml"))
    add("camera.toml", lambda file, _: load_camera(file),
        copied(data / "cameras" / "dvrk_sd_640x480.toml"))  # fmt: skip
    rig = (data / "rigs" / "psm.toml").read_text(encoding="utf-8")
    errors = rig.replace("schema = 1", 'schema = 1\nerrors = {preset = "lab"}', 1)
    add("errors.toml", lambda file, _: load_rig(file), lambda file: file.write_text(errors))
    add(
        "fixtures.toml",
        lambda file, _: read_fixtures(file),
        lambda file: file.write_text(FIXTURES),
    )
    for name, text in (("arm.sdf", SDF), ("arm.xml", MJCF), ("link.obj", OBJ), ("link.stl", STL)):
        add(name, _imported, lambda file, text=text: file.write_text(text))
    readers: dict[str, Read] = {
        ".urdf": lambda file, out: import_file(file, out / "made"),
        ".csv": lambda file, _: read_arm_motion(file, psm),
        ".bag": lambda file, _: open_bag(file),
    }
    for path in sorted(p for p in given.iterdir() if p.suffix in readers):
        add(path.name, readers[path.suffix], copied(path))
    lab = given / "lab"
    system = next(iter(sorted(lab.glob("system*.json"))), None)
    if system is not None:
        found.append((system, lambda file, out: import_dvrk(file, out / "rig.toml")))
    return found


def _imported(file: Path, out: Path) -> object:
    """Import an arm, or read a mesh."""
    mesh = file.suffix in (".obj", ".stl")
    return read_surface(file) if mesh else import_file(file, out / "made")


def _log(file: Path) -> None:
    """Write four seconds of joints that swing, as `trocar identify` reads them."""
    time = np.arange(400) / 100.0
    joints = recorded_joints(load_arm("psm"))
    swings: list[np.ndarray] = []
    for k in range(len(joints)):
        w = k + 1.0
        swings += [0.1 * np.sin(w * time), 0.1 * w * np.cos(w * time), 0.01 * np.cos(w * time)]
    names = [f"{joint}_{what}" for joint in joints for what in ("position", "velocity", "effort")]
    rows = np.stack([time, *swings], axis=1)
    np.savetxt(file, rows, "%.6f", ",", header=",".join(["time", *names]), comments="")


def _record(file: Path) -> None:
    world = World("psm")
    with record(world, file):
        world.arm("PSM1").servo_jp(np.zeros(6))
        world.step(50)


def damage(file: Path, rng: random.Random) -> str:
    """Change a file in one random way; return which."""
    data = bytearray(file.read_bytes())
    way = rng.choice(("bytes", "cut", "twice", "number", "piece", "line", "empty"))
    if way == "bytes":
        for _ in range(rng.choice((1, 4, 32))):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif way == "cut":
        del data[rng.randrange(len(data)) :]
    elif way == "twice":
        at = rng.randrange(len(data))
        data[at:at] = data[at : at + rng.randrange(1, 4096)]
    elif way == "empty":
        data.clear()
    else:
        text = data.decode("utf-8", "replace")
        if way == "number" and (places := list(re.finditer(r"-?\d+(\.\d+)?", text))):
            at = rng.choice(places)
            text = text[: at.start()] + rng.choice(NUMBERS) + text[at.end() :]
        elif way == "line":
            lines = text.splitlines(keepends=True)
            lines.insert(rng.randrange(len(lines)), lines.pop(rng.randrange(len(lines))))
            text = "".join(lines)
        else:
            at = rng.randrange(len(text))
            text = text[:at] + rng.choice(PIECES) + text[at:]
        data = bytearray(text.encode("utf-8", "replace"))
    file.write_bytes(data)
    return way


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
