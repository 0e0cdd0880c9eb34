"""Ids of environments: scenes under `trocar/`, and those of SurRoL and ORBIT-Surgical.

The module is read before any other of the package when Gymnasium is imported, so it imports
nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from trocar.errors import MissingExtraError, UnknownNameError

#: Scenes of the package, whose ids are "trocar/NeedlePick-v0" of "needle-pick".
SCENES = (
    "active-track",
    "augmented-reality",
    "bi-peg-transfer",
    "dual-reach",
    "dynamic-band",
    "dynamic-bar",
    "dynamic-pendulum",
    "dynamic-push",
    "dynamic-stack",
    "dynamic-tray",
    "ecm-reach",
    "fls-peg-transfer",
    "gauze-retrieve",
    "icra2026-peg-transfer",
    "match-board",
    "misorient",
    "needle-handover",
    "needle-pick",
    "needle-reach",
    "needle-regrasp",
    "needle-through-phantom",
    "needle-tracking",
    "peg-board",
    "peg-transfer",
    "pick-place",
    "static-track",
    "suturing",
    "thread-handover",
    "thread-knot",
    "tissue-retraction",
    "visual-servoing",
)

#: Settings of SurRoL's environments: goals as dicts, steps of 0.2 s (of 0.1 s with the endoscope),
#: 50 of them. Source: med-air/SurRoL, surrol/gym/__init__.py, surrol_env.py, tasks/psm_env.py and
#: ecm_env.py.
_STEP: Mapping[str, Any] = {"obs": "goal", "action": "surrol", "action_period": 0.2}
_PSM: Mapping[str, Any] = {**_STEP, "max_steps": 50}
_ECM: Mapping[str, Any] = {**_PSM, "action_period": 0.1}
SURROL: Mapping[str, Mapping[str, Any]] = {
    "NeedleReach": {"scene": "needle-reach", **_PSM},
    "GauzeRetrieve": {"scene": "gauze-retrieve", **_PSM},
    "NeedlePick": {"scene": "needle-pick", **_PSM},
    "PegTransfer": {"scene": "peg-transfer", **_PSM},
    "NeedleRegrasp": {"scene": "needle-regrasp", **_PSM, "action": "surrol-pitch"},
    "BiPegTransfer": {"scene": "bi-peg-transfer", **_PSM},
    "ECMReach": {"scene": "ecm-reach", **_ECM},
    # Its goal is an angle, no place.
    "MisOrient": {"scene": "misorient", **_ECM, "obs": "state", "action": "surrol-roll"},
    "StaticTrack": {"scene": "static-track", **_ECM},
    # Its reward is dense and its observation flat.
    "ActiveTrack": {"scene": "active-track", **_ECM, "obs": "state", "max_steps": 500},
}

#: Scenes of ORBIT-Surgical's tasks, and the steps of 20 ms of their episodes (12 and 5 s). Source:
#: orbit-surgical/orbit-surgical, tasks/surgical/*/config/*/__init__.py and *_env_cfg.py.
_ORBIT_TASKS = {
    "Reach-PSM": ("needle-reach", 600),
    "Reach-Dual-PSM": ("dual-reach", 600),
    "Lift-Needle-PSM": ("needle-pick", 250),
    "Handover-Needle-Dual-PSM": ("needle-handover", 250),
}
_ORBIT_ACTIONS = {"": "orbit-joint", "-IK-Abs": "orbit-ik-abs", "-IK-Rel": "orbit-ik-rel"}
ORBIT: Mapping[str, Mapping[str, Any]] = {
    f"Isaac-{task}{suffix}": {
        "scene": scene,
        "obs": "state",
        "reward": "dense",
        "action": action,
        "action_period": 0.02,
        "max_steps": steps,
    }
    for task, (scene, steps) in _ORBIT_TASKS.items()
    for suffix, action in _ORBIT_ACTIONS.items()
}

#: Settings of `TaskEnv` by id.
IDS: Mapping[str, Mapping[str, Any]] = {
    **{
        f"trocar/{''.join(word.capitalize() for word in scene.split('-'))}-v0": {"scene": scene}
        for scene in SCENES
    },
    **{f"SurRoL/{name}-v0": settings for name, settings in SURROL.items()},
    **{f"ORBIT/{name}-v0": settings for name, settings in ORBIT.items()},
}


def settings_of(name: str) -> dict[str, Any]:
    """Return the settings of `TaskEnv` that an id stands for.

    Raises:
        UnknownNameError: no such id; the known ones are listed
    """
    if name not in IDS:
        raise UnknownNameError("environment", name, IDS)
    return dict(IDS[name])


def register() -> None:
    """Register all ids with Gymnasium; those that are registered stay.

    Raises:
        MissingExtraError: Gymnasium is not installed
    """
    try:
        from gymnasium.envs import registration
    except ImportError:
        raise MissingExtraError("gymnasium", "gym", "an environment") from None
    add = cast(Any, registration).register
    for name, settings in IDS.items():
        if name not in registration.registry:
            add(
                name,
                entry_point="trocar.learning.scene_env:SceneEnv",
                vector_entry_point="trocar.learning.vector_env:SceneVectorEnv",
                kwargs=dict(settings),
            )
