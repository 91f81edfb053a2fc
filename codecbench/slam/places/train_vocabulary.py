"""Train the vocabulary that comes with the package: `python -m codecbench.slam.places.train_vocabulary [OUTPUT.npz]`.

Training set: 20 photographs that scikit-image and matplotlib distribute under permissive terms (`PHOTOGRAPHS`), none of
them from a sequence that the benchmark runs on. From them 3000 pictures of 640 x 480 are composed: a photograph
seen in perspective at a random scale, mostly behind 10 to 60 polygons cut from others (a "dead leaves" picture, whose
occlusions and sizes are distributed as in outdoor views), with random gamma, contrast, blur and noise. About 1000
features of each make about three million descriptors. The result depends on the seed alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import skimage
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.features.hamming import hamming
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options
from codecbench.slam.places.vocabulary import Indices, Vocabulary

PHOTOGRAPHS = (
    "astronaut.png", "brick.png", "camera.png", "cell.png", "chelsea.png", "clock_motion.png", "coffee.png",
    "coins.png", "grass.png", "gravel.png", "hubble_deep_field.jpg", "ihc.png", "moon.png", "motorcycle_left.png",
    "motorcycle_right.png", "page.png", "retina.jpg", "rocket.jpg", "text.png",
)  # fmt: skip
PORTRAIT = "grace_hopper.jpg"  # comes with matplotlib

BRANCHES = 10
DEPTH = 5
PICTURES = 3000
SEED = 1
_SIZE_PX = (640, 480)
_VIEWS_A_PICTURE = 8
_ASSIGNMENT_ROUNDS = 8  # of k-majority clustering; few descriptors still move after them
_SETTLED_FRACTION = 0.005  # of the descriptors of a node: fewer move, and its clusters are final
_SEEDING_SAMPLE = 2000  # descriptors among which the first centers are drawn

Gray = NDArray[np.uint8]
Bits = NDArray[np.uint64]


def load_photographs() -> list[Gray]:
    """Read the training photographs as gray images."""
    folder = Path(skimage.__file__).parent / "data"
    paths = [folder / name for name in PHOTOGRAPHS]
    paths.append(Path(matplotlib.get_data_path()) / "sample_data" / PORTRAIT)
    out = []
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise FileNotFoundError(f"{path} cannot be read; reinstall the package that contains it")
        out.append(np.asarray(image, dtype=np.uint8))
    return out


def compose_picture(photographs: list[Gray], rng: np.random.Generator) -> Gray:
    """Return one training picture, (480, 640): a photograph in perspective, mostly with pieces of others before it."""
    views = [_perspective_view(photographs, rng) for _ in range(_VIEWS_A_PICTURE)]
    picture = views[0]
    if rng.random() < 0.8:
        for _ in range(int(rng.integers(10, 60))):
            mask = _random_polygon(rng)
            picture = np.where(mask, views[int(rng.integers(len(views)))], picture)
    levels = (picture / 255.0) ** rng.uniform(0.6, 1.6) * 255.0
    levels = (levels - 128.0) * rng.uniform(0.5, 1.2) + 128.0 + rng.uniform(-30.0, 30.0)
    levels = np.asarray(cv2.GaussianBlur(levels, (0, 0), rng.uniform(0.3, 1.2)), dtype=np.float64)
    levels += rng.normal(0.0, rng.uniform(0.0, 5.0), levels.shape)
    return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)


def _perspective_view(photographs: list[Gray], rng: np.random.Generator) -> Gray:
    """Return (480, 640) of a random photograph, turned, scaled and seen at a slant."""
    photograph = photographs[int(rng.integers(len(photographs)))]
    height, width = photograph.shape
    scale = np.exp(rng.uniform(np.log(0.25), np.log(1.5)))
    if scale < 1.0:  # smooth before shrinking, as a camera's pixels do
        shrunk = cv2.resize(photograph, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        photograph = np.asarray(shrunk, dtype=np.uint8)
        height, width, scale = *photograph.shape, 1.0
    angle = rng.normal(0.0, 0.3) + rng.integers(4) * (np.pi / 2.0 if rng.random() < 0.3 else 0.0)
    center = np.array([rng.uniform(0.0, width), rng.uniform(0.0, height)])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * scale
    homography = np.eye(3)
    homography[:2, :2] = turn @ np.array([[1.0, rng.normal(0.0, 0.2)], [0.0, np.exp(rng.normal(0.0, 0.25))]])
    homography[:2, 2] = np.array(_SIZE_PX) / 2.0 - homography[:2, :2] @ center
    homography = np.array([[1, 0, 0], [0, 1, 0], [*rng.normal(0.0, 4e-4, 2), 1.0]]) @ homography
    view = cv2.warpPerspective(photograph, homography, _SIZE_PX, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(view, dtype=np.uint8)


def _random_polygon(rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the mask of a polygon of 3 to 6 corners; small ones are more frequent, as areas in nature are."""
    radius = 20.0 * (1.0 - 0.99 * rng.random()) ** -0.5
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(3, 7))))
    center = rng.uniform((0.0, 0.0), _SIZE_PX)
    corners = center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(0.5, 1.5, 2)
    mask = np.zeros(_SIZE_PX[::-1], dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
    return mask.astype(np.bool_)


def extract_descriptors(photographs: list[Gray], pictures: int, rng: np.random.Generator) -> tuple[Bits, Indices]:
    """Return the descriptors (N, 4) of composed pictures and the picture of each (N,)."""
    camera = Camera(*_SIZE_PX, 500.0, 500.0, 319.5, 239.5)
    extractor = FeatureExtractor(camera, Options())
    per_picture = [extractor.extract(compose_picture(photographs, rng)).descriptors for _ in range(pictures)]
    return np.concatenate(per_picture), np.repeat(
        np.arange(pictures), [len(descriptors) for descriptors in per_picture]
    )


def train(
    descriptors: Bits, pictures: Indices, rng: np.random.Generator, branches: int = BRANCHES, depth: int = DEPTH
) -> Vocabulary:
    """Build a tree over descriptors (N, 4) by k-majority clustering, level after level; `pictures` (N,) gives the idf.

    The idf of a word is log(N / n): N pictures, n of them with the word.
    Source: Galvez-Lopez and Tardos, T-RO 28(5), 2012, section III; Arthur and Vassilvitskii, 2007 (seeding).
    """
    picture_count = len(np.unique(pictures))
    counts, nodes, weights = [], [], []
    level = [np.arange(len(descriptors))]
    for height in range(depth + 1):
        following: list[Indices] = []
        for members in level:
            distinct = len(np.unique(descriptors[members], axis=0)) if len(members) <= branches else branches
            if height == depth or distinct < 2:
                counts.append(0)
                weights.append(np.log(picture_count / len(np.unique(pictures[members]))))
                continue
            centers, labels = _cluster(descriptors[members], branches, rng)
            parts = [members[labels == k] for k in range(len(centers))]
            nonempty = [k for k, part in enumerate(parts) if len(part)]
            counts.append(len(nonempty))
            nodes.append(centers[nonempty])
            following.extend(parts[k] for k in nonempty)
        level = following
    rows = np.concatenate(nodes).view(np.uint8).reshape(-1, 32)
    return Vocabulary(np.array(counts, dtype=np.uint8), rows, np.array(weights))


def _cluster(descriptors: Bits, branches: int, rng: np.random.Generator) -> tuple[Bits, Indices]:
    """Return centers (k, 4), k <= branches, and the center of each descriptor (N,)."""
    centers = _seed_centers(descriptors, branches, rng)
    labels = np.full(len(descriptors), -1, dtype=np.int64)
    for _ in range(_ASSIGNMENT_ROUNDS):
        moved = _assign(descriptors, centers, labels)
        if moved <= _SETTLED_FRACTION * len(descriptors):
            break
        _vote(descriptors, labels, centers)
    return centers, labels


def _seed_centers(descriptors: Bits, branches: int, rng: np.random.Generator) -> Bits:
    """Draw distant first centers: each with a probability that grows with its squared distance to those drawn."""
    sample = descriptors
    if len(sample) > _SEEDING_SAMPLE:
        sample = sample[rng.choice(len(sample), _SEEDING_SAMPLE, replace=False)]
    centers = [sample[int(rng.integers(len(sample)))]]
    nearest = np.full(len(sample), 256.0)
    while len(centers) < branches:
        nearest = np.minimum(nearest, np.bitwise_count(sample ^ centers[-1]).sum(axis=1))
        total = float((nearest**2).sum())
        if total == 0.0:
            break
        centers.append(sample[int(rng.choice(len(sample), p=nearest**2 / total))])
    return np.array(centers)


@compiled
def _assign(descriptors, centers, labels):  # type: ignore[no-untyped-def]
    """Label each descriptor with its nearest center; return how many changed."""
    moved = 0
    for i in range(descriptors.shape[0]):
        best, best_distance = 0, 257
        for k in range(centers.shape[0]):
            distance = hamming(descriptors, i, centers, k)
            if distance < best_distance:
                best, best_distance = k, distance
        moved += labels[i] != best
        labels[i] = best
    return moved


@compiled
def _vote(descriptors, labels, centers):  # type: ignore[no-untyped-def]
    """Replace each center by the majority of its descriptors, bit by bit; a tie sets the bit."""
    sizes, votes = np.zeros(centers.shape[0], np.int64), np.zeros((centers.shape[0], 256), np.int32)
    lowest = np.uint64(1)
    for i in range(descriptors.shape[0]):
        sizes[labels[i]] += 1
        ballot = votes[labels[i]]
        for word in range(4):
            bits = descriptors[i, word]
            for bit in range(64):
                ballot[64 * word + bit] += np.int32((bits >> np.uint64(bit)) & lowest)
    for k in range(centers.shape[0]):
        for word in range(4):
            bits = np.uint64(0)
            for bit in range(64):
                if 2 * votes[k, 64 * word + bit] >= sizes[k]:
                    bits |= lowest << np.uint64(bit)
            if sizes[k] > 0:
                centers[k, word] = bits


def main() -> None:
    """Train with the fixed seed and write the vocabulary, by default over the one in the package."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "vocabulary.npz"
    rng = np.random.default_rng(SEED)
    descriptors, pictures = extract_descriptors(load_photographs(), PICTURES, rng)
    vocabulary = train(descriptors, pictures, rng)
    vocabulary.save(target)
    sys.stdout.write(
        f"{target}: {len(vocabulary)} words from {len(descriptors)} descriptors, {target.stat().st_size} bytes\n"
    )


if __name__ == "__main__":
    main()
