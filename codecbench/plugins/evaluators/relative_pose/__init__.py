"""The `relative_pose` evaluator estimates the motion between two decoded frames from their matches."""

from codecbench.plugins.evaluators.relative_pose.evaluator import RelativePose

__all__ = ["RelativePose"]
