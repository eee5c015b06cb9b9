"""Export of devices and effects to MuJoCo, URDF, SDF, Isaac Lab, BAM and ros2_control.

from via_export import check, export
"""

from via_export.arm_causes import add_arm_cause
from via_export.checking import Check, check
from via_export.exporting import Export, export
from via_export.slots import FORMATS, Loss

__all__ = ["FORMATS", "Check", "Export", "Loss", "add_arm_cause", "check", "export"]
