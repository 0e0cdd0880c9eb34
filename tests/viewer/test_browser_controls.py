"""Every control of the page in a real browser at three sizes; its effect is read over CRTK.

What has no effect on the simulation, as a mark that only this browser draws, is read from the
scene that this browser draws. The walk has to meet every control, and to act on every one it meets.
"""

from __future__ import annotations

import csv
import io
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from trocar.simulation import World
from trocar.teleoperation.devices import PEDAL_KEYS
from trocar.teleoperation.session import LABELS
from trocar.viewer import Choice

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.webdriver.common.by import By

from tests.viewer import test_browser_files as files
from tests.viewer import test_browser_people as people
from tests.viewer.all_kinds import AllKinds, all_kinds
from tests.viewer.browser import PATIENCE_S, chromium
from tests.viewer.person import Person
from tests.viewer.program import Program, program

pytestmark = [pytest.mark.browser, pytest.mark.slow]

#: Controls that end the page or need a second browser, and the test that acts on them.
ELSEWHERE = {
    "Thing/Load": files.test_a_file_is_uploaded_previewed_and_loaded_and_bad_ones_get_a_notice,
    "Driver/Request control": people.test_one_drives_the_other_watches_and_control_is_passed,
    "Driver/Give": people.test_one_drives_the_other_watches_and_control_is_passed,
    "Driver/Keep": people.test_one_drives_the_other_watches_and_control_is_passed,
}
#: On a phone: score, cameras, and what else may be loaded.
PHONE = {
    "Camera", "Content/colour", "Content/depth", "Content/ids", "Episode/Again",
    "Episode/Next seed", "Full screen", "Load/Scenes and rigs", "Loop", "Overlays",
    "Policy/Take control", "View/anaglyph", "View/both", "View/left", "View/off", "View/right",
    "cameras/save", "help/",
}  # fmt: skip
#: Joints of each arm in the order of its joint vector, without jaw and gripper.
PSM = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
TETRAHEDRON = (
    "solid it\n"
    + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n"
        for corners in (
            ((0, 0, 0), (0, 20, 0), (20, 0, 0)),
            ((0, 0, 0), (20, 0, 0), (0, 0, 20)),
            ((0, 0, 0), (0, 0, 20), (0, 20, 0)),
            ((20, 0, 0), (0, 20, 0), (0, 0, 20)),
        )
    )
    + "endsolid it\n"
)


@dataclass
class Walk:
    """A person at a page, a program that reads, and what was met on the way.

    Attributes:
        met, used: controls that were on the page, and that were acted on
        folder: of downloads and of files to upload
    """

    person: Person
    reads: Program
    served: AllKinds
    folder: Path
    met: set[str] = field(default_factory=set)
    used: set[str] = field(default_factory=set)

    def look(self) -> None:
        """Note the controls that are on the page."""
        self.met |= {one_of_its_kind(each) for each in self.person.controls()}

    def press(self, label: str, button: str) -> None:
        self.used.add(f"{label}/{button}")
        self.person.press(label, button)

    def pick(self, label: str, option: str) -> None:
        self.used.add(label)
        self.person.pick(label, option)

    def tick(self, label: str) -> None:
        self.used.add(label)
        self.person.tick(label)

    def send(self, words: str) -> None:
        """Press what sends words to the simulator."""
        self.used.add(one_of_its_kind(words))
        self.person.click(f"//*[@data-trocar-send='{words}']")

    def see(self, topic: str, fits: Callable[[dict], bool]) -> dict:
        return self.reads.hear(topic, fits, PATIENCE_S)

    def until(self, met: Callable[[], bool], what: str) -> None:
        self.person.browser.wait(met, what, PATIENCE_S)

    def state(self, *words: str) -> None:
        """Wait until PSM1 is in a state, as "ENABLED", "is_homed"."""
        state, *flags = words

        def fits(it: dict) -> bool:
            return it["state"] == state and all(it[flag] for flag in flags)

        self.see("/PSM1/operating_state", fits)

    @property
    def time_s(self) -> float:
        return self.reads.hear("/scene/time")["data"]

    def moves(self, topic: str) -> bool:
        """Test whether something goes on moving while time does."""
        before, since = self.reads.hear(topic)["position"], self.time_s
        self.see("/scene/time", lambda it: not since <= it["data"] < since + 0.4)
        after = self.reads.hear(topic)["position"]
        return bool(np.abs(np.subtract(before, after)).max() > 1e-4)

    def stands(self, pose: str, topic: str = "/PSM1/setpoint_js") -> None:
        """Wait until PSM1 has arrived at a pose."""
        arm = "PSM1"
        goal = self.served.world(lambda world: world.arm(arm).joints.poses[pose])
        self.see(topic, lambda it: np.allclose(it["position"], goal[:6], atol=1e-3))

    def download(self, name: str) -> bytes:
        """Return a downloaded file, once it is whole, and delete it."""
        file = self.folder / name
        self.until(lambda: file.is_file() and file.stat().st_size > 0, f"{name} is downloaded")
        self.until(lambda: not [*self.folder.glob("*.crdownload")], f"all of {name}")
        content = file.read_bytes()
        file.unlink()
        return content


