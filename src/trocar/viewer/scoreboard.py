"""The scene's folder: its score, who drives, and another episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape

import viser

from trocar.viewer.help import hint
from trocar.viewer.server import Buttons, when_touched

TAKE, GIVE = "Take control", "Give back"
AGAIN, NEXT = "Again", "Next seed"


@dataclass(frozen=True)
class SceneScore:
    """The count of an episode.

    Attributes:
        time_s, score, met, goals, drops, done, reason: as on the topic `task/state`
        seed: of the episode
        taken: whether a person has the arms of the policy
        by_hand: whether a person had them at some time in this episode
    """

    time_s: float
    score: float
    met: int
    goals: int
    drops: int
    done: bool
    reason: str
    seed: int
    taken: bool = False
    by_hand: bool = False


@dataclass(frozen=True)
class SceneControls:
    """The scene that is served, as the page shows and drives it.

    Attributes:
        name, title, limit_s: of the scene, with its time limit [s]
        driver: the policy in a few words; "": a person or a client drives
        arms: that the policy drives
        score: returns the count so far
        take, give: stop the policy, and let it go on
        begin: begins the episode of a seed
        repeat: called with whether the episodes of the next seeds follow by themselves
    """

    name: str
    title: str
    limit_s: float
    driver: str
    arms: tuple[str, ...]
    score: Callable[[], SceneScore]
    take: Callable[[], object]
    give: Callable[[], object]
    begin: Callable[[int], object]
    repeat: Callable[[bool], object]
    repeating: Callable[[], bool] = field(default=lambda: False)

    def drives(self) -> str:
        """Return the name of the policy while it drives, "" while it does not."""
        now = self.score()
        return "" if now.taken or now.done else self.driver


class Scoreboard:
    """The folder, in the container that is open."""

    def __init__(self, gui: viser.GuiApi, scene: SceneControls) -> None:
        self._scene = scene
        with gui.add_folder(scene.name):
            self._text = gui.add_html("")
            self._control: Buttons | None = None
            if scene.driver:
                self._control = Buttons(gui, "Policy", (TAKE,), self._press, hint("Policy"))
            self._episode = Buttons(gui, "Episode", (AGAIN, NEXT), self._press, hint("Episode"))
            self._loop = gui.add_checkbox("Loop", scene.repeating(), hint=hint("Loop"))
            when_touched(self._loop, scene.repeat)
        self._shown = ""

    def show(self, blocked: str) -> None:
        """Show the count.

        Args:
            blocked: why this browser may not drive; "": it may
        """
        now = self._scene.score()
        text = score_html(self._scene, now)
        if text != self._shown:
            self._shown = self._text.content = text
        if self._control is not None:
            names = (GIVE if now.taken else TAKE,)
            self._control.show(names, disabled=bool(blocked) or now.done)
        self._episode.show((AGAIN, NEXT), disabled=bool(blocked))
        if self._loop.disabled != bool(blocked):
            self._loop.disabled = bool(blocked)
        if self._loop.value != self._scene.repeating():
            self._loop.value = self._scene.repeating()

    def _press(self, name: str) -> None:
        scene = self._scene
        if name == TAKE:
            scene.take()
        elif name == GIVE:
            scene.give()
        else:
            scene.begin(scene.score().seed + (name == NEXT))


def score_html(scene: SceneControls, now: SceneScore) -> str:
    """Return title, count and end of an episode."""
    cards = {
        "score": f"{now.score:.0f}",
        "goals": f"{now.met} of {now.goals}",
        "drops": str(now.drops),
        "time": f"{now.time_s:.1f} of {scene.limit_s:g} s",
        "seed": str(now.seed),
        "end": escape(now.reason) if now.done else "-",
    }
    made = "".join(
        f'<div class="card"><span>{name}</span><b data-trocar="score/{name}">{value}</b></div>'
        for name, value in cards.items()
    )
    return (
        f'<div class="trocar"><div class="title">{escape(scene.title)}</div>'
        f'<div class="cards">{made}</div>'
        f'<div class="who">{escape(driver_of(scene, now))}</div></div>'
    )


def driver_of(scene: SceneControls, now: SceneScore) -> str:
    """Return the driver in a few words."""
    if not scene.driver:
        return "you, or a client, drive"
    if now.taken:
        return f"you drive; the {scene.driver} waits"
    mixed = ", after a person" if now.by_hand else ""
    return f"{scene.driver}{mixed}{f': {now.reason}' if now.done else ' drives'}"
