"""Each call that docs/script-calls.md lists does what it does on the robot."""

from __future__ import annotations

import json

import pytest

from tests.scripts.api_rows import PARTS
from tests.scripts.playing import play

ROWS = [(part, row) for part, (_, _, rows) in PARTS.items() for row in rows]
RUN = """
import json, traceback
results = {}
for row, check in json.loads(ROWS).items():
    try:
        exec(check, globals())
        results[row] = ""
    except Exception:
        results[row] = traceback.format_exc()
with open(RESULTS, "w") as file:
    json.dump(results, file)
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What went wrong with each row, "" where nothing did."""
    found: dict[str, str] = {}
    for part, (rig, first, rows) in PARTS.items():
        folder = tmp_path_factory.mktemp(part)
        told = folder / "results.json"
        head = f"ROWS = {json.dumps(rows)!r}\nRESULTS = {str(told)!r}\n"
        outcome = play(folder, first + head + RUN, rig)
        assert outcome.status == 0, part
        found |= json.loads(told.read_text(encoding="utf-8"))
    return found


def test_each_row_of_the_table_is_true(results: dict[str, str]) -> None:
    assert len(results) == len(ROWS)
    assert not {row: problem for row, problem in results.items() if problem}
