"""Settings: any key of a scene's file by its dotted path, checked by the reader of the file."""

import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.settings import read_settings
from trocar.errors import DescriptionError, InputError


def test_settings_are_read_as_values_of_toml_and_else_as_texts() -> None:
    texts = ("a=4", "b.c = [1, 2.5]", "d=true", 'e="x y"', "f=phantom", "g=" + "[" * 9999)
    found = read_settings(texts)
    assert list(found.values())[:5] == [4, [1, 2.5], True, "x y", "phantom"]
    assert list(found) == ["a", "b.c", "d", "e", "f", "g"]


@pytest.mark.parametrize("text", ["stitches", "=4", "a..b=4", ""])
def test_a_setting_without_a_key_is_an_error(text: str) -> None:
    with pytest.raises(InputError, match=r"allowed: KEY=VALUE, as pad.stitches=4"):
        read_settings([text])


def test_a_key_that_is_set_twice_is_an_error() -> None:
    with pytest.raises(InputError, match="got a a second time"):
        read_settings(["a=1", "a=2"])


def test_paths_lead_to_keys_tables_and_rows_by_name_object_kind_and_number() -> None:
    scene = load_scene(
        "suturing",
        {
            "time_limit_s": 9,
            "start_q_rad_m.ECM": [0.0, -0.2, 0.05, 0.0],
            "tissue.stitches": 3,
            "prop.pad.thread.knot_mm": 5,
            "place.needle.turn_deg": 0,
            "goal.0.radius_mm": 7,
        },
    )
    (tissue,) = [prop.tissue for prop in scene.rig.props if prop.tissue]
    assert scene.time_limit == 9.0 and scene.rig.poses["start"]["ECM"][1] == -0.2
    assert (tissue.stitches, tissue.thread.knot) == (3, 5e-3)
    assert scene.placements[0].turn == 0.0 and scene.goals[0].radius == 7e-3
    assert load_scene("suturing").time_limit == 60.0


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("pat.stitches", r"pat.stitches: got 'pat'; allowed: .*pad, .*start_q_rad_m"),
        ("pad.threat.knot_mm", r"got 'threat'; allowed: thread, shape"),
        ("goal.1.radius_mm", r"goal.1.radius_mm: got '1'; allowed: needle"),
        ("goal.radius_mm", r"goal.radius_mm: got 'radius_mm'; allowed: needle"),
        ("time_limit_s.x", r"got 'time_limit_s'; allowed: .*start_q_rad_m"),
    ],
)
def test_a_path_that_leads_nowhere_is_an_error_with_the_known_parts(
    path: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        load_scene("suturing", {path: 1})


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("pad.stitches", 99, r"prop\[2\].stitches: got 99; allowed: 1 to 8"),
        ("pad.stiches", 2, r"prop\[2\].stiches: unknown key; this table knows: .*stitches"),
        ("time_limit_s", "soon", r"time_limit_s: got 'soon'; allowed: a finite number"),
    ],
)
def test_a_value_is_checked_by_the_reader_of_the_file(
    path: str, value: object, message: str
) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_scene("suturing", {path: value})
