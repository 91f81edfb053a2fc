"""Every threshold of the SLAM, in one place: name, unit, meaning, source.

The values are the same for every sequence. *ORB-SLAM* is Mur-Artal, Montiel, Tardos, "ORB-SLAM: a Versatile
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
"""Gray levels: contrast of a FAST corner at the first try (ORB-SLAM V-A)."""
FAST_THRESHOLD_LOW: Final = 7
"""Gray levels: contrast if the first try finds too few corners (own)."""
FAST_CANDIDATES_PER_FEATURE: Final = 1.5
"""Candidates per feature of a level's quota; with fewer, the level is searched at the low threshold (own)."""
KEYPOINT_SIGMA_PX: Final = 0.33
"""Level pixels: standard deviation of a corner's position along each axis (own; median residuals after adjustment: 0.15
on rendered sequences, 0.2 on a street and on the coarse levels of a hand-held camera)."""
CAMERA_SIGMA_DEG: Final = 0.075
"""Degrees in the middle of the image: standard deviation of the camera model's error, on every level (own; residuals of
a hand-held camera grow with its focal length and have a part of 0.04 degrees; with 0.05, whose gates are narrower, the
sharp turns of a street are lost in some runs at 5 Hz)."""
POINT_VARIANCES: Final = 2.0
"""Times a keypoint's variance: variance of its distance from a projected map point, whose position also comes from
keypoints (own)."""
PATCH_RADIUS_PX: Final = 15
"""Level pixels: radius of the disc whose centroid gives a feature its orientation (ORB section 3.2)."""
BORDER_PX: Final = 19
"""Level pixels: no feature is nearer to the border; the rotated test pattern reaches 13 * sqrt(2) = 18.4 (ORB)."""
BLUR_SIGMA_PX: Final = 2.0
"""Level pixels: smoothing before the binary tests, kernel of 7 pixels (ORB section 4)."""
FISHEYE_ANGLE_DEG: Final = 75.0
"""Degrees from a fisheye's axis: features farther out are dropped. An undistorted pixel there is 15 times as large as
in the middle, and the variances do not include that (own)."""

# Descriptors, in bits of 256 --------------------------------------------------------------------------------------
HAMMING_HIGH: Final = 100
"""Largest distance of a match that a predicted position supports (ORB-SLAM V)."""
HAMMING_LOW: Final = 50
"""Largest distance of a match that appearance alone, or an epipolar line, supports (ORB-SLAM V)."""
ROTATION_BINS: Final = 30
"""Bins of the histogram of orientation differences: 12 degrees each (ORB-SLAM V)."""
ROTATION_PEAKS: Final = 3
"""Peaks of that histogram; other matches are removed (ORB-SLAM V)."""

# Initialization ---------------------------------------------------------------------------------------------------
INIT_MIN_FEATURES: Final = 100
"""Features: least in a frame to start or finish an initialization (ORB-SLAM IV)."""
INIT_MIN_MATCHES: Final = 100
"""Matches: with fewer between the two frames, the reference frame is replaced (ORB-SLAM IV)."""
INIT_WINDOW_DEG: Final = 10.0
"""Degrees in the middle of the image: half side of the search window for a match between two frames (own)."""
INIT_RATIO: Final = 0.9
"""Largest ratio of best to second-best distance of such a match (own)."""
INIT_RANSAC_ITERATIONS: Final = 200
"""Samples of eight matches; the homography takes the first four of each (ORB-SLAM IV; there, all eight)."""
INIT_HOMOGRAPHY_SHARE: Final = 0.45
"""S_H / (S_H + S_F) above which the homography is chosen (ORB-SLAM IV, equation 4)."""
INIT_ROTATION_SHARE: Final = 0.9
"""Share of the chosen model's inliers: if a rotation explains more, nothing shows that the camera moved (own)."""
INIT_MIN_PARALLAX_DEG: Final = 1.0
"""Degrees: parallax that the INIT_PARALLAX_RANK-th best point must reach (ORB-SLAM IV)."""
INIT_PARALLAX_RANK: Final = 50
"""Points: see INIT_MIN_PARALLAX_DEG (own)."""
INIT_MIN_POINTS: Final = 50
"""Points: least that the best motion must triangulate (own)."""
INIT_WINNER_SHARE: Final = 0.9
"""Share of the inliers: points that the best motion must triangulate (own)."""
INIT_RIVAL_SIGMAS: Final = 4.0
"""Standard deviations: least lead of the best motion among the matches that agree with only one of two motions;
otherwise the initialization is ambiguous (McNemar 1947; ORB-SLAM IV: one clear winner)."""
INIT_SAME_MOTION_DEG: Final = 5.0
"""Degrees: two motions nearer in rotation and in direction count as one (own)."""
INIT_MAX_DEVIATION_DEG: Final = 6.0
"""Degrees: largest standard deviation of the direction of motion. Above it, as for planes seen from nearly one place,
the first map would be too distorted to extend (own)."""
INIT_MAX_COSINE: Final = 0.99998
"""Cosine between two rays above which a point's depth is unknown: 0.36 degrees (own)."""
INIT_MAX_FRAMES: Final = 90
"""Frames: age at which the reference frame is replaced although it still matches (own). The unit is frames because the
limit only bounds the wait of a camera that hardly moves; a moving one loses its matches, and thus the reference."""

