"""A conformance kit for any arm of CRTK: a dVRK, another simulator, this one (docs/conform.md)."""

from trocar.conformance.kit import ConformanceSettings, arms_of, conform
from trocar.conformance.report import CheckResult, ConformanceReport, groups, page

__all__ = [
    "CheckResult",
    "ConformanceReport",
    "ConformanceSettings",
    "arms_of",
    "conform",
    "groups",
    "page",
]
