"""Clips as other programs move them: glTF, BVH, ROS 2 bags, OpenXR's joints, VMC over OSC (docs/export.md)."""