def one_of_its_kind(control: str) -> str:
    """Return a control, of the outline's rows one for all of a kind: "outline/see"."""
    return "/".join(control.split("/")[:2]) if control.startswith("outline/") else control


@contextmanager
def walk(width: int, tmp_path: Path) -> Iterator[Walk]:
    """Open the page in a fresh browser of a size."""
    # Half as many pixels along each edge to draw, and as many to point at.
    screen = {"width": width, "height": 900, "deviceScaleFactor": 0.5, "mobile": width < 500}
    downloads = {"behavior": "allow", "downloadPath": str(tmp_path)}
    with (
        all_kinds(tmp_path) as served,
        chromium(tmp_path / "profile") as browser,
        program(served.rosbridge) as reads,
    ):
        browser.tab.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        browser.tab.execute_cdp_cmd("Browser.setDownloadBehavior", downloads)
        browser.tab.get(served.url)
        bar = "return document.querySelector('[data-trocar=bar]')?.innerText.includes('real time')"
        browser.wait(lambda: bool(browser.tab.execute_script(bar)), "time flows")
        yield Walk(Person(browser), reads, served, tmp_path)


# ---------------------------------------------------------------------- the ways through the page


def the_scene(at: Walk) -> None:
    sways = "/PSM1/setpoint_js"
    at.until(lambda: at.moves(sways), "the policy drives")
    at.press("Policy", "Take control")
    at.until(lambda: not at.moves(sways), "the policy stops")
    at.look()
    at.press("Policy", "Give back")
    at.until(lambda: at.moves(sways), "the policy goes on")
    at.press("Policy", "Take control")
    at.until(lambda: not at.moves(sways), "the policy stops again")
    seed, before = at.served.task.state()["seed"], at.time_s
    at.press("Episode", "Again")
    at.see("/scene/time", lambda it: it["data"] < before)
    assert at.served.task.state()["seed"] == seed
    at.press("Episode", "Next seed")
    at.until(lambda: at.served.task.state()["seed"] == seed + 1, "the next seed")
    at.tick("Loop")
    at.until(lambda: at.served.task.repeating, "episodes follow each other")
    at.tick("Loop")
    at.until(lambda: not at.served.task.repeating, "they do not")


def time_stands_and_begins_anew(at: Walk) -> None:
    at.press("Time", "Pause")
    at.see("/scene/paused", lambda it: it["data"])
    stood = at.time_s
    at.look()
    at.press("Time", "Resume")
    at.see("/scene/paused", lambda it: not it["data"])
    at.see("/scene/time", lambda it: it["data"] > stood)
    at.press("Time", "Reset")
    at.see("/scene/time", lambda it: it["data"] < stood)


def named_poses(at: Walk) -> None:
    at.press("All arms to", "aside")
    at.stands("aside")
    at.see("/ECM/setpoint_js", lambda it: np.allclose(it["position"][0], 0.1, atol=1e-3))
    at.press("All arms to", "start")
    at.stands("start")
    for pose in ("zero", "aside", "home", "start"):
        at.press("Move to", pose)
        at.stands(pose)


