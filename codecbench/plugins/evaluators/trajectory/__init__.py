"""The `trajectory` evaluator runs SLAM on decoded frames and measures the camera's path."""

from codecbench.plugins.evaluators.trajectory.evaluator import TrajectoryEvaluator

__all__ = ["TrajectoryEvaluator"]
