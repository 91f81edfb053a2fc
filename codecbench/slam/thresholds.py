"""Every threshold of the SLAM, in one place: name, unit, meaning, source.

The values are the same for every sequence. *ORB-SLAM* stands for Mur-Artal, Montiel, Tardos, "ORB-SLAM: a Versatile
and Accurate Monocular SLAM System", IEEE T-RO 31(5), 2015, doi:10.1109/TRO.2015.2463671; *ORB* for Rublee, Rabaud,
Konolige, Bradski, ICCV 2011; *own* for values measured with this code.
"""

from __future__ import annotations

from typing import Final

# Statistics -----------------------------------------------------------------------------------------------------
CHI2_95_1DOF: Final = 3.841
"""Chi-square at 95 %, one degree of freedom: squared epipolar distance over sigma squared (ORB-SLAM III-E)."""
CHI2_95_2DOF: Final = 5.991
"""Chi-square at 95 %, two degrees of freedom: squared reprojection error over sigma squared (ORB-SLAM III-E)."""
CHI2_99_2DOF: Final = 9.210
"""Chi-square at 99 %, two degrees of freedom: outliers of a Sim(3) alignment (ORB-SLAM VII-B)."""

# Features -------------------------------------------------------------------------------------------------------
FAST_THRESHOLD: Final = 20
"""Gray levels: contrast of a FAST corner at first try (ORB-SLAM V-A)."""
FAST_THRESHOLD_LOW: Final = 7
"""Gray levels: contrast where the first try finds too few corners (own)."""
FAST_CANDIDATES_PER_FEATURE: Final = 1.5
"""Candidates for each feature wanted of a level; with fewer, the level is searched at the low threshold (own)."""
KEYPOINT_SIGMA_PX: Final = 0.33
"""Level pixels: standard deviation along each axis with which corners are found (own; residuals after adjustment, by
their median: 0.15 on rendered sequences, 0.2 on a street and on the coarse levels of a hand-held camera)."""
CAMERA_SIGMA_DEG: Final = 0.075
"""Degrees in the middle of the image: the same for what the camera's model leaves out, on every level (own; residuals
of a hand-held camera grow with its focal length and have a part of 0.04 degrees; with 0.05 the sharp turns of a street
are lost in some runs at 5 Hz, because the gates are as narrow)."""
POINT_VARIANCES: Final = 2.0
"""Times a keypoint's variance: that of how far it is from where a map point should be in a frame, because points are
known from keypoints, too (own)."""
PATCH_RADIUS_PX: Final = 15
"""Level pixels: radius of the disc whose centroid gives a feature its orientation (ORB section 3.2)."""
BORDER_PX: Final = 19
"""Level pixels: no feature nearer to the border; the turned test pattern reaches 13 * sqrt(2) = 18.4 (ORB)."""
BLUR_SIGMA_PX: Final = 2.0
"""Level pixels: smoothing before the binary tests, kernel of 7 pixels (ORB section 4)."""
FISHEYE_ANGLE_DEG: Final = 75.0
"""Degrees from a fisheye's axis: features farther out are left out, because an undistorted pixel there is 15 times as
large as in the middle, which no pixel's uncertainty says (own)."""

# Descriptors, in bits of 256 --------------------------------------------------------------------------------------
HAMMING_HIGH: Final = 100
"""Largest distance of a match that a predicted position supports (ORB-SLAM V)."""
HAMMING_LOW: Final = 50
"""Largest distance of a match that appearance alone, or an epipolar line, supports (ORB-SLAM V)."""
ROTATION_BINS: Final = 30
"""Bins of the histogram of orientation differences: 12 degrees each (ORB-SLAM V)."""
ROTATION_PEAKS: Final = 3
"""Peaks of that histogram whose matches are kept (ORB-SLAM V)."""