def power(at: Walk) -> None:
    at.press("Power", "Disable")
    at.state("DISABLED")
    at.look()
    at.press("Power", "Enable")
    at.state("ENABLED")
    at.press("Power", "Home")
    at.state("ENABLED", "is_homed")
    at.press("Move to", "start")
    at.stands("start")


def sliders(at: Walk) -> None:
    """All sliders of an arm of each kind, by mouse; one by keyboard, and by its number."""
    for arm, prefix in {
        "PSM1": "PSM1",
        "ECM": "ECM",
        "MTMR": "MTMR",
        "SUJ_PSM1": "SUJ/PSM1",
    }.items():
        choose(at, arm)
        at.look()
        joints = at.served.world(lambda world, arm=arm: world.arm(arm).joints.names)
        if arm == "SUJ_PSM1":
            brakes(at)
        for k, joint in enumerate(joints):
            long = at.person.browser.labelled(f"{joint} mm")
            unit, scale = ("mm", 1000.0) if long else ("deg", 180.0 / np.pi)
            label = f"{joint} {unit}"
            kind = joint if joint in ("jaw", "gripper") else ""
            part = f"{prefix}/{kind}" if kind else prefix
            topic = f"/{part}/{'measured' if arm[:3] in ('MTM', 'SUJ') else 'setpoint'}_js"
            at.used.add(label)
            before = at.person.share(label)
            goal, exact = at.person.slide(label, before + (0.12 if before < 0.5 else -0.12))
            row = 0 if kind else k
            at.see(topic, near(row, goal / scale, exact / scale))
        if arm == "PSM1":
            reached = at.reads.hear("/PSM1/setpoint_js")["position"][2]
            at.person.arrow("insertion mm")
            at.see("/PSM1/setpoint_js", near(2, reached + 1e-4, 2e-5))
            at.person.type("yaw deg", -7.5)
            at.see("/PSM1/setpoint_js",
                   lambda it: abs(np.degrees(it["position"][0]) + 7.5) < 1e-3)  # fmt: skip
    choose(at, "PSM1")


def choose(at: Walk, arm: str) -> None:
    """Choose an arm, and wait for its controls."""
    at.pick("Arm", arm)
    at.until(lambda: bool(at.person.all(f"//*[starts-with(., '{arm} joints')]")), arm)


def near(k: int, goal: float, exact: float) -> Callable[[dict], bool]:
    return lambda it: abs(it["position"][k] - goal) < exact


def brakes(at: Walk) -> None:
    at.see("/SUJ/PSM1/brakes_locked", lambda it: it["data"])
    at.press("Brakes", "Release")
    at.see("/SUJ/PSM1/brakes_locked", lambda it: not it["data"])
    at.press("Brakes", "Lock")
    at.see("/SUJ/PSM1/brakes_locked", lambda it: it["data"])
    at.press("Brakes", "Release")
    at.see("/SUJ/PSM1/brakes_locked", lambda it: not it["data"])


def servo_control(at: Walk) -> None:
    at.press("Move to", "start")
    at.stands("start")
    torques = "/PSM1/gravity_compensation/setpoint_js"
    before = np.abs(at.reads.hear(torques)["effort"]).max() > 0.0
    at.tick("Gravity comp.")
    at.see(torques, lambda it: (np.abs(it["effort"]).max() > 0.0) != before)
    at.tick("Gravity comp.")
    at.see(torques, lambda it: (np.abs(it["effort"]).max() > 0.0) == before)
    at.person.unfold("Gains P, I, D")
    joints = (*PSM, "jaw")
    for joint in joints:
        at.used.add(joint)
        p = round(1.5 * gains(at, joint), 2)
        at.person.type(joint, p)
        at.until(lambda j=joint, p=p: abs(gains(at, j) - p) < 0.006, f"P of {joint}")
    at.person.unfold("Gains P, I, D")
    at.pick("Applies to", "yaw")
    at.pick("Mode", "effort (open loop)")
    at.until(lambda: at.person.browser.labelled("yaw N m"), "the slider is a torque")
    at.look()
    assert at.person.browser.labelled("pitch deg")  # of one joint
    at.used.add("yaw N m")
    at.person.slide("yaw N m", 0.9)
    at.see("/PSM1/measured_js", lambda it: abs(it["position"][0]) > 0.05)
    at.pick("Applies to", "all joints")
    at.pick("Mode", "set (kinematic)")
    at.until(lambda: at.person.browser.labelled("yaw deg"), "the slider is an angle")
    at.person.type("yaw deg", 10.0)
    at.see("/PSM1/measured_js", lambda it: abs(np.degrees(it["position"][0]) - 10.0) < 0.2)
    at.pick("Mode", "position (PID)")
    at.pick("Instrument", "none")
    at.see("/PSM1/tool_type", lambda it: "NEEDLE" not in it["data"])
    at.pick("Instrument", "LARGE_NEEDLE_DRIVER:400006")
    at.see("/PSM1/tool_type", lambda it: "NEEDLE" in it["data"])
    at.press("Time", "Reset")