TRIAL_MISFIT: Final = 0.6
"""Share of a rotation's misfit: a young map with more is dropped (own; it dropped 36 of 77 maps that were wrong by a
fifth of the way and more, and 4 of 165 that were wrong by less than a tenth)."""
TRIAL_FRAMES: Final = 10
"""Frames for which a young map is on trial (own)."""
TRIAL_RANSAC_ITERATIONS: Final = 30
"""RANSAC samples of two matches for that rotation (own)."""

# Tracking -----------------------------------------------------------------------------------------------------------
TRACK_WINDOW_DEG: Final = 1.6
"""Degrees in the middle of the image, at the finest level: search radius around a position that the motion model
predicts. A camera's unpredicted rotation does not depend on its pixels (own)."""
TRACK_WINDOW_WIDE_DEG: Final = 3.2
"""Degrees, like TRACK_WINDOW_DEG, for the second try (own)."""
TRACK_RATIO: Final = 0.9
"""Largest ratio of best to second-best distance, if both lie on one level, of a match in those windows (own)."""
TRACK_MIN_MATCHES: Final = 20
"""Matches: with fewer by the motion model, the wide window, then the reference keyframe is tried (ORB-SLAM V-B)."""
TRACK_MIN_INLIERS: Final = 10
"""Points: with fewer after optimization, a first guess of the pose is rejected (own). If neither TRACK_MIN_MATCHES nor
a keyframe gives a pose, so few matches around the prediction are tried; LOCAL_MIN_INLIERS then decides."""
KEYFRAME_MIN_MATCHES: Final = 15
"""Matches: least with the reference keyframe for a pose (own)."""
KEYFRAME_RATIO: Final = 0.7
"""Largest ratio of best to second-best distance of such a match (own)."""
LOCAL_WINDOW_PX: Final = 4.0
"""Pixels at the finest level: search radius of a local map point seen obliquely (own). From here on, pixels cover the
errors of keypoints and poses; on a street of twice the size, larger windows gained nothing."""
LOCAL_WINDOW_FRONTAL_PX: Final = 2.5
"""Pixels at the finest level: search radius of a local map point seen from its mean direction (own)."""
POSE_GATE_MEDIANS: Final = 3.0
"""Times the median error, in deviations, of the points that a frame shows: points farther off do not count for its
pose. They stay matched within the outlier gate, which noisy frames need that wide. If the others fit three times as
well, four wrong points of 289 have turned a pose by 0.9 degrees (own; at 2.6 tracks are lost)."""
FRONTAL_COSINE: Final = 0.998
"""Cosine between viewing ray and mean viewing ray above which a point is seen frontally (own)."""
VIEWING_COSINE: Final = 0.5
"""Cosine between viewing ray and mean viewing ray below which a point is not searched: 60 degrees (ORB-SLAM V-D)."""
DISTANCE_MARGIN: Final = 1.2
"""Times: how far a point's distance may leave the range that the pyramid covers (ORB-SLAM V-D; the margin is own)."""
LOCAL_RATIO: Final = 0.8
"""Largest ratio of best to second-best distance, if both lie on one level, of a local map match (own)."""
LOCAL_KEYFRAMES: Final = 80
"""Keyframes: largest local map (own)."""
LOCAL_MIN_INLIERS: Final = 15
"""Points: with fewer in the local map, the frame is lost (own; a street's right-angle turns at 5 Hz leave 20 to 30, and
with 20 one of ten runs is lost there). So few suffice because chance seldom brings a match within the gates of half a
pixel to a pixel and a half."""
RELOCALIZED_MIN_INLIERS: Final = 50
"""Points: the same for a frame that is relocalized (ORB-SLAM V-C)."""
MAX_VELOCITY_GAP: Final = 5.0
"""Times the last frame interval: after a longer gap the motion model is not used (own)."""
SMALL_MAP_KEYFRAMES: Final = 5
"""Keyframes: a map with no more is not merged (own)."""

