"""The paper's experiments on the simulation, the paper's figures beside ours."""

from trocar.robot.verification.report import check_report, write_report
from trocar.robot.verification.verify import PARTS, Verification, verify

__all__ = ["PARTS", "Verification", "check_report", "verify", "write_report"]
