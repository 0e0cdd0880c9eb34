"""Models of SDF inside one another: as the same model written flat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from trocar.formats.links import ImportFileError, SourceModel
from trocar.formats.meshes import ReadOptions
from trocar.formats.sdf import read_sdf

BOX = "<visual name='v'><geometry><box><size>0.1 0.1 0.2</size></box></geometry></visual>"


def link(name: str, pose: str) -> str:
    return f"<link name='{name}'><pose>{pose}</pose>{BOX}</link>"


def joint(name: str, parent: str, child: str, extra: str = "", kind: str = "revolute") -> str:
    axis = f"<axis><xyz>0 1 0</xyz>{extra}<limit><lower>-1</lower><upper>1</upper></limit></axis>"
    axis = axis if kind != "fixed" else ""
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f"<joint name='{name}' type='{kind}'>{ends}{axis}</joint>"


IN_MODEL = "<use_parent_model_frame>1</use_parent_model_frame>"
FINGER = link("base", "0 0 0 0 0 0") + link("tip", "0.1 0 0.2 0 0.3 0")
FINGER += joint("bend", "base", "tip", IN_MODEL)
PALM = link("palm", "0 0 0.5 0 0 0")
AT = "0.2 0.1 0.6 0 0 1.5707963267948966"


def write(path: Path, body: str, name: str = "hand") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<sdf version='1.6'><model name='{name}'>{body}</model></sdf>")
    return path


def read(path: Path) -> SourceModel:
    return read_sdf(path, ReadOptions())


@pytest.fixture
def flat(tmp_path: Path) -> SourceModel:
    """The hand written flat: the finger's poses and axis turned by hand."""
    half = np.pi / 2
    finger = link("finger::base", AT)
    # 0.1 m along the finger's x, which is the hand's y
    finger += link("finger::tip", f"0.2 0.2 0.8 0 0.3 {half}")
    bend = joint("finger::bend", "finger::base", "finger::tip", IN_MODEL)
    bend = bend.replace("<xyz>0 1 0", "<xyz>-1 0 0")
    body = PALM + finger + bend + joint("knuckle", "palm", "finger::base")
    return read(write(tmp_path / "flat.sdf", body))


def test_a_model_of_a_folder_is_included_as_it_stands_there(
    tmp_path: Path, flat: SourceModel
) -> None:
    write(tmp_path / "finger" / "old.sdf", link("other", "0 0 0 0 0 0"), "thing")
    write(tmp_path / "finger" / "new.sdf", FINGER, "thing")
    (tmp_path / "finger" / "model.config").write_text(
        "<model><sdf version='1.4'>old.sdf</sdf><sdf version='1.6'>new.sdf</sdf></model>"
    )
    include = "<include><uri>model://finger</uri><name>finger</name>"
    body = f"{PALM}{include}<pose>{AT}</pose></include>"
    found = read(write(tmp_path / "hand.sdf", body + joint("knuckle", "palm", "finger::base")))
    same(found, flat)


def test_a_model_inside_a_model_is_part_of_it(tmp_path: Path, flat: SourceModel) -> None:
    inner = f"<model name='finger'><pose>{AT}</pose>{FINGER}</model>"
    body = PALM + inner + joint("knuckle", "palm", "finger::base")
    same(read(write(tmp_path / "hand.sdf", body)), flat)


def same(found: SourceModel, flat: SourceModel) -> None:
    """Check that both have the same links and joints, in any order."""
    assert {one.name for one in found.links} == {one.name for one in flat.links}
    mine, other = ({j.name: j for j in one.joints} for one in (found, flat))
    assert set(mine) == set(other)
    for name, joint in mine.items():
        assert (joint.parent, joint.child) == (other[name].parent, other[name].child)
        assert joint.pose == pytest.approx(other[name].pose, abs=1e-12)
        assert joint.axis == pytest.approx(other[name].axis, abs=1e-12)


def test_what_cannot_be_included_is_named(tmp_path: Path) -> None:
    far = "<include><uri>https://models.example/hammer</uri></include>"
    with pytest.raises(ImportFileError, match=r"allowed: a path, file://, model://"):
        read(write(tmp_path / "far.sdf", far))
    absent = "<include><uri>model://nowhere</uri></include>"
    with pytest.raises(ImportFileError, match=r"not found .* --package-path DIR"):
        read(write(tmp_path / "absent.sdf", absent))
    twice = f"<model name='a'>{FINGER}</model>" * 2
    with pytest.raises(ImportFileError, match="has the duplicate name 'a::base'"):
        read(write(tmp_path / "twice.sdf", twice))
    ring = "<include><uri>ring.sdf</uri></include>"
    with pytest.raises(ImportFileError, match="lies in more than 8 models"):
        read(write(tmp_path / "ring.sdf", ring))