# Initialisation ---------------------------------------------------------------------------------------------------
INIT_MIN_FEATURES: Final = 100
"""Features: fewer in a frame and it cannot start or finish an initialisation (ORB-SLAM IV)."""
INIT_MIN_MATCHES: Final = 100
"""Matches: fewer between the two frames and the reference frame is replaced (ORB-SLAM IV)."""
INIT_WINDOW_DEG: Final = 10.0
"""Degrees in the middle of the image: half side of the window in which a match is searched between two frames (own)."""
INIT_RATIO: Final = 0.9
"""Best over second-best distance of such a match (own)."""
INIT_RANSAC_ITERATIONS: Final = 200
"""Samples of eight matches; the homography takes the first four of each (ORB-SLAM IV; there, all eight)."""
INIT_HOMOGRAPHY_SHARE: Final = 0.45
"""S_H / (S_H + S_F) above which the homography is chosen (ORB-SLAM IV, equation 4)."""
INIT_ROTATION_SHARE: Final = 0.9
"""Of the chosen model's inliers: when a rotation explains more, nothing shows that the camera moved (own)."""
INIT_MIN_PARALLAX_DEG: Final = 1.0
"""Degrees: parallax that the INIT_PARALLAX_RANK-th best point must reach (ORB-SLAM IV)."""
INIT_PARALLAX_RANK: Final = 50
"""Points: see INIT_MIN_PARALLAX_DEG (own)."""
INIT_MIN_POINTS: Final = 50
"""Points: fewer triangulated by the winning motion and the initialisation is refused (own)."""
INIT_WINNER_SHARE: Final = 0.9
"""Of the inliers: share of points that the winning motion must triangulate (own)."""
INIT_RIVAL_SIGMAS: Final = 4.0
"""Standard deviations: by so much must the matches that agree with only one of two motions be the winner's, or the
start is ambiguous (McNemar 1947; ORB-SLAM IV: one clear winner)."""
INIT_SAME_MOTION_DEG: Final = 5.0
"""Degrees: motions nearer in rotation and in direction are no rivals (own)."""
INIT_MAX_DEVIATION_DEG: Final = 6.0
"""Degrees: standard deviation of the direction of motion above which the first map would be too bent to grow from:
planes seen from nearly one place (own)."""
INIT_MAX_COSINE: Final = 0.99998
"""Cosine between two rays above which a point's depth is unknown: 0.36 degrees (own)."""
INIT_MAX_FRAMES: Final = 90
"""Frames: age at which the reference frame is replaced though it still matches (own). In frames because it only bounds
the wait of a camera that hardly moves; one that moves loses its matches, and the reference with them, at any rate."""

TRIAL_MISFIT: Final = 0.6
"""Of the misfit that a rotation leaves: a young map that leaves more is dropped (own; of maps that were wrong by a
fifth of the way and more, 36 of 77 were, of those wrong by less than a tenth 4 of 165)."""
TRIAL_FRAMES: Final = 10
"""Frames that a young map is on trial for (own)."""
TRIAL_RANSAC_ITERATIONS: Final = 30
"""Samples of two matches for that rotation (own)."""

# Tracking -----------------------------------------------------------------------------------------------------------
TRACK_WINDOW_DEG: Final = 1.6
"""Degrees in the middle of the image, at the finest level: search radius round a position that the motion model
predicts. How far a camera turns from what was expected does not depend on its pixels (own)."""
TRACK_WINDOW_WIDE_DEG: Final = 3.2
"""Degrees, as TRACK_WINDOW_DEG: second try (own)."""
TRACK_RATIO: Final = 0.9
"""Best over second-best distance, where both lie on one level, of a match in those windows (own)."""
TRACK_MIN_MATCHES: Final = 20
"""Matches: fewer by the motion model and the wide window, then the reference keyframe, is tried (ORB-SLAM V-B)."""
TRACK_MIN_INLIERS: Final = 10
"""Points: fewer after optimisation and a first guess of the pose is refused (own). So few are tried round the
prediction where neither TRACK_MIN_MATCHES nor a keyframe's view gives a pose: LOCAL_MIN_INLIERS decides then."""
KEYFRAME_MIN_MATCHES: Final = 15
"""Matches: fewer with the reference keyframe and it cannot give a pose (own)."""
KEYFRAME_RATIO: Final = 0.7
"""Best over second-best distance of such a match (own)."""
LOCAL_WINDOW_PX: Final = 4.0
"""Pixels at the finest level: search radius of a local map point seen obliquely (own). What is in pixels from here
on covers what keypoints and poses are off by; on a street of twice the size, larger windows gained nothing."""
LOCAL_WINDOW_FRONTAL_PX: Final = 2.5
"""Pixels at the finest level: search radius of a local map point seen as before (own)."""
POSE_GATE_MEDIANS: Final = 3.0
"""Times the median error, in deviations, of the points that a frame shows: those farther off have no say in its pose,
and stay matched within the gate of outliers, which noisy frames need so wide; where the others fit three times as well,
four wrong points of 289 have turned a pose by 0.9 degrees (own; at 2.6 tracks are lost)."""
FRONTAL_COSINE: Final = 0.998
"""Cosine between viewing ray and mean viewing ray above which a point is seen as before (own)."""
VIEWING_COSINE: Final = 0.5
"""Cosine between viewing ray and mean viewing ray below which a point is not searched: 60 degrees (ORB-SLAM V-D)."""
DISTANCE_MARGIN: Final = 1.2
"""Times: how far a point's distance may leave the range that the pyramid covers (ORB-SLAM V-D; the margin is own)."""
LOCAL_RATIO: Final = 0.8
"""Best over second-best distance, where both lie on one level, of a local map match (own)."""
LOCAL_KEYFRAMES: Final = 80
"""Keyframes: largest local map (own)."""
LOCAL_MIN_INLIERS: Final = 15
"""Points: fewer in the local map and the frame is lost (own; a street's right-angle turns at 5 Hz leave 20 to 30, and
with 20 one of ten runs is lost there; that few are sure because chance seldom brings a match within the gates, which
leave it half a pixel to a pixel and a half where they left one to three and a half)."""
RELOCALIZED_MIN_INLIERS: Final = 50
"""Points: the same for the frame that relocalises (ORB-SLAM V-C)."""
MAX_VELOCITY_GAP: Final = 5.0
"""Times the last frame interval: beyond this gap the motion model is not trusted (own)."""
SMALL_MAP_KEYFRAMES: Final = 5
"""Keyframes: a map with no more is taken into no other (own)."""