def gains(at: Walk, joint: str) -> float:
    """Read P of a joint of PSM1."""
    return at.served.world(lambda world: world.arm("PSM1").joints.gains(joint)[0])


def the_last_minute(at: Walk) -> None:
    at.see("/scene/time", lambda it: it["data"] > 3.0)
    at.person.slide("Look back s", 0.2, 0.2)  # time flows until it stands
    at.used.add("Look back s")
    at.see("/scene/paused", lambda it: it["data"])
    now = at.time_s
    at.look()
    at.press("Moment", "Continue from here")
    early = at.see("/scene/time", lambda it: it["data"] < 0.6 * now)["data"]
    at.press("Step", "+1 ms")
    at.see("/scene/time", lambda it: abs(it["data"] - early - 0.001) < 1e-6)
    at.press("Step", "+0.1 s")
    later = at.see("/scene/time", lambda it: abs(it["data"] - early - 0.101) < 1e-6)["data"]
    at.press("Step", "-0.1 s")
    at.until(lambda: "Moment/Now" in at.person.controls(), "a moment of before")
    at.press("Step", "-0.1 s")
    at.press("Moment", "Now")
    at.until(lambda: "Moment/Now" not in at.person.controls(), "the present")
    assert at.time_s == later
    at.pick("Speed", "0.1 x")
    at.press("Time", "Resume")
    at.see("/scene/paused", lambda it: not it["data"])
    began, wall_s = at.time_s, time.monotonic()
    at.press("Move to", "aside")  # slowly: it is held on its way
    at.see("/PSM1/setpoint_js", lambda it: it["position"][0] > 0.01)
    at.press("Move to", "hold here")
    at.see("/PSM1/operating_state", lambda it: not it["is_busy"])
    assert at.reads.hear("/PSM1/setpoint_js")["position"][0] < 0.29
    assert at.time_s - began < 0.3 * (time.monotonic() - wall_s)
    at.pick("Speed", "real time")
    at.press("Move to", "start")
    at.stands("start")


def hands(at: Walk) -> None:
    tip, others = "/hands/tip_PSM1", ("/hands/tip_ECM", "/hands/tip_MTMR")
    person = at.person
    at.pick("Tip handles", "none")
    at.until(lambda: not person.sees(tip), "no handle")
    at.pick("Tip handles", "of all arms")
    at.until(lambda: all(map(person.sees, (tip, *others))), "all handles")
    before = place(at.reads.hear("/PSM1/setpoint_cp"))
    for arm, node in {"ECM": others[0], "MTMR": others[1], "PSM1": tip}.items():
        before = place(at.reads.hear(f"/{arm}/setpoint_cp"))
        at.used.add(node)
        person.pull(node, 0.7 * 0.06, 0.01)
        at.see(f"/{arm}/setpoint_cp", lambda it, p=before: abs(way(it, p) - 0.01) < 0.003)
    at.press("Placement", "Undo")
    at.see("/PSM1/setpoint_cp", lambda it: way(it, before) < 0.001)
    at.pick("Tip handles", "of the chosen arm")
    at.until(lambda: person.sees(tip) and not person.sees(others[0]), "one handle")
    at.press("Time", "Pause")
    at.see("/scene/paused", lambda it: it["data"])
    at.pick("Object handle", "block")
    block = "/hands/object_block"
    at.until(lambda: person.sees(block), "the handle of the object")
    at.look()
    lay = place(at.reads.hear("/scene/block/measured_cp"))
    at.used.add(block)
    person.pull(block, 0.7 * 0.08, 0.02)
    at.see("/scene/block/measured_cp", lambda it: abs(way(it, lay) - 0.02) < 0.005)
    at.press("Placement", "Undo")
    at.see("/scene/block/measured_cp", lambda it: way(it, lay) < 0.001)
    at.pick("Object handle", "none")
    at.press("Time", "Resume")


