"""What SLAM on the decoded frames makes of the camera's path."""

from codecbench.plugins.evaluators.trajectory.evaluator import TrajectoryEvaluator

__all__ = ["TrajectoryEvaluator"]