# Keyframe decision --------------------------------------------------------------------------------------------------
KEYFRAME_NEXT_SHARE: Final = 0.7
"""Share of the reference keyframe's points: if the next frame would see fewer, a keyframe is needed (own). A street
whose turns lose the camera without this rule is tracked whole with 0.6 and with 0.8, too."""
KEYFRAME_MAX_SHARE: Final = 0.9
"""Share of the reference keyframe's points: a frame with more is not welcome as a keyframe (ORB-SLAM V-E)."""
KEYFRAME_BUDGET: Final = 0.25
"""Keyframes per frame: no more if they are welcome but not needed. Mapping a keyframe costs as much as tracking two to
four frames, and so takes at most half of the time (own)."""
KEYFRAME_FULL_SHARE: Final = 2.0 / 15.0
"""Share of a frame's features: a reference keyframe with fewer points counts as one with that many (own)."""

DECODED_WINDOW_PX: Final = 1.5
"""Pixels at the finest level: how far a feature may move when a keyframe's image is coded and decoded (own)."""

# Mapping ------------------------------------------------------------------------------------------------------------
TRIANGULATION_NEIGHBORS: Final = 10
"""Keyframes: covisible ones in which a new keyframe's unmatched features are searched (own)."""
TRIANGULATION_MAX_COSINE: Final = 0.9998
"""Cosine between two rays above which their point is too uncertain: 1.15 degrees (own)."""
TRIANGULATION_OCTAVES_APART: Final = 2
"""Levels: largest difference between two features that match (own)."""
TRIANGULATION_MIN_BASELINE: Final = 0.014
"""Share of the median depth: shorter baselines are not used (own). With 0.01 a camera that turns is lost under coarse
coding; 0.02, at which a point of median depth passes TRIANGULATION_MAX_COSINE, costs the office half a millimeter."""
EPIPOLE_RADIUS_PX: Final = 10.0
"""Pixels at the finest level: no match nearer to the epipole, where depth is undetermined (own)."""
SCALE_CONSISTENCY: Final = 1.5
"""Times the level factor: how far the ratio of distances may leave the ratio of feature scales (own)."""
POINT_MIN_FOUND_SHARE: Final = 0.25
"""Share of the frames in which a new point should be visible: it must be matched in so many (ORB-SLAM VI-B)."""
POINT_MIN_OBSERVATIONS: Final = 3
"""Keyframes that must see a new point once POINT_TRIAL_KEYFRAMES have passed (ORB-SLAM VI-B). The point counts among a
reference keyframe's points from then on (own)."""
POINT_TRIAL_KEYFRAMES: Final = 2
"""Keyframes: see POINT_MIN_OBSERVATIONS (ORB-SLAM VI-B)."""
POINT_PROBATION_KEYFRAMES: Final = 3
"""Keyframes: age at which a point is no longer on probation (ORB-SLAM VI-B)."""
DESCRIPTORS_COMPARED: Final = 12
"""Descriptors: a point's representative is chosen among at most so many, the newest (own; bounds the time)."""
FUSE_WINDOW_PX: Final = 3.0
"""Pixels at the finest level: search radius for duplicates of a point (own)."""
REDUNDANT_SHARE: Final = 0.9
"""Share of a keyframe's points: with more seen by three others at the same or a finer scale, it is redundant (VI-E)."""
REDUNDANT_OBSERVATIONS: Final = 3
"""Keyframes: see REDUNDANT_SHARE (ORB-SLAM VI-E)."""
COVISIBLE_MIN_POINTS: Final = 15
"""Points: least shared by neighbors in the covisibility graph (ORB-SLAM III-D)."""
LOCAL_BUNDLE_KEYFRAMES: Final = 10
"""Keyframes: most free ones in a local bundle adjustment (own; bounds the time)."""
LOCAL_BUNDLE_FIXED: Final = 30
"""Keyframes: most fixed ones in a local bundle adjustment, those that see most of its points (own)."""
LOCAL_BUNDLE_TOLERANCE: Final = 1e-3
"""Share of the cost: a round of a local adjustment ends with a step that gains less (own)."""
MAP_HUBER_SIGMAS: Final = 0.6
"""Standard deviations: larger errors are weighted down when a whole map is adjusted. It is 1.345 times (Huber 1981) the
spread of the residuals, which is 0.35 to 0.5 of the deviations that make the gates (own)."""