def place(message: dict) -> np.ndarray:
    p = message["pose"]["position"]
    return np.array([p["x"], p["y"], p["z"]])


def way(message: dict, before: np.ndarray) -> float:
    return float(np.linalg.norm(place(message) - before))


def what_is_drawn(at: Walk) -> None:
    person = at.person
    person.unfold("See")
    at.see("/scene/contacts", lambda it: bool(it["contacts"]))  # the block on the table
    at.tick("Contact forces")
    at.until(lambda: person.sees("/see/forces"), "arrows")
    at.tick("Contact forces")
    at.until(lambda: not person.sees("/see/forces"), "no arrows")
    at.tick("Tip paths")
    at.press("Move to", "aside")
    at.until(lambda: person.sees("/see/path_PSM1"), "the path of the tip")
    at.tick("Tip paths")
    at.until(lambda: not person.sees("/see/path_PSM1"), "no path")
    at.tick("Workspace")
    at.until(lambda: person.sees("/see/workspace"), "the workspace")
    at.until(lambda: (person.browser.read("workspace") or "").startswith("PSM1: "), "its volume")
    at.tick("Workspace")
    at.until(lambda: not person.sees("/see/workspace"), "no workspace")
    person.unfold("See")
    at.tick("Remote centres")
    at.until(lambda: not person.sees("/marks/centre_PSM1"), "no remote centres")
    at.tick("Remote centres")
    at.until(lambda: person.sees("/marks/centre_PSM1"), "remote centres")
    at.tick("Tool frames")
    at.until(lambda: person.sees("/marks/tip_PSM1"), "tool frames")
    at.tick("Tool frames")
    at.until(lambda: not person.sees("/marks/tip_PSM1"), "no tool frames")
    light = "return __viserMutable.scene.environment !== null"
    at.pick("Drawing", "no shadows")
    at.until(lambda: person.tab.execute_script(light), "reflections")
    at.pick("Drawing", "plain")
    at.until(lambda: not person.tab.execute_script(light), "none")


def outline(at: Walk) -> None:
    person, picked = at.person, "return document.querySelector('.picked')?.innerText ?? ''"

    def finds(name: str) -> None:
        at.until(lambda: person.tab.execute_script(picked) == name, f"picked: {name!r}")
        at.until(lambda: person.sees("/see/picked") == bool(name), "its axes")

    person.unfold("Outline")
    at.press("Pick", "Click in the scene")
    at.press("Pick", "click a link ... (cancel)")
    at.press("Pick", "Click in the scene")
    at.until(lambda: "Pick/click a link ... (cancel)" in at.person.controls(), "it waits")
    at.look()
    person.click_on("/world/block", 0.12)
    finds("block")
    at.look()
    at.send("outline/pick/block")
    finds("")
    meshes = """
    let count = 0;
    __viserMutable.nodeRefFromName["/world/block"]?.traverseVisible((part) => {
      count += Boolean(part.isMesh);
    });
    return count;
    """
    at.send("outline/see/block")
    at.until(lambda: person.tab.execute_script(meshes) == 0, "the block is hidden")
    at.send("outline/see/block")
    at.until(lambda: person.tab.execute_script(meshes) > 0, "the block is shown")
    link = "//*[@data-trocar-send='outline/pick/PSM1/yaw']"
    at.send("outline/open/PSM1")
    at.until(lambda: bool(person.all(link)), "the links of the arm")
    at.send("outline/open/PSM1")
    at.until(lambda: not person.all(link), "no links of the arm")
    person.unfold("Outline")


