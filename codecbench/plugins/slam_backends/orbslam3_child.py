"""The child process of ORB-SLAM3, whose crashes, hangs and output affect nothing else.

It runs as a script and imports nothing of codecbench. Requests come on standard input, answers go to the original
standard output, each as a line of JSON; a frame's line is followed by its pixels. ORB-SLAM3's output goes to the log
file.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from typing import Any, BinaryIO

import numpy as np

_PR_SET_PDEATHSIG, _SIGKILL = 1, 9


def main(log_path: str) -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    log = os.open(log_path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    os.dup2(log, 1)
    os.dup2(log, 2)
    requests = sys.stdin.buffer
    libc = ctypes.CDLL(None)
    if sys.platform == "linux":
        libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL)

    def answer(**values: Any) -> None:
        libc.fflush(None)  # so that the log has all output before this answer
        answers.write(json.dumps(values) + "\n")

    start = json.loads(requests.readline())
    try:
        import pyorbslam3  # GPL: imported only in this process
    except ImportError as error:
        answer(unavailable=str(error))
        os._exit(0)
    slam = pyorbslam3.Slam(start["vocabulary"], start["settings"], pyorbslam3.Sensor.MONOCULAR, use_viewer=False)
    answer(ready=True)
    _track(slam, requests, start["slowdown"], answer)
    # An orderly end of the library's threads gains nothing and sometimes crashes.
    os._exit(0)


def _track(slam: Any, requests: BinaryIO, slowdown: float, answer: Any) -> None:
    """Track frames until the request to finish, at least `slowdown` times the capture interval apart.

    A frame that takes too long delays all later ones, because catching up would leave mapping too little time.
    """
    handed_over: float | None = None
    last_s = 0.0
    for line in iter(requests.readline, b""):
        request = json.loads(line)
        if "save" in request:
            slam.shutdown()
            slam.save_trajectory_euroc(os.path.join(request["save"], "frames.txt"))
            slam.save_keyframe_trajectory_tum(os.path.join(request["save"], "keyframes.txt"))
            answer(saved=True)
            return
        shape, stamp_s = request["shape"], request["timestamp_s"]
        gray = np.frombuffer(requests.read(shape[0] * shape[1]), np.uint8).reshape(shape)
        if handed_over is not None:
            due = handed_over + slowdown * (stamp_s - last_s)
            time.sleep(max(due - time.monotonic(), 0.0))
        handed_over, last_s = time.monotonic(), stamp_s
        started = time.perf_counter()
        result = slam.track_monocular(gray.copy(), stamp_s)
        elapsed_ms = 1e3 * (time.perf_counter() - started)
        pose = np.asarray(result.pose_wc, dtype=np.float64)
        answer(
            tracked=bool(result.pose_valid),
            state=str(result.state),
            world_from_camera=pose.tolist() if result.pose_valid else None,
            inliers=int(result.num_tracked_points),
            elapsed_ms=elapsed_ms,
        )


if __name__ == "__main__":
    main(sys.argv[1])