# Place recognition ----------------------------------------------------------------------------------------------------
SHARED_WORDS_SHARE: Final = 0.8
"""Share of the most words that any keyframe shares with an image: a keyframe with no more is not scored (own)."""
GROUP_SCORE_SHARE: Final = 0.75
"""Share of the best group's score: a group with no more gives no candidate (ORB-SLAM VI-C)."""
GROUP_NEIGHBORS: Final = 10
"""Keyframes: best covisible ones whose scores are added to a keyframe's (own)."""

# Relocalization and loops ---------------------------------------------------------------------------------------------
RELOCALIZATION_CANDIDATES: Final = 8
"""Keyframes: tried for a lost frame, in all maps together (own; bounds the time)."""
RELOCALIZATION_RATIO: Final = 0.75
"""Largest ratio of best to second-best distance of a match with a candidate (own)."""
RELOCALIZATION_WIDENING: Final = 3.0
"""Times the windows of the local map: search for a candidate's points after the first pose (own)."""
RELOCALIZATION_ITERATIONS: Final = 300
"""RANSAC samples for the pose of a lost frame (own)."""
PNP_ERROR_PX: Final = 4.0
"""Pixels at the finest level: inliers of that pose (own)."""
LOOP_CONSISTENT_KEYFRAMES: Final = 3
"""Keyframes in a row whose candidates must be consistent, in their own map or in another (ORB-SLAM VII-A)."""
LOOP_MIN_GAP_KEYFRAMES: Final = 10
"""Keyframes: no loop is closed sooner after another one (own)."""
LOOP_MIN_MATCHES: Final = 20
"""Matches: least with a candidate for a similarity to be estimated (ORB-SLAM VII-B)."""
LOOP_MIN_INLIERS: Final = 10
"""Matches: inliers that a similarity needs (own; ORB-SLAM VII-B asks for enough of them)."""
LOOP_WINDOW_PX: Final = 7.5
"""Pixels at the finest level: search radius for points projected by a similarity (own)."""
LOOP_RATIO: Final = 0.75
"""Largest ratio of best to second-best distance of a match with a candidate (own)."""
LOOP_MIN_PROJECTED: Final = 40
"""Matches: least by projection of the loop side's points for the loop to be accepted (own)."""
LOOP_MIN_PROJECTED_SHARE: Final = 0.1
"""Share of the loop side's points in view: least that must match; with fewer, it is another place with some equal
objects (own; true loops match 0.12 to 0.45, two equal houses 0.08)."""
LOOP_RANSAC_ITERATIONS: Final = 300
"""RANSAC samples of three matches (own)."""
ESSENTIAL_MIN_WEIGHT: Final = 100
"""Points: shared by keyframes that an essential-graph edge joins (ORB-SLAM III-D)."""