# Keyframe decision --------------------------------------------------------------------------------------------------
KEYFRAME_NEXT_SHARE: Final = 0.7
"""Of the reference keyframe's points: a keyframe is needed where the next frame would see fewer (own; a street whose
turns lose the camera without this is tracked whole with 0.6 and with 0.8, too)."""
KEYFRAME_MAX_SHARE: Final = 0.9
"""Of the reference keyframe's points: a frame with more is not welcome as a keyframe (ORB-SLAM V-E)."""
KEYFRAME_BUDGET: Final = 0.25
"""Keyframes a frame: no more where they are welcome and not needed; mapping one costs as much as tracking two to four
frames, and so takes at most half of the time (own)."""
KEYFRAME_FULL_SHARE: Final = 2.0 / 15.0
"""Of a frame's features: a reference keyframe with fewer points counts as one with so many: the map is thin (own)."""

DECODED_WINDOW_PX: Final = 1.5
"""Pixels at the finest level: how far a feature may move when a keyframe's image is coded and decoded (own)."""

# Mapping ------------------------------------------------------------------------------------------------------------
TRIANGULATION_NEIGHBORS: Final = 10
"""Keyframes: covisible ones in which a new keyframe's free features are searched (own)."""
TRIANGULATION_MAX_COSINE: Final = 0.9998
"""Cosine between two rays above which their point is too uncertain: 1.15 degrees (own)."""
TRIANGULATION_OCTAVES_APART: Final = 2
"""Levels: most between two features that match (own)."""
TRIANGULATION_MIN_BASELINE: Final = 0.014
"""Of the median depth: shorter baselines are not used (own; with 0.01 a camera that turns is lost under coarse coding;
0.02, where a point of median depth passes TRIANGULATION_MAX_COSINE, costs the office half a millimeter)."""
EPIPOLE_RADIUS_PX: Final = 10.0
"""Pixels at the finest level: no match nearer to the epipole, where depth is undetermined (own)."""
SCALE_CONSISTENCY: Final = 1.5
"""Times the level factor: how far the ratio of distances may leave the ratio of feature scales (own)."""
POINT_MIN_FOUND_SHARE: Final = 0.25
"""Of the frames in which a new point should be visible: it must be found in so many (ORB-SLAM VI-B)."""
POINT_MIN_OBSERVATIONS: Final = 3
"""Keyframes: a new point must be seen by so many once POINT_TRIAL_KEYFRAMES have passed (ORB-SLAM VI-B), and counts
among a reference keyframe's points from then on (own)."""
POINT_TRIAL_KEYFRAMES: Final = 2
"""Keyframes: see POINT_MIN_OBSERVATIONS (ORB-SLAM VI-B)."""
POINT_PROBATION_KEYFRAMES: Final = 3
"""Keyframes: age at which a point is no longer on probation (ORB-SLAM VI-B)."""
DESCRIPTORS_COMPARED: Final = 12
"""Descriptors: most that a point's representative one is chosen from, the newest ones (own; keeps a step bounded)."""
FUSE_WINDOW_PX: Final = 3.0
"""Pixels at the finest level: search radius for duplicates of a point (own)."""
REDUNDANT_SHARE: Final = 0.9
"""Of a keyframe's points: so many seen by three others at the same or a finer scale make it redundant (VI-E)."""
REDUNDANT_OBSERVATIONS: Final = 3
"""Keyframes: see REDUNDANT_SHARE (ORB-SLAM VI-E)."""
COVISIBLE_MIN_POINTS: Final = 15
"""Points: shared by two keyframes that are neighbours in the covisibility graph (ORB-SLAM III-D)."""
LOCAL_BUNDLE_KEYFRAMES: Final = 10
"""Keyframes: free ones in a local bundle adjustment (own; keeps a step bounded)."""
LOCAL_BUNDLE_FIXED: Final = 30
"""Keyframes: fixed ones in a local bundle adjustment, those that see most of its points (own)."""
LOCAL_BUNDLE_TOLERANCE: Final = 1e-3
"""Of the cost: a round of a local adjustment ends with a step that gains less; the next one goes on (own)."""
MAP_HUBER_SIGMAS: Final = 0.6
"""Standard deviations: observations that are farther off have less and less say when a whole map is adjusted. 1.345
times (Huber 1981) the spread of what is left, which is 0.35 to 0.5 of the deviations that make the gates (own)."""

