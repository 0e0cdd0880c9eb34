"""`python -m benchmarks against`: paired ratios, verdicts, old trees, and the programs it runs."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.against import (
    CASES,
    FIRST_BASE,
    FULL,
    PARTS,
    QUANTITIES,
    ROOT,
    SHORT,
    Case,
    Comparison,
    Plan,
    Quantity,
    against,
    compared,
    last_release,
    live,
    main,
    stepper,
    steps,
    unpacked,
)
from benchmarks.steps import measured
from trocar.errors import InputError, TrocarError

TIME = Quantity("time", "us", goal=1.25, judged=True)
LATE = QUANTITIES["live"]["late"]
LOST = QUANTITIES["live"]["lost"]
TINY = Plan(1, 2, 0.1, 0.3, 2, ("steps",))

git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def quiet(_: str) -> None:
    pass


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """Return a repository of one commit that holds src/trocar/was.py, and of another without."""

    def run(*words: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.example", "-c", "commit.gpgsign=false")
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    run("init", "-b", "main")
    (tmp_path / "README").touch()
    run("add", ".")
    run("commit", "-m", "empty")
    run("branch", "empty")
    (tmp_path / "src" / "trocar").mkdir(parents=True)
    (tmp_path / "src" / "trocar" / "was.py").write_text("OLD = 1\n", encoding="utf-8")
    run("add", ".")
    run("commit", "-m", "package")
    return tmp_path


def test_the_ratio_is_the_median_of_the_pairs_and_not_of_the_runs() -> None:
    # the machine slows down fivefold and recovers; the last run of now is disturbed
    figure = Comparison(TIME, (1.0, 5.0, 2.0), (1.1, 5.5, 6.0))
    assert figure.ratios == pytest.approx((1.1, 1.1, 3.0))
    assert figure.ratio == pytest.approx(1.1)


def test_one_disturbed_pair_of_three_does_not_fail() -> None:
    figure = Comparison(TIME, (1.0, 1.0, 1.0), (1.0, 3.0, 1.05))
    assert not figure.exceeds(1.10)
    assert Comparison(TIME, (1.0, 1.0, 1.0), (1.11, 3.0, 1.12)).exceeds(1.10)


def test_quantities_that_are_only_shown_never_fail() -> None:
    shown = replace(TIME, judged=False)
    assert not Comparison(shown, (1.0,), (9.0,)).exceeds(1.10)


def test_what_the_older_tree_cannot_do_has_no_ratio_and_does_not_fail() -> None:
    figure = Comparison(TIME, (), (1.2,))
    assert figure.ratio is None and not figure.exceeds(1.0)
    assert figure.met is True
    assert figure.row() == ["time", "-", "1.2", "us", "-", "", "<= 1.25", "met"]


def test_goals_are_values_of_now_or_ratios() -> None:
    assert Comparison(TIME, (1.0,), (1.26,)).met is False
    relative = Quantity("processor", "s", goal_ratio=0.9)
    assert Comparison(relative, (10.0,), (8.9,)).met is True
    assert Comparison(relative, (10.0,), (9.1,)).met is False
    assert Comparison(relative, (), (9.1,)).met is None
    late = Quantity("late", "%", goal_ratio=1.0, steady=0.5)
    assert Comparison(late, (0.0, 0.1), (0.06, 0.1)).met is True
    assert Comparison(late, (0.0, 0.1), (0.6, 0.6)).met is False
    assert Comparison(late, (5.0,), (4.9,)).met is True
    assert Comparison(Quantity("none", "s"), (1.0,), (1.0,)).met is None


@pytest.mark.parametrize(
    ("then", "now", "exceeds"),
    [(0.0, 0.0, False), (0.1, 8.0, False), (4.0, 14.0, False), (4.0, 16.0, True),
     (0.0, 11.0, True), (60.0, 75.0, False)],
)  # fmt: skip
def test_lateness_fails_when_it_is_far_from_what_it_was(
    then: float, now: float, exceeds: bool
) -> None:
    assert Comparison(LATE, (then,) * 3, (now,) * 3).exceeds(1.15) is exceeds


def test_lost_messages_fail_above_one_percent() -> None:
    assert not Comparison(LOST, (0.0,), (0.9,)).exceeds(1.15)
    assert Comparison(LOST, (0.0,), (1.1,)).exceeds(1.15)


def test_a_share_that_grew_from_nothing_has_no_finite_ratio() -> None:
    assert Comparison(LATE, (0.0, 0.0), (0.0, 1.0)).ratios == (1.0, math.inf)


def test_runs_are_collected_in_pairs_and_a_missing_clock_leaves_its_figure_out() -> None:
    pairs = [({"late": 1.0, "lost": 0.0}, {"late": 2.0, "lost": 0.0})] * 2
    found = compared("live", pairs)
    assert [figure.quantity.name for figure in found] == [LATE.name, LOST.name]
    assert found[0].then == (1.0, 1.0) and found[0].now == (2.0, 2.0)


def test_runs_of_the_two_trees_alternate_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[Path] = []

    def first(a: Path, b: Path, _: Plan) -> tuple[dict[str, float], dict[str, float]]:
        order.extend((a, b))
        return {"first": 1.0 + (a == ROOT)}, {"first": 1.0 + (b == ROOT)}

    monkeypatch.setitem(PARTS, "first", first)
    then = Path("then")
    (figure,) = against(then, ["first"], replace(FULL, pairs=2), math.inf, quiet)
    assert order == [then, ROOT, ROOT, then]
    assert figure.then == (1.0, 1.0) and figure.now == (2.0, 2.0)


@pytest.mark.parametrize(("later", "exceeds"), [(1.0, False), (2.0, True)])
def test_what_is_above_the_bound_is_measured_again_before_it_fails(
    monkeypatch: pytest.MonkeyPatch, later: float, exceeds: bool
) -> None:
    values = iter([2.0, 2.0, 2.0, *[later] * 6])
    then = Path("then")

    def first(a: Path, _b: Path, _plan: Plan) -> tuple[dict[str, float], dict[str, float]]:
        old, new = {"first": 1.0}, {"first": next(values)}
        return (old, new) if a == then else (new, old)

    monkeypatch.setitem(PARTS, "first", first)
    (figure,) = against(then, ["first"], replace(FULL, pairs=3), 1.1, quiet)
    assert len(figure.now) == 9 and figure.exceeds(1.1) is exceeds


def test_what_is_within_the_bound_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PARTS, "first", lambda *_: ({"first": 1.0}, {"first": 1.0}))
    (figure,) = against(Path("then"), ["first"], replace(FULL, pairs=2), 1.1, quiet)
    assert len(figure.now) == 2


def compare(monkeypatch: pytest.MonkeyPatch, now: float, *words: str) -> int:
    """Run `main` on runs of `first` that take 1.0 of then and `now` of this tree."""

    def first(a: Path, b: Path, _: Plan) -> tuple[dict[str, float], dict[str, float]]:
        return {"first": now if a == ROOT else 1.0}, {"first": now if b == ROOT else 1.0}

    monkeypatch.setitem(PARTS, "first", first)
    return main(["HEAD", "--only", "first", "--pairs", "2", *words])


in_a_clone = pytest.mark.skipif(
    shutil.which("git") is None or not (ROOT / ".git").exists(), reason="not a clone"
)


@in_a_clone
def test_a_slower_tree_ends_with_status_1_and_the_name_of_the_figure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare(monkeypatch, 1.2, "--worst", "1.15") == 1
    printed = capsys.readouterr()
    assert "1.200" in printed.out and "MISSED" in printed.out
    assert "servo_jp to first measured motion: ratio 1.200, allowed 1.15" in printed.err


@in_a_clone
def test_without_a_bound_and_within_it_the_status_is_0(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compare(monkeypatch, 1.2) == 0
    assert compare(monkeypatch, 1.1, "--worst", "1.15") == 0


@in_a_clone
def test_the_comparison_is_one_document(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare(monkeypatch, 1.2, "--worst", "1.15", "--json") == 1
    document = json.loads(capsys.readouterr().out)
    (figure,) = document["figures"]
    assert document["exceeded"] == ["servo_jp to first measured motion"]
    assert (figure["then"], figure["now"], figure["ratio"]) == (1.0, 1.2, 1.2)
    assert set(figure["ratios"]) == {1.2} and figure["met"] is False


@git
def test_an_unknown_commit_is_refused_with_what_to_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["0123456789abcdef0123456789abcdef01234567"]) == 2
    error = capsys.readouterr().err
    assert "got '0123456789abcdef0123456789abcdef01234567'" in error
    assert "git fetch --unshallow" in error and error.count("\n") == 1


@git
def test_a_commit_is_unpacked_and_removed_at_the_end(clone: Path) -> None:
    with unpacked("main", clone) as tree:
        assert (tree / "src" / "trocar" / "was.py").read_text(encoding="utf-8") == "OLD = 1\n"
    assert not tree.exists()


@git
@pytest.mark.parametrize("commit", ["empty", "HEAD~7", "-o", ""])
def test_a_commit_without_the_package_is_refused(clone: Path, commit: str) -> None:
    with (
        pytest.raises(InputError, match="allowed: a commit, tag or branch"),
        unpacked(commit, clone),
    ):
        pass


@git
def test_the_base_is_the_last_release_and_689c4fe_before_one(clone: Path) -> None:
    assert last_release(clone) == FIRST_BASE == "689c4fe"
    subprocess.run(["git", "tag", "v0.1.0"], cwd=clone, check=True)
    assert last_release(clone) == "v0.1.0"


@pytest.mark.parametrize(
    ("words", "allowed"),
    [(["--pairs", "0"], "--pairs: got 0; allowed: 1 or more"),
     (["--worst", "0"], "--worst: got 0; allowed: above 0"),
     (["--worst", "nan"], "--worst: got nan; allowed: above 0")],
)  # fmt: skip
def test_numbers_that_cannot_be_are_refused(
    words: list[str], allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert allowed in capsys.readouterr().err


def test_steps_of_this_tree_are_measured_beside_bare_mujoco(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    short = tuple(replace(case, count=20) for case in CASES)
    monkeypatch.setattr("benchmarks.against.CASES", short)
    one, other = steps(ROOT, ROOT, TINY)
    assert set(one) == set(other) >= set(QUANTITIES["steps"])
    assert all(value > 0.0 for value in one.values())


def test_another_package_is_not_taken_for_the_trees(tmp_path: Path) -> None:
    with pytest.raises(TrocarError, match="instead of"), stepper(tmp_path):
        pass


def test_a_stepper_that_ends_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = Case("no_such_rig", "", 1, None, 1.0)
    monkeypatch.setattr("benchmarks.against.CASES", (nothing,))
    with pytest.raises(TrocarError, match="ended with exit code 1"), stepper(ROOT):
        pass


def test_worlds_that_keep_their_model_private_are_measured_too() -> None:
    import mujoco

    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    counts: list[int] = []
    old = SimpleNamespace(step=counts.append, _model=model, _data=mujoco.MjData(model))
    assert all(took > 0.0 for took in measured((old, old), 40))
    assert counts == [1] * 40 + [20] * 2


def test_a_subscription_is_measured_in_its_window() -> None:
    run = live(ROOT, TINY)
    assert set(run) >= {"late", "lost"}
    assert 0.0 <= run["late"] <= 100.0 and 0.0 <= run["lost"] < 100.0
    if Path("/proc/self/stat").exists():
        assert run["processor"] > 0.0


def test_the_short_form_has_what_continuous_integration_judges() -> None:
    assert set(SHORT.parts) == {"steps", "live", "busy"} < set(FULL.parts) == set(PARTS)
    assert set(QUANTITIES) == set(PARTS)


@git
def test_continuous_integration_hands_over_words_that_are_understood(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # it goes on after exit status 2, which a misspelt option has as well
    found = re.search(r"-m benchmarks against (.*) \|\|", (ROOT / ".ci/run").read_text("utf-8"))
    assert found is not None
    assert main([*found[1].split(), "no-such-commit"]) == 2
    assert "got 'no-such-commit'" in capsys.readouterr().err
