"""Moving shutters and sensors against pictures of still ones, and against formulas."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.synthetic.paths import looking_pose
from codecbench.plugins.datasets.synthetic.render import LANE, Renderer
from codecbench.plugins.datasets.synthetic.scene import box, make_atlas, upright
from codecbench.plugins.datasets.synthetic.textures import photograph
from codecbench.plugins.datasets.synthetic.worlds import exposure
from codecbench.plugins.datasets.synthetic.worlds.exposure import (
    MOST_SAMPLES,
    SAMPLE_WEIGHT,
    Exposure,
    offsets_px,
    samples_for,
)
from codecbench.plugins.datasets.synthetic.worlds.sensor import CORNER_LOSS, READ_NOISE_ELECTRONS, Sensor

CAMERA = Camera(320, 240, 262.0, 258.0, 158.5, 121.0)


@pytest.fixture(scope="module")
def scene():
    wall = upright((0.0, 2.0, 0.0), -90.0, 8.0, 6.0, photograph("coffee"))
    crates = box((0.2, 1.0, -0.5), (0.4, 0.4, 0.7), lambda *_: photograph("astronaut"), 25.0)
    return make_atlas([wall, *crates])


def moving(time_s):
    """A camera that turns by 57 degrees and moves by half a metre a second."""
    position = np.array([0.5 * time_s, -0.2, 0.1 * time_s])
    return looking_pose(position, np.array([0.0, 1.0, 0.0]), np.array([0.3, 0.9, 0.2]) * time_s)


def levels(total, samples):
    """Gray levels (H, W, 3) of a packed sum."""
    lanes = [(total >> np.uint64(21 * k)) & LANE for k in range(3)]
    return np.stack(lanes, axis=2).astype(float) / (SAMPLE_WEIGHT * samples)


def test_a_still_picture_is_that_of_the_other_renderer(scene):
    ours = levels(Exposure(scene, CAMERA).total(moving, 0.0, 0.0, 0.0, 4), 4)
    theirs = Renderer(scene, CAMERA).mean_of_samples(np.array([moving(0.0)] * 4), offsets_px(4))
    assert np.abs(ours - theirs).mean() < 1.0
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.998


def test_each_row_of_a_rolling_shutter_is_that_of_a_still_camera_at_its_time(scene):
    exposure, readout_s = Exposure(scene, CAMERA), 0.05
    rolled = levels(exposure.total(moving, 0.3, 0.0, readout_s, 2), 2)
    global_ = levels(exposure.total(moving, 0.3, 0.0, 0.0, 2), 2)
    for row in (2, 57, 122, 190, 237):
        time_s = 0.3 + ((row + 0.5) / CAMERA.height - 0.5) * readout_s
        still = levels(exposure.total(moving, time_s, 0.0, 0.0, 2), 2)[row]
        assert np.abs(rolled[row] - still).mean() < 1.0
        if abs(row - CAMERA.height / 2) > 50:
            assert np.abs(rolled[row] - global_[row]).mean() > 5.0


def test_the_frame_s_time_is_the_middle_of_the_exposure(scene):
    exposure = Exposure(scene, CAMERA)
    blurred = levels(exposure.total(moving, 0.0, 0.03, 0.0, 16), 16)
    shares = (np.arange(32) + 0.5) / 32 - 0.5

    def difference(shift_s):
        """From the mean of many still pictures over an exposure that lies elsewhere in time."""
        stills = [levels(exposure.total(moving, shift_s + share * 0.03, 0.0, 0.0, 2), 2) for share in shares]
        return np.abs(blurred - np.mean(stills, axis=0)).mean()

    assert difference(0.0) < 2.0
    assert min(difference(-0.003), difference(0.003)) > 1.5 * difference(0.0)


def test_a_picture_does_not_depend_on_how_many_rows_are_made_at_a_time(scene, monkeypatch):
    totals = []
    for rows in (CAMERA.height, exposure.CACHED_ROWS, 7):
        monkeypatch.setattr(exposure, "CACHED_ROWS", rows)
        totals.append(Exposure(scene, CAMERA).total(moving, 0.2, 0.03, 0.0, 5))
    np.testing.assert_array_equal(totals[0], totals[1])
    np.testing.assert_array_equal(totals[0], totals[2])


def test_sub_frames_grow_with_the_blur_and_their_offsets_are_balanced():
    counts = [samples_for(moving, 0.0, open_s, 262.0, 2.0) for open_s in (0.0, 0.01, 0.03, 0.06, 0.2)]
    assert counts == sorted(counts)
    assert counts[0] == 2
    assert counts[-1] == MOST_SAMPLES
    for samples in range(2, MOST_SAMPLES + 1):
        offsets = offsets_px(samples)
        np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=1e-12)
        for axis in range(2):
            np.testing.assert_allclose(np.diff(np.sort(offsets[:, axis])), 1 / samples)


# The sensor


def flat(value, height=201, width=301):
    """The packed sum of one sample of an evenly gray picture."""
    word = sum(int(value * SAMPLE_WEIGHT) << (21 * k) for k in range(3))
    return np.full((height, width), word, np.uint64)


MIDDLE = (slice(90, 110), slice(135, 165))


@pytest.mark.parametrize("electrons", [100.0, 2000.0])
def test_noise_is_that_of_electrons_and_reading_out(electrons):
    image = Sensor(electrons, 1.0, 0.0).expose(flat(128), 1, 1.0, 7)[MIDDLE].astype(float)
    light = (128 / 255) ** 2
    expected = np.sqrt(light * electrons + READ_NOISE_ELECTRONS**2) / electrons
    assert ((image / 255) ** 2).std() == pytest.approx(expected, rel=0.06)
    assert ((image / 255) ** 2).mean() == pytest.approx(light, rel=0.05)


def test_brightness_and_gain_scale_the_light_up_to_white():
    def middle(brightness, gain, value=200):
        return Sensor(1e9, brightness, 0.5).expose(flat(value), 1, gain, 1)[MIDDLE].astype(float).mean()

    assert middle(1.0, 1.0) == pytest.approx(200, abs=1)
    assert middle(0.25, 1.0) == pytest.approx(100, abs=1)
    assert middle(1.0, 0.25) == pytest.approx(100, abs=1)
    assert middle(1.0, 4.0) == 255


def test_corners_lose_light():
    image = Sensor(1e9, 1.0, 0.0).expose(flat(250), 1, 1.0, 1)
    assert (image[0, 0, 1] / 250) ** 2 == pytest.approx(1 - CORNER_LOSS, abs=0.01)
    assert image[100, 150, 1] == pytest.approx(250, abs=1)


@pytest.mark.parametrize("blur_px", [0.4, 0.8])
def test_the_lens_spreads_a_point_as_far_as_it_says(blur_px):
    total = flat(0)
    total[100, 150] = flat(255)[0, 0]
    picture = Sensor(1e9, 1.0, blur_px).expose(total, 1, 1.0, 1).astype(float)[95:106, 145:156]
    for channel in range(3):
        light = (picture[:, :, channel] / 255) ** 2
        rows, columns = np.indices(light.shape) - 5
        for axis in (rows, columns):
            assert (light * axis).sum() / light.sum() == pytest.approx(0.0, abs=0.01)
            assert (light * axis**2).sum() / light.sum() == pytest.approx(blur_px**2, rel=0.05)


def test_keys_choose_the_noise_and_nothing_else():
    sensor = Sensor(500.0, 1.0, 0.6)
    first, again, other = (sensor.expose(flat(120), 1, 1.0, key) for key in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    correlation = np.corrcoef(first[MIDDLE].ravel().astype(float), other[MIDDLE].ravel().astype(float))[0, 1]
    assert abs(correlation) < 0.1
