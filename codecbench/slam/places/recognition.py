"""Which keyframes of a map look alike: words, bags of words and the index over them."""

from __future__ import annotations

from codecbench.slam.features.extractor import Features
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.places.keyframe_database import KeyframeDatabase
from codecbench.slam.places.vocabulary import BowVector, Vocabulary


class PlaceRecognition:
    """The appearance of a map's keyframes."""

    def __init__(self, slam_map: Map) -> None:
        self._map = slam_map
        self._vocabulary = Vocabulary.load_default()
        self._database = KeyframeDatabase(len(self._vocabulary))
        self._nodes: dict[int, Indices] = {}

    def add(self, keyframe: int, features: Features) -> None:
        """Index a keyframe."""
        words = self._vocabulary.words(features.descriptors)
        self._nodes[keyframe] = words.nodes
        self._database.add(keyframe, self._vocabulary.bow(words.words))

    def remove(self, keyframe: int) -> None:
        """Forget a keyframe."""
        self._database.erase(keyframe)
        del self._nodes[keyframe]

    def nodes(self, keyframe: int) -> Indices:
        """Vocabulary nodes (N,) of the keyframe's features: only features under one node can match."""
        return self._nodes[keyframe]

    def relocalization_candidates(self, features: Features) -> list[int]:
        """Keyframes that look like a frame, best first."""
        return self._database.relocalization_candidates(self._bag(features), self._neighbors)

    def loop_candidates(self, keyframe: int) -> list[int]:
        """Keyframes that look like `keyframe` though they share no points with it, best first.

        A candidate must score no less than the least similar neighbour of `keyframe` (ORB-SLAM VII-A).
        """
        bag = self._database.bow(keyframe)
        keyframes, scores, _ = self._database.query(bag)
        score_of = dict(zip(keyframes.tolist(), scores.tolist(), strict=True))
        connected = self._map.neighbors(keyframe, min_points=1)[0].tolist()
        min_score = min((score_of.get(k, 0.0) for k in self._neighbors(keyframe)), default=1.0)
        return self._database.loop_candidates(bag, self._neighbors, [keyframe, *connected], min_score)

    def _bag(self, features: Features) -> BowVector:
        return self._vocabulary.bow(self._vocabulary.words(features.descriptors).words)

    def _neighbors(self, keyframe: int) -> list[int]:
        return [int(k) for k in self._map.neighbors(keyframe)[0]]
