"""Choosing bodies from tracks."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError, TracksError
from trocar.robot.calibration import check_together, parse_bodies, read_tracks, select_bodies


def test_bodies_are_taken_under_the_names_of_the_links(motive_file):
    tracks = read_tracks(motive_file(("psm_yaw", "Rigid Body 3")))
    named = parse_bodies("psm_yaw=Rigid Body 3, psm_base = psm_base")
    assert named == {"psm_yaw": "Rigid Body 3", "psm_base": "psm_base"}
    chosen = select_bodies(tracks, named)
    assert list(chosen.poses) == ["psm_yaw", "psm_base"]
    assert np.array_equal(chosen.poses["psm_yaw"], tracks.poses["Rigid Body 3"], equal_nan=True)


def test_a_comma_may_be_part_of_a_name():
    assert parse_bodies("a=left, new,b=right") == {"a": "left, new", "b": "right"}


@pytest.mark.parametrize(
    ("text", "said"),
    [("psm_yaw", "got 'psm_yaw'; allowed: BODY=NAME"), ("a=", "got 'a='"), ("=b", "got '=b'"),
     ("a=b,a=c", "got a a second time")],
)  # fmt: skip
def test_a_list_of_bodies_that_is_none_is_refused(text, said):
    with pytest.raises(InputError) as refused:
        parse_bodies(text)
    assert said in str(refused.value)


def test_missing_bodies_are_listed_beside_those_found_and_expected(motive_file):
    tracks = read_tracks(motive_file())
    wanted = {"psm_base": "psm_base", "psm_end": "End", "psm_top": "psm_top"}
    with pytest.raises(TracksError) as refused:
        select_bodies(tracks, wanted, optional=("psm_top",))
    for said in ("bodies missing: psm_end ('End');", "found: psm_base, psm_yaw;",
                 "expected: psm_base, psm_end, psm_top;", "--bodies psm_end=NAME"):  # fmt: skip
        assert said in str(refused.value)
    assert "psm_top" not in select_bodies(tracks, {"psm_base": "psm_base", "psm_top": "x"},
                                          optional={"psm_top"}).poses  # fmt: skip


def test_a_body_that_is_nowhere_tracked_is_refused(tidy_file):
    tracks = read_tracks(tidy_file("0,a,0,0,0,1,0,0,0", "0,b,,,,,,,", "1,a,0,0,0,1,0,0,0"))
    with pytest.raises(TracksError, match="not tracked in any sample: b"):
        select_bodies(tracks, {"a": "a", "b": "b"})


def test_bodies_that_are_never_seen_together_are_refused(tidy_file):
    at = "0,0,0,1,0,0,0"
    tracks = read_tracks(tidy_file(f"0,a,{at}", f"1,a,{at}", f"1.5,b,1{at[1:]}", f"4,b,1{at[1:]}"))
    with pytest.raises(TracksError) as refused:
        check_together(tracks, "a", "b")
    for said in (
        "a and b are tracked together in 0 samples; needed: 1",
        "a: 2 of 4 samples, from 0.000 to 1.000 s",
        "b: 2 of 4 samples, from 1.500",
    ):
        assert said in str(refused.value)
    check_together(read_tracks(tidy_file(f"0,a,{at}", f"0,b,1{at[1:]}", f"1,a,{at}")), "a", "b")
