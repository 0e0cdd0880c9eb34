"""Results of the checks, and the report as text tables and as a page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal

from trocar import __version__
from trocar.plotting import pages

Verdict = Literal["pass", "fail", "skip"]


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Attributes:
        group: heading that it stands under
        name: sentence that holds of an arm that conforms
        verdict: "pass", "fail", or "skip" for what was not or could not be tested
        found: measured values, or the reason of a skip
        allowed: bounds of the values, "" where the name says it
        source: document or recording that the check goes by
    """

    group: str
    name: str
    verdict: Verdict
    found: str = ""
    allowed: str = ""
    source: str = ""


def check(
    group: str, name: str, met: bool, found: str = "", allowed: str = "", source: str = ""
) -> CheckResult:
    """Return the result of a check that was made."""
    return CheckResult(group, name, "pass" if met else "fail", found, allowed, source)


def skipped(group: str, name: str, reason: str, source: str = "") -> CheckResult:
    """Return the result of a check that was not made."""
    return CheckResult(group, name, "skip", reason, "", source)


@dataclass(frozen=True)
class ConformanceReport:
    """The results of all checks of an arm.

    Attributes:
        arm, kind: its name, and the interface that was expected of it
        client: transport and address
        moved: whether the arm was commanded
        results: in the order of the checks
    """

    arm: str
    kind: str
    client: str
    moved: bool
    results: tuple[CheckResult, ...]

    def having(self, verdict: Verdict) -> list[CheckResult]:
        """Return the results with a verdict."""
        return [result for result in self.results if result.verdict == verdict]

    @property
    def conforms(self) -> bool:
        """Whether no check failed."""
        return not self.having("fail")

    @property
    def summary(self) -> str:
        """One line: how many checks had which verdict."""
        passed, failed, left = (len(self.having(v)) for v in ("pass", "fail", "skip"))
        return f"{self.arm}: {passed} checks passed, {failed} failed, {left} skipped"

    def document(self) -> dict[str, Any]:
        """Convert to the table of a JSON document."""
        return {
            "arm": self.arm,
            "kind": self.kind,
            "client": self.client,
            "moved": self.moved,
            "conforms": self.conforms,
            **{v: len(self.having(v)) for v in ("pass", "fail", "skip")},
            "results": self.results,
        }


MARKS = {
    "pass": pages.Cell('<span class="good">pass</span>'),
    "fail": pages.Cell('<span class="bad">FAIL</span>'),
    "skip": pages.Cell('<span class="quiet">skip</span>'),
}


def groups(results: Iterable[CheckResult]) -> list[tuple[str, list[CheckResult]]]:
    """Return results under their headings, in order."""
    return [(name, list(rows)) for name, rows in groupby(results, key=lambda r: r.group)]


def page(report: ConformanceReport) -> str:
    """Return the report as a page of HTML."""
    kind = "good" if report.conforms else "bad"
    arm = f"{report.arm} ({report.kind}) over {report.client}"
    how = "small moves were commanded" if report.moved else "nothing was commanded"
    body = [
        f"<h1>Conformance of {pages.text(report.arm)}</h1>",
        f'<p><span class="{kind}">{pages.text(report.summary)}</span></p>',
        f'<p class="quiet">{pages.text(arm)}; {how}; trocar {__version__}.</p>',
    ]
    for name, rows in groups(report.results):
        cells = [(MARKS[row.verdict], row.name, row.found, row.allowed, row.source) for row in rows]
        head = ("", "check", "found", "allowed", "source")
        body += [f"<h2>{pages.text(name)}</h2>", pages.table(head, cells, words=True)]
    return pages.document(f"Conformance of {report.arm}", "".join(body))
