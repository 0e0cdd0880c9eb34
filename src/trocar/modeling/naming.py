"""Names in compiled models: "PSM1/pitch_back", "PSM1/guard/c1"."""

from __future__ import annotations


def scoped(arm: str, name: str) -> str:
    """Return the name of an arm's body, hinge, actuator, tendon or closing point."""
    return f"{arm}/{name}"


def owner(scoped_name: str) -> str:
    """Return the arm that a scoped name belongs to."""
    return scoped_name.partition("/")[0]


def closing_site(arm: str, closure: str, side: str) -> str:
    """Return the name of the site on side "a" or "b" of a loop's closing hinge."""
    return f"{arm}/{closure}/{side}"


def frame_site(arm: str, frame: str) -> str:
    """Return the name of the site at an arm's tip or reference frame, which poses are read from."""
    return f"{arm}/site/{frame}"


def connect(arm: str, closure: str, layer: int) -> str:
    """Return the name of one of the equalities that close a loop: the closure's for the first."""
    return scoped(arm, closure if layer == 0 else f"{closure}/{layer + 1}")


def guard(arm: str, closure: str) -> str:
    """Return the name of the equality that keeps a loop on its branch."""
    return f"{arm}/guard/{closure}"


def grasp(arm: str, prop: str) -> str:
    """Return the name of the equality by which an arm's jaw holds a prop, while it is active."""
    return f"{arm}/grasp/{prop}"


def free_joint(prop: str) -> str:
    """Return the name of the six degrees of freedom of a prop that can be moved."""
    return f"{prop}/free"


def voltage_limit(arm: str, joint: str, sign: float) -> str:
    """Return the name of what limits a motor's effort at speeds of a sign."""
    return f"{arm}/{joint}/voltage{'+' if sign > 0.0 else '-'}"


def prop_joint(prop: str, kind: str) -> str:
    """Return the name of the joint between a prop and what carries it."""
    return f"{prop}/{kind}"


def link(prop: str, number: int) -> str:
    """Return the name of the body of a thread's link; the first one is the prop's."""
    return f"{prop}/{number}" if number else prop


def band(name: str) -> str:
    """Return the name of an elastic band's tendon, in models and in files."""
    return f"band_{name}"


def band_site(name: str, number: int) -> str:
    """Return the name of the site at a point of an elastic band.

    Files keep it: a tendon refers to its sites by names that cannot be changed.
    """
    return f"band_{name}_{number}"
