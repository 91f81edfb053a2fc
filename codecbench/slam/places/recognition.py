"""Which keyframes of a map look alike: words, bags of words and the index over them."""

from __future__ import annotations

from collections.abc import Sequence

from codecbench.slam.features.extractor import Features
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.places.keyframe_database import KeyframeDatabase
from codecbench.slam.places.vocabulary import Vocabulary


class PlaceRecognition:
    """The appearance of a map's keyframes."""

    def __init__(self, slam_map: Map) -> None:
        self.map = slam_map
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

    def append(self, other: PlaceRecognition, numbers: Indices) -> None:
        """Index the keyframes of another map too; `numbers` (K,) says what they are called here."""
        for keyframe, nodes in other._nodes.items():
            number = int(numbers[keyframe])
            self._nodes[number] = nodes
            self._database.add(number, other._database.bow(keyframe))

    def nodes(self, keyframe: int) -> Indices:
        """Vocabulary nodes (N,) of the keyframe's features: only features under one node can match."""
        return self._nodes[keyframe]

    def loop_candidates(self, keyframe: int, there: PlaceRecognition) -> list[int]:
        """Keyframes of the map `there`, which may be this one, that look like `keyframe` of this map though they share
        no points with it, best first.

        A candidate must score no less than the least similar neighbour of `keyframe` (ORB-SLAM VII-A).
        """
        bag = self._database.bow(keyframe)
        keyframes, scores, _ = self._database.query(bag)
        score_of = dict(zip(keyframes.tolist(), scores.tolist(), strict=True))
        min_score = min((score_of.get(k, 0.0) for k in self._neighbors(keyframe)), default=1.0)
        connected = [keyframe, *self.map.neighbors(keyframe, min_points=1)[0].tolist()] if there is self else []
        return there._database.loop_candidates(bag, there._neighbors, connected, min_score)

    def _neighbors(self, keyframe: int) -> list[int]:
        return [int(k) for k in self.map.neighbors(keyframe)[0]]


def relocalization_candidates(features: Features, places: Sequence[PlaceRecognition]) -> list[tuple[int, int]]:
    """Which keyframes of several maps look like a frame, best first: index into `places` and keyframe of each; of
    equals that of the map listed first."""
    vocabulary = Vocabulary.load_default()
    bag = vocabulary.bow(vocabulary.words(features.descriptors).words)
    found = [
        (score, which, keyframe)
        for which, there in enumerate(places)
        for keyframe, score in there._database.relocalization_candidates(bag, there._neighbors)
    ]
    return [(which, keyframe) for _, which, keyframe in sorted(found, key=lambda candidate: -candidate[0])]
