"""Features that the orb backend is given in the place of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from feature_streams import PICTURES

from codecbench import Camera, Features, SlamError, Unsupported
from codecbench.core.contracts.features import FeatureFrame
from codecbench.plugins.codecs.orb_features.codec import OrbFeatures
from codecbench.plugins.slam_backends.keypoints import features_of, keypoints_of
from codecbench.plugins.slam_backends.orb import Orb

CAMERA = Camera(160, 120, 130.0, 130.0, 80.0, 60.0)


def found() -> Features:
    return OrbFeatures.create().extract(PICTURES[0])


def test_features_and_keypoints_hold_the_same() -> None:
    features = found()
    assert len(features) > 50
    keypoints = keypoints_of(features)
    assert keypoints.descriptors.shape == (len(features), 4)
    assert keypoints.descriptors.dtype == np.uint64
    assert np.shares_memory(keypoints.descriptors, features.descriptors)
    back = features_of(keypoints)
    for name in ("size", "pixels", "octaves", "angles", "descriptors"):
        assert np.array_equal(getattr(back, name), getattr(features, name))
    assert np.isnan(back.responses).all()
    assert len(keypoints_of(Features.none((9, 7)))) == len(features_of(keypoints_of(Features.none((9, 7))))) == 0


def test_more_features_or_levels_than_the_backend_allows_are_unsupported() -> None:
    features = found()
    frame = FeatureFrame(4, 0.5, features)
    with pytest.raises(Unsupported, match=rf"got {len(features)} features .*backend_params allow 100 of 8"):
        Orb.create(features=100).run_features([frame], CAMERA, seed=0)
    high = replace(features, octaves=np.full(len(features), 8, np.int32))
    with pytest.raises(Unsupported, match=r"of 9 levels; .* 1000 of 8"):
        Orb.create().run_features([replace(frame, features=high)], CAMERA, seed=0)
    with pytest.raises(SlamError, match="got no frame"):
        Orb.create().run_features([], CAMERA, seed=0)


def test_frames_keep_their_index_and_another_size_is_refused() -> None:
    features = found()
    run = Orb.create().run_features(
        [FeatureFrame(4, 0.5, features), FeatureFrame(6, 0.7, replace(features, size=(200, 150)))], CAMERA, seed=0
    )
    assert [(frame.index, frame.state) for frame in run.frames] == [(4, "not_initialized"), (6, "refused")]