def plots(at: Walk) -> None:
    person = at.person
    person.unfold("Plots, 60 s")
    drawn = "return document.querySelectorAll('.uplot').length"
    before = person.tab.execute_script(drawn)
    chosen = [f"PSM1 {joint} measured" for joint in PSM[:4]]
    for number, quantity in enumerate(chosen):
        at.pick(f"Plot {number + 1}", quantity)
        count = before + number + 1
        at.until(lambda n=count: person.tab.execute_script(drawn) == n, quantity)
    at.press("Time", "Pause")
    at.see("/scene/paused", lambda it: it["data"])
    at.press("Last minute", "Export CSV")
    rows = list(csv.reader(io.StringIO(at.download("last_minute.csv").decode())))
    assert rows[0] == ["time s", *(f"{q} {'m' if 'insertion' in q else 'rad'}" for q in chosen)]
    assert np.allclose([float(x) for x in rows[-1][1:]], at.reads.joints[:4], atol=0.02)
    at.press("Time", "Resume")
    person.unfold("Plots, 60 s")


def own_files(at: Walk) -> None:
    person = at.person
    person.unfold("Own files")
    at.pick("Unit", "mm")
    at.pick("Contact", "convex hull")
    at.tick("Movable")
    (at.folder / "wedge.stl").write_text(TETRAHEDRON, encoding="utf-8")
    person.tab.find_elements(By.CSS_SELECTOR, "input[type=file]")[-1].send_keys(
        str(at.folder / "wedge.stl")
    )
    at.used.add("Upload a file")
    handle = "/own/handle"
    at.until(lambda: person.sees(handle), "what was uploaded")
    at.look()
    at.used.add(handle)
    rig = saved(at)
    assert "movable = true" not in rig
    before = rig
    person.pull(handle, 0.7 * 0.12, 0.02)
    at.until(lambda: saved(at) != before, "it was moved")
    at.press("Thing", "Remove")
    at.until(lambda: not person.sees(handle), "it is gone")
    person.unfold("Own files")


def saved(at: Walk) -> str:
    """Return the rig's file, as it is saved."""
    at.press("Thing", "Save")
    with zipfile.ZipFile(io.BytesIO(at.download("wedge.zip"))) as packed:
        name = next(n for n in packed.namelist() if n.endswith("rig.toml"))
        return packed.read(name).decode()


def cameras(at: Walk) -> None:
    person = at.person
    size = """
    const at = document.querySelector('[data-trocar=scope]');
    let up = at, image = null;
    while (up && !(image = up.querySelector("img"))) up = up.parentElement;
    return [image.naturalWidth, image.naturalHeight];
    """

    def wide(width: int) -> None:
        at.until(lambda: person.tab.execute_script(size)[0] == width, f"{width} pixels")

    wide(640)
    at.press("View", "both")
    wide(1280)
    at.press("View", "anaglyph")
    wide(640)
    at.press("View", "right")
    at.press("View", "left")
    at.send("cameras/save")
    saved = at.download("endoscope-colour.png")
    assert saved[:4] == b"\x89PNG"
    assert [int.from_bytes(saved[k : k + 4], "big") for k in (16, 20)] == [640, 480]
    at.pick("Camera", "room")
    wide(320)
    legend = "return document.querySelector('[data-trocar=legend]')?.innerText ?? ''"
    for content, words in {"depth": "[mm]", "ids": "point"}.items():
        at.press("Content", content)
        at.until(lambda w=words: w in person.tab.execute_script(legend), content)
    at.press("Content", "colour")
    at.until(lambda: not person.tab.execute_script(legend), "no legend")
    at.pick("Camera", "endoscope")
    wide(640)
    bright = """
    const [done] = [arguments[arguments.length - 1]];
    let up = document.querySelector('[data-trocar=scope]'), image = null;
    while (up && !(image = up.querySelector("img"))) up = up.parentElement;
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 1;
    const paper = canvas.getContext("2d");
    paper.drawImage(image, 5, 5, 1, 1, 0, 0, 1, 1);
    done(paper.getImageData(0, 0, 1, 1).data[0]);
    """
    at.until(lambda: person.tab.execute_async_script(bright) > 150, "overlays")
    at.tick("Overlays")
    at.until(lambda: person.tab.execute_async_script(bright) < 50, "none")
    at.tick("Overlays")
    full = "return document.fullscreenElement?.tagName === 'IMG'"
    at.used.add("Full screen")
    person.click("//*[@data-trocar='full-screen']")
    at.until(lambda: person.tab.execute_script(full), "it fills the screen")
    person.tab.execute_script("document.exitFullscreen()")
    at.until(lambda: not person.tab.execute_script(full), "it does not")
    at.press("View", "off")
    at.until(lambda: (person.browser.read("scope") or "") == "off", "off")