# Place recognition ----------------------------------------------------------------------------------------------------
SHARED_WORDS_SHARE: Final = 0.8
"""Of the most words that any keyframe shares with an image: a keyframe with no more is not scored (own)."""
GROUP_SCORE_SHARE: Final = 0.75
"""Of the best group's score: a group with no more gives no candidate (ORB-SLAM VI-C)."""
GROUP_NEIGHBORS: Final = 10
"""Keyframes: best covisible ones whose scores are added to a keyframe's (own)."""

# Relocalisation and loops ---------------------------------------------------------------------------------------------
RELOCALIZATION_CANDIDATES: Final = 8
"""Keyframes: tried for a lost frame, of all maps together, so that a frame's time has a bound (own)."""
RELOCALIZATION_RATIO: Final = 0.75
"""Best over second-best distance of a match with a candidate (own)."""
RELOCALIZATION_WIDENING: Final = 3.0
"""Times the windows of the local map: search for a candidate's points after the first pose (own)."""
RELOCALIZATION_ITERATIONS: Final = 300
"""RANSAC samples for the pose of a lost frame (own)."""
PNP_ERROR_PX: Final = 4.0
"""Pixels at the finest level: inliers of that pose (own)."""
LOOP_CONSISTENT_KEYFRAMES: Final = 3
"""Keyframes in a row whose candidates must be consistent, in their own map or in another (ORB-SLAM VII-A)."""
LOOP_MIN_GAP_KEYFRAMES: Final = 10
"""Keyframes: no loop is closed so soon after another one (own)."""
LOOP_MIN_MATCHES: Final = 20
"""Matches: fewer with a candidate and no similarity is sought (ORB-SLAM VII-B)."""
LOOP_MIN_INLIERS: Final = 10
"""Matches: inliers that a similarity needs (own; ORB-SLAM VII-B asks for enough of them)."""
LOOP_WINDOW_PX: Final = 7.5
"""Pixels at the finest level: search radius for points projected by a similarity (own)."""
LOOP_RATIO: Final = 0.75
"""Best over second-best distance of a match with a candidate (own)."""
LOOP_MIN_PROJECTED: Final = 40
"""Matches: found by projecting the loop side's points, for the loop to be accepted (own)."""
LOOP_MIN_PROJECTED_SHARE: Final = 0.1
"""Of the loop side's points that should be in view: so many must be found, or it is another place with some of the same
things in it (own; true loops found 0.12 to 0.45, those of two equal houses 0.08)."""
LOOP_RANSAC_ITERATIONS: Final = 300
"""RANSAC samples of three matches (own)."""
ESSENTIAL_MIN_WEIGHT: Final = 100
"""Points: shared by keyframes that an essential-graph edge joins (ORB-SLAM III-D)."""
