"""The exam: verification tests that engineers put pedestrian models through.

`exam` walks policies through the rooms of RiMEA 4.1.1, IMO MSC.1/Circ.1238 and ISO 20414:2020.
"""

from crowdbench.exam.examine import exam, verdicts
from crowdbench.exam.results import Certificate, Measured, TrialResult
from crowdbench.exam.trial import TRIALS

__all__ = ["TRIALS", "Certificate", "Measured", "TrialResult", "exam", "verdicts"]