def measurements(at: Walk) -> None:
    """On a wide page: the plot of a joint."""
    if "Last 10 s of" in at.person.controls():
        at.pick("Last 10 s of", "insertion")
        unit = "return document.body.innerText.includes('measured [mm]')"
        at.until(lambda: at.person.tab.execute_script(unit), "the plot of the insertion")


def pedals(at: Walk) -> None:
    person = at.person
    if not person.all("//*[normalize-space(text())='Pedals']"):
        person.click("//button[@aria-label='Expand']")
    person.click("//*[normalize-space(text())='Pedals']")
    at.look()
    names = {"operator_present": "console/operator_present"}
    boxes = [each for each in sorted(at.person.controls()) if each.endswith(")")]
    assert boxes
    for pedal, key in PEDAL_KEYS.items():
        label = f"{LABELS.get(pedal, pedal.capitalize())} ({key})"
        if label not in boxes:
            continue
        topic = "/" + names.get(pedal, f"footpedals/{pedal}")
        at.tick(label)
        at.see(topic, lambda it: it["buttons"][0] == 1)
        person.key(key.lower())
        at.see(topic, lambda it: it["buttons"][0] == 0)


def help_and_gallery(at: Walk) -> None:
    person = at.person
    sheet = "return !!document.querySelector('[data-trocar=help]')"
    at.used |= {"help/", "Close"}
    for ask in (
        lambda: person.click("//*[@data-trocar-send='help/']"),
        lambda: person.key("?"),
    ):
        ask()
        at.until(lambda: person.tab.execute_script(sheet), "the sheet of help")
        at.look()
        person.click("//button[normalize-space()='Close']")
        at.until(lambda: not person.tab.execute_script(sheet), "it is closed")
    at.press("Load", "Scenes and rigs")
    card = "//*[@data-trocar-send='load/rig/psm']"
    at.used.add("load/rig/psm")
    person.one(card)
    at.look()
    person.click(card)
    at.until(lambda: not at.served.thread.is_alive(), "the world ends")
    assert at.served.chosen == [Choice("rig", "psm")]


WAYS = (
    the_scene, time_stands_and_begins_anew, named_poses, power, sliders, servo_control,
    the_last_minute, hands, what_is_drawn, outline, plots, own_files, cameras, measurements, pedals,
    help_and_gallery,
)  # fmt: skip


@pytest.mark.parametrize("width", [1920, 1100])
def test_every_control_acts(width: int, tmp_path: Path) -> None:
    with walk(width, tmp_path) as at:
        alike = at.served.world(rows_of_other_arms)
        at.look()
        for each in WAYS:
            each(at)
            if at.served.thread.is_alive():
                at.look()
    left = at.met - at.used - ELSEWHERE.keys() - alike
    assert left == set(), "controls that nobody acted on"


def rows_of_other_arms(world: World) -> set[str]:
    """Return the named poses and the gains of arms but PSM1: rows of one kind, tried with PSM1."""
    others = [arm for name, arm in world.arms.items() if name != "PSM1"]
    poses = {f"Move to/{pose}" for arm in others for pose in arm.joints.poses}
    return poses | {joint for arm in others for joint in arm.joints.names}


def test_a_phone_has_score_cameras_and_the_gallery_and_they_act(tmp_path: Path) -> None:
    with walk(390, tmp_path) as at:
        at.look()
        assert at.met == PHONE
        for each in (the_scene, cameras, help_and_gallery):
            each(at)
    assert PHONE - at.used == set(), "controls that nobody acted on"
