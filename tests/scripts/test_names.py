"""Our crtk and dvrk have exactly the public names of the genuine modules, recorded from those."""

from __future__ import annotations

import json
from pathlib import Path

from tests.scripts.playing import play

RECORDED = Path(__file__).with_name("genuine_names.json")
SCRIPT = """
import json, types, crtk, dvrk, crtk.msg_conversions
def names(thing):
    return " ".join(
        n for n in sorted(dir(thing))
        if not n.startswith("_") and not isinstance(getattr(thing, n), types.ModuleType)
    )
ral = crtk.ral("names")
psm = dvrk.psm(ral, "PSM1")
made = {
    "crtk.ral": ral,
    "crtk.utils": crtk.utils(type("Bare", (), {})(), ral),
    "crtk.joystick_button": crtk.joystick_button(ral, "footpedals/coag"),
    "crtk.measured_cp": crtk.measured_cp(ral.create_child("board")),
    "crtk.wait_move_handle": crtk.wait_move_handle(psm, psm.ral()),
    "dvrk.psm": psm,
    "dvrk.arm": dvrk.arm(ral, "PSM3"),
    "dvrk.ecm": dvrk.ecm(ral, "ECM"),
    "dvrk.mtm": dvrk.mtm(ral, "MTML"),
    "dvrk.suj": dvrk.suj(ral.create_child("cart")),
    "dvrk.console": dvrk.console(ral),
    "dvrk.system": dvrk.system(ral),
    "dvrk.teleop_psm": dvrk.teleop_psm(ral, "MTML_PSM1"),
    "module crtk": crtk,
    "module crtk.msg_conversions": crtk.msg_conversions,
    "module dvrk": dvrk,
}
found = {key: names(thing) for key, thing in made.items()}
for key, thing in made.items():
    for part in ("body", "spatial", "local", "jaw", "gripper", "PSM1"):
        if key.startswith("dvrk.") and hasattr(thing, part):
            found[f"{key}.{part}"] = names(getattr(thing, part))
found["dvrk.suj.PSM1.local"] = names(made["dvrk.suj"].PSM1.local)
"""


def test_our_modules_have_the_public_names_of_the_genuine_ones(tmp_path: Path) -> None:
    told = tmp_path / "names.json"
    text = SCRIPT + f"with open({str(told)!r}, 'w') as file:\n    json.dump(found, file)\n"
    assert play(tmp_path, text, "full_cart_mtm").status == 0
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))["names"]
    found = json.loads(told.read_text(encoding="utf-8"))
    assert found.keys() == recorded.keys()
    differences = {
        key: (set(words.split()) ^ set(found[key].split())) for key, words in recorded.items()
    }
    assert not {key: names for key, names in differences.items() if names}
