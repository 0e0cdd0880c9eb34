"""Thread and time of suturing with other numbers of stitches."""

from __future__ import annotations

from typing import Any

from trocar.descriptions.scenes import Scene

#: Thread and time for each further stitch. Source: our own choice: paths of 18 mm and a tail that
#: arms can pull. [m, s]
MORE_M, MORE_S = 0.016, 45.0


def settings_of_stitches(scene: Scene, nominal: Scene) -> dict[str, Any]:
    """Return settings of thread and time, where a scene has other stitches than the nominal one.

    Args:
        scene, nominal: with and without settings
    """
    tissues = {prop.name: prop.tissue for prop in nominal.rig.props}
    found: dict[str, Any] = {}
    for prop in scene.rig.props:
        before = tissues[prop.name]
        if prop.tissue is None or before is None:
            continue
        if more := prop.tissue.stitches - before.stitches:
            length = before.thread.length + MORE_M * more
            found[f"{prop.name}.thread.length_mm"] = round(1e3 * length, 6)
            found["time_limit_s"] = nominal.time_limit + MORE_S * more
    return found
