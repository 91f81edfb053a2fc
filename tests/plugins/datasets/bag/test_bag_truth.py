"""True paths from every kind of pose message, and from transforms, against matrices written down here."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bag_files import FORMATS, BagWriter, picture, time_ns
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.dataset import Bag

COUNT = 5


def numbers_of(poses):
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1).tolist()


def random_poses(count, seed):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


POSES = random_poses(COUNT, 1)
NUMBERS = numbers_of(POSES)
BASE_FROM_CAMERA = random_poses(2, 2)
"""base from mast, and mast from camera."""


def stamped(bag, kind, number):
    header, pose = bag.header(time_ns(number), "world"), bag.pose(NUMBERS[number])
    if kind == "PoseStamped":
        return bag.make("geometry_msgs/PoseStamped", header=header, pose=pose)
    if kind == "TransformStamped":
        return bag.transform(NUMBERS[number], "world", "base", time_ns(number))
    uncertain = bag.make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
    if kind == "PoseWithCovarianceStamped":
        return bag.make("geometry_msgs/PoseWithCovarianceStamped", header=header, pose=uncertain)
    none = bag.make("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
    twist = bag.make("geometry_msgs/Twist", linear=none, angular=none)
    still = bag.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
    return bag.make("nav_msgs/Odometry", header=header, child_frame_id="base", pose=uncertain, twist=still)


def write(path, kind="bag", poses=(), mounted=False, moving=()):
    """A picture, poses by topic, static transforms from base over mast to camera, and what is added by `moving`."""
    with BagWriter(path, kind) as bag:
        bag.write("/image", bag.image(picture(0), "rgb8", time_ns(0)), time_ns(0))
        for topic, type_ in poses:
            for number in range(COUNT):
                bag.write(topic, stamped(bag, type_, number), time_ns(number) + 7)
        if mounted:
            mast, camera = numbers_of(BASE_FROM_CAMERA)
            fixed = (bag.transform(mast, "base", "mast", 1), bag.transform(camera, "/mast", "/camera", 1))
            bag.write("/tf_static", bag.transforms(*fixed), time_ns(0))
        for number, parent, child, values in moving:
            bag.write("/tf", bag.transforms(bag.transform(values, parent, child, time_ns(number))), time_ns(number))
    return path


def check(trajectory, poses, tolerance=1e-12):
    np.testing.assert_allclose(trajectory.timestamps_s, [time_ns(number) / 1e9 for number in range(len(poses))])
    np.testing.assert_allclose(trajectory.world_from_camera, poses, rtol=0, atol=tolerance)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("type_", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry"])
def test_the_only_topic_of_poses_is_the_truth(tmp_path, kind, type_):
    path = write(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, [("/pose", type_)])
    sequence = Bag.create(path=path).open()
    check(sequence.ground_truth, POSES)
    (said,) = [note for note in sequence.notes if re.match(r"ground truth: 5 .* /pose ", note)]
    assert re.findall("`(.*?)`", said) == ["ground_truth: none"]
    assert any("no static transform" in note for note in sequence.notes)
    assert Bag.create(path=path, ground_truth="none").open().ground_truth is None


@pytest.mark.parametrize(("type_", "child"), [("Odometry", None), ("TransformStamped", None), ("PoseStamped", "base")])
def test_static_transforms_lead_from_the_body_to_the_camera(tmp_path, type_, child):
    path = write(tmp_path / "a.bag", poses=[("/pose", type_)], mounted=True)
    sequence = Bag.create(path=path, child_frame=child).open()
    check(sequence.ground_truth, POSES @ BASE_FROM_CAMERA[0] @ BASE_FROM_CAMERA[1])
    assert any("'base' to 'camera'" in note for note in sequence.notes)


def test_several_pose_topics_give_no_ground_truth_until_one_is_chosen(tmp_path):
    path = write(tmp_path / "a.bag", poses=[("/mocap", "PoseStamped"), ("/odom", "Odometry")])
    sequence = Bag.create(path=path).open()
    assert sequence.ground_truth is None
    assert any(re.search(r"`ground_truth: TOPIC` .*/mocap, /odom$", note) for note in sequence.notes)
    check(Bag.create(path=path, ground_truth="/mocap").open().ground_truth, POSES)
    with pytest.raises(DatasetError, match=r"'/x' .*: /mocap, /odom"):
        Bag.create(path=path, ground_truth="/x").open()
    with pytest.raises(DatasetError, match=r"'/image' .*1 .*sensor_msgs/msg/Image"):
        Bag.create(path=path, ground_truth="/image").open()


@pytest.mark.parametrize("kind", FORMATS)
def test_transforms_are_composed_from_the_world_to_the_camera(tmp_path, kind):
    moving = [(number, "world", "base", NUMBERS[number]) for number in range(COUNT)]
    path = write(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, mounted=True, moving=moving)
    assert Bag.create(path=path).open().ground_truth is None
    expected = POSES @ BASE_FROM_CAMERA[0] @ BASE_FROM_CAMERA[1]
    sequence = Bag.create(path=path, ground_truth="/tf").open()
    check(sequence.ground_truth, expected)
    assert any(re.match("ground truth: 5 .*'world'.* 'camera' .*/tf$", note) for note in sequence.notes)
    mast = Bag.create(path=path, ground_truth="/tf", child_frame="mast").open().ground_truth
    check(mast, expected)  # of the mast, moved to the camera
    check(Bag.create(path=path, ground_truth="/tf", parent_frame="world").open().ground_truth, expected)


def test_transforms_at_other_times_are_interpolated(tmp_path):
    """map -> odom turns about z by 10 degrees and moves by 1 m a frame, told at frames 0 and 4 only."""
    turned = [0.0, 0.0, np.sin(np.radians(20)), np.cos(np.radians(20))]
    moving = [(0, "map", "odom", [0.0, 0, 0, 0, 0, 0, 1]), (4, "map", "odom", [4.0, 0, 0, *turned])]
    moving += [(number, "odom", "camera", NUMBERS[number]) for number in range(COUNT)]
    path = write(tmp_path / "a.bag", moving=sorted(moving, key=lambda part: part[0]))
    expected = []
    for number in range(COUNT):
        odom = np.eye(4)
        odom[:3, :3] = Rotation.from_euler("z", 10 * number, degrees=True).as_matrix()
        odom[0, 3] = number
        expected.append(odom @ POSES[number])
    interpolated = Bag.create(path=path, ground_truth="/tf").open().ground_truth
    check(interpolated, np.array(expected), tolerance=1e-5)  # at 25 m/s, times are exact to 0.2 us


@pytest.mark.parametrize(
    ("values", "frames"),
    [({"child_frame": "wheel"}, "'wheel' and 'wheel'"), ({"parent_frame": "moon"}, "'moon' to 'camera'")],
)
def test_frames_that_are_not_connected(tmp_path, values, frames):
    path = write(tmp_path / "a.bag", moving=[(0, "world", "camera", NUMBERS[0])])
    with pytest.raises(DatasetError, match=f"{frames}; .*`parent_frame` .*`child_frame`.* world -> camera"):
        Bag.create(path=path, ground_truth="/tf", **values).open()


def test_frames_in_a_circle_and_with_two_parents_are_refused(tmp_path):
    circle = [(0, "a", "camera", NUMBERS[0]), (0, "camera", "a", NUMBERS[0])]
    with pytest.raises(DatasetError, match="None to 'camera'"):
        Bag.create(path=write(tmp_path / "a.bag", moving=circle), ground_truth="/tf").open()
    parents = [(0, "a", "camera", NUMBERS[0]), (1, "b", "camera", NUMBERS[0])]
    with pytest.raises(DatasetError, match=r"'camera' .*'a' .*'b'"):
        Bag.create(path=write(tmp_path / "b.bag", moving=parents), ground_truth="/tf").open()


@pytest.mark.parametrize(
    ("numbers", "words"),
    [([0.0, 0, 0, 0, 0, 0, 0], "length 0"), ([np.nan, 0, 0, 0, 0, 0, 1], "not finite")],
)
def test_poses_that_are_none_are_errors_of_their_message(tmp_path, numbers, words):
    path = tmp_path / "a.bag"
    with BagWriter(path, "bag") as bag:
        bag.write("/image", bag.image(picture(0), "rgb8", time_ns(0)), time_ns(0))
        for number, values in enumerate(([0.0, 0, 0, 0, 0, 0, 1], numbers)):
            header = bag.header(time_ns(number), "world")
            bag.write("/pose", bag.make("geometry_msgs/PoseStamped", header=header, pose=bag.pose(values)), number + 1)
    with pytest.raises(DatasetError) as caught:
        Bag.create(path=path).open()
    assert "/pose[1]" in str(caught.value)
    assert words in str(caught.value)


def fix(bag, number, latitude, longitude, altitude, status=0):
    return bag.make(
        "sensor_msgs/NavSatFix", header=bag.header(time_ns(number)), latitude=latitude, longitude=longitude,
        altitude=altitude, status=bag.make("sensor_msgs/NavSatStatus", status=status, service=1),
        position_covariance=np.zeros(9), position_covariance_type=0,
    )  # fmt: skip


@pytest.mark.parametrize("kind", FORMATS)
def test_fixes_become_meters_east_north_and_up_without_rotations(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    places = [(45.0, 7.0, 200.0), (45.0001, 7.0, 200.0), (45.0, 7.0001, 203.0), (0.0, 0.0, 0.0), (np.nan, 7.0, 0.0)]
    with BagWriter(path, kind) as bag:
        bag.write("/image", bag.image(picture(0), "rgb8", time_ns(0)), time_ns(0))
        for number, place in enumerate(places):
            bag.write("/fix", fix(bag, number, *place, status=-1 if number == 3 else 0), time_ns(number) + 7)
    assert Bag.create(path=path).open().ground_truth is None  # only if asked for: its errors are meters
    sequence = Bag.create(path=path, ground_truth="/fix").open()
    # WGS 84 has radii of 6367382 m (meridian) and 6388838 m (prime vertical) at 45 degrees.
    angle = np.radians(1e-4)
    expected = [[0, 0, 0], [0, 6367582 * angle, 0], [6389041 * np.cos(np.pi / 4) * angle, 0, 3]]
    np.testing.assert_allclose(sequence.ground_truth.positions_world, expected, atol=1e-4)
    assert not sequence.ground_truth.has_rotations
    assert "3 positions of /fix" in " ".join(sequence.notes)
