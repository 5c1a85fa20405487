"""`report.html` of the comparison: a single file that loads nothing else."""

from __future__ import annotations

from eval.views.report.maps import robustness_maps
from eval.views.report.page import write_report
from eval.views.report.scenes import Recordings, record_scenes

__all__ = ["Recordings", "record_scenes", "robustness_maps", "write_report"]
