"""Place recognition: an inverted index from visual words to keyframes, and candidates for loops and relocalization."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.map import Map
from codecbench.slam.places.vocabulary import BowVector, Indices, Vocabulary

_NONE = -1


class KeyframeDatabase:
    """An inverted index: for each word, the keyframes that have it and its value there.

    Sources: Galvez-Lopez and Tardos, T-RO 28(5), 2012 (index and score); ORB-SLAM, T-RO 31(5), 2015, sections III-C,
    VI-C, VII-A (candidates, grouped by covisibility).
    """

    def __init__(self, word_count: int) -> None:
        """Make an empty index for a vocabulary of `word_count` words."""
        self._heads = np.full(word_count, _NONE, dtype=np.int64)
        self._next = np.empty(0, dtype=np.int64)  # the next posting of the same word
        self._keyframes = np.empty(0, dtype=np.int64)
        self._values = np.empty(0)
        self._free = np.array([_NONE], dtype=np.int64)  # first unused posting; they are chained through _next
        self._bows: dict[int, BowVector] = {}

    def __len__(self) -> int:
        return len(self._bows)

    def __contains__(self, keyframe: int) -> bool:
        return keyframe in self._bows

    def add(self, keyframe: int, bow: BowVector) -> None:
        """Index a keyframe, a number of at least 0, under its words; raises ValueError if it is indexed already."""
        if keyframe in self._bows or keyframe < 0:
            raise ValueError(f"KeyframeDatabase.add: keyframe {keyframe} is negative or indexed already")
        self._check(bow)
        if not self._insert(keyframe, bow):
            self._grow(len(bow.words))
            self._insert(keyframe, bow)
        self._bows[keyframe] = bow

    def erase(self, keyframe: int) -> None:
        """Remove a keyframe; raises KeyError if it is not indexed."""
        bow = self._bows.pop(keyframe)
        _remove(bow.words, keyframe, self._heads, self._next, self._keyframes, self._free)

    def bow(self, keyframe: int) -> BowVector:
        """Return the bag of words of an indexed keyframe."""
        return self._bows[keyframe]

    def query(self, bow: BowVector) -> tuple[Indices, Array, Indices]:
        """Return keyframes (n,) that share a word with an image, ascending, their scores and shared words (n,)."""
        self._check(bow)
        size = max(self._bows, default=-1) + 1
        scores, shared = np.zeros(size), np.zeros(size, dtype=np.int64)
        _accumulate(bow.words, bow.values, self._heads, self._next, self._keyframes, self._values, scores, shared)
        keyframes = np.flatnonzero(shared)
        return keyframes, scores[keyframes], shared[keyframes]

    def loop_candidates(
        self,
        bow: BowVector,
        neighbors: Callable[[int], Sequence[int]],
        excluded: Collection[int],
        min_score: float,
    ) -> list[int]:
        """Return keyframes that may show the same place, best group first.

        `neighbors` returns the covisible keyframes of one, best first; `excluded` are those that the current keyframe
        sees anyway (itself and its neighbors); `min_score` is the lowest score between it and them. A candidate must
        reach `min_score`. Scores are added up over groups of covisible keyframes, and each group that comes near the
        best one gives its best keyframe.
        """
        return [keyframe for keyframe, _ in self._candidates(bow, neighbors, excluded, min_score)]

    def relocalization_candidates(
        self, bow: BowVector, neighbors: Callable[[int], Sequence[int]]
    ) -> list[tuple[int, float]]:
        """Return keyframes that may relocalize a lost frame, and the scores of their groups, best first.

        See `loop_candidates`.
        """
        return self._candidates(bow, neighbors, (), 0.0)

    def _candidates(
        self, bow: BowVector, neighbors: Callable[[int], Sequence[int]], excluded: Collection[int], min_score: float
    ) -> list[tuple[int, float]]:
        keyframes, scores, shared = self.query(bow)
        allowed = ~np.isin(keyframes, np.fromiter(excluded, dtype=np.int64, count=len(excluded)))
        keyframes, scores, shared = keyframes[allowed], scores[allowed], shared[allowed]
        if not len(keyframes):
            return []
        similar = (shared > thresholds.SHARED_WORDS_SHARE * shared.max()) & (scores >= min_score)
        score_of = dict(zip(keyframes[similar].tolist(), scores[similar].tolist(), strict=True))
        groups = []
        for keyframe, score in score_of.items():
            group = [keyframe, *(k for k in list(neighbors(keyframe))[: thresholds.GROUP_NEIGHBORS] if k in score_of)]
            total = sum(score_of[k] for k in group)
            groups.append((total, max(group, key=lambda k: (score_of[k], -k)), score))
        limit = thresholds.GROUP_SCORE_SHARE * max((group[0] for group in groups), default=0.0)
        ranked = sorted((g for g in groups if g[0] > limit), key=lambda g: (-g[0], g[1]))
        best_total: dict[int, float] = {}
        for total, keyframe, _ in ranked:
            best_total.setdefault(keyframe, total)
        return list(best_total.items())

    def _check(self, bow: BowVector) -> None:
        if len(bow.words) and (bow.words[0] < 0 or bow.words[-1] >= len(self._heads)):
            raise ValueError(
                f"KeyframeDatabase: words span {bow.words[0]}..{bow.words[-1]}; allowed 0..{len(self._heads) - 1}: "
                "use a bag of the database's vocabulary"
            )

    def _insert(self, keyframe: int, bow: BowVector) -> bool:
        arrays = self._heads, self._next, self._keyframes, self._values, self._free
        return bool(_insert(bow.words, bow.values, keyframe, *arrays))

    def _grow(self, needed: int) -> None:
        """Chain at least `needed` new postings before the free ones."""
        old = len(self._next)
        size = old + max(needed, old, 1024)
        self._next = np.append(self._next, np.arange(old + 1, size + 1))
        self._next[-1] = self._free[0]
        self._free[0] = old
        self._keyframes = np.append(self._keyframes, np.full(size - old, _NONE, dtype=np.int64))
        self._values = np.append(self._values, np.zeros(size - old))


@compiled
def _insert(words, values, keyframe, heads, following, keyframes, posting_values, free):  # type: ignore[no-untyped-def]
    """Link one posting a word; return False, with nothing changed, if there are too few free ones."""
    available, posting = 0, free[0]
    while posting >= 0 and available < words.shape[0]:
        posting = following[posting]
        available += 1
    if available < words.shape[0]:
        return False
    for i in range(words.shape[0]):
        posting = free[0]
        free[0] = following[posting]
        following[posting] = heads[words[i]]
        heads[words[i]] = posting
        keyframes[posting] = keyframe
        posting_values[posting] = values[i]
    return True


@compiled
def _remove(words, keyframe, heads, following, keyframes, free):  # type: ignore[no-untyped-def]
    for i in range(words.shape[0]):
        previous, posting = -1, heads[words[i]]
        while keyframes[posting] != keyframe:
            previous, posting = posting, following[posting]
        if previous < 0:
            heads[words[i]] = following[posting]
        else:
            following[previous] = following[posting]
        following[posting] = free[0]
        free[0] = posting


@compiled
def _accumulate(words, values, heads, following, keyframes, posting_values, scores, shared):  # type: ignore[no-untyped-def]
    """Add up min(v, w) over the words in common: the L1 score of two vectors that sum to 1."""
    for i in range(words.shape[0]):
        posting = heads[words[i]]
        while posting >= 0:
            scores[keyframes[posting]] += min(values[i], posting_values[posting])
            shared[keyframes[posting]] += 1
            posting = following[posting]


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
        """Remove a keyframe from the index."""
        self._database.erase(keyframe)
        del self._nodes[keyframe]

    def append(self, other: PlaceRecognition, numbers: Indices) -> None:
        """Index the keyframes of another map too; `numbers` (K,) are their indices here."""
        for keyframe, nodes in other._nodes.items():
            number = int(numbers[keyframe])
            self._nodes[number] = nodes
            self._database.add(number, other._database.bow(keyframe))

    def nodes(self, keyframe: int) -> Indices:
        """Return the vocabulary nodes (N,) of a keyframe's features: only features under one node can match."""
        return self._nodes[keyframe]

    def loop_candidates(self, keyframe: int, there: PlaceRecognition) -> list[int]:
        """Return keyframes of the map `there` that look like `keyframe` of this map, best first.

        `there` may be this map; candidates then share no points with `keyframe`. A candidate must score no less than
        the least similar neighbor of `keyframe` (ORB-SLAM VII-A).
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
    """Return the keyframes of several maps that look like a frame, best first: index into `places` and keyframe.

    Of equals, that of the map listed first comes first.
    """
    vocabulary = Vocabulary.load_default()
    bag = vocabulary.bow(vocabulary.words(features.descriptors).words)
    candidates = [
        (score, place, keyframe)
        for place, there in enumerate(places)
        for keyframe, score in there._database.relocalization_candidates(bag, there._neighbors)
    ]
    return [(place, keyframe) for _, place, keyframe in sorted(candidates, key=lambda candidate: -candidate[0])]
