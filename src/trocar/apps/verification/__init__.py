"""The paper's experiments on the simulation, the paper's figures beside ours."""

from trocar.apps.verification.report import check_report, write_report
from trocar.apps.verification.verify import PARTS, Verification, verify

__all__ = ["PARTS", "Verification", "check_report", "verify", "write_report"]
