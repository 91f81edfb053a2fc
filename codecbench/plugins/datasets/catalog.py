"""The catalog of datasets that can be fetched: their addresses, licenses and folders."""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.kernels.folders import cache_folder
from codecbench.plugins.datasets.download import Progress, ResumingDownloader, unpack

_TUM_CITATION = (
    "J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A Benchmark for the Evaluation of RGB-D SLAM "
    "Systems. IROS 2012. doi:10.1109/IROS.2012.6385773"
)
_EUROC_CITATION = (
    "M. Burri, J. Nikolic, P. Gohl, T. Schneider, J. Rehder, S. Omari, M. W. Achtelik, R. Siegwart: The EuRoC micro "
    "aerial vehicle datasets. International Journal of Robotics Research 35(10), 2016. doi:10.1177/0278364915620033"
)
_KITTI_CITATION = (
    "A. Geiger, P. Lenz, R. Urtasun: Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite. "
    "CVPR 2012. doi:10.1109/CVPR.2012.6248074"
)


@dataclass(frozen=True)
class CatalogEntry:
    """A dataset that can be fetched."""

    name: str
    kind: str
    """Name of the dataset plugin that reads it."""
    homepage: str
    licence: str
    citation: str
    urls: tuple[str, ...] = ()
    """One archive, or the files themselves."""
    size_bytes: int | None = None
    """Approximate size of the download; None if unknown."""
    sha256: tuple[str | None, ...] = ()
    """Checksum of each download in order. If None, the first fetch records one, and later fetches must match it."""
    inside: str = ""
    """Folder in the archive, see `unpack`."""
    leave_out: tuple[str, ...] = ()
    """Patterns of names, see `unpack`."""
    manual: str = ""
    """Steps for the user if the publisher requires registration; such an entry has no urls."""

    @property
    def folder(self) -> Path:
        """Folder of the fetched dataset."""
        return data_folder() / self.name

    @property
    def is_there(self) -> bool:
        return self.folder.is_dir()


def data_folder() -> Path:
    """The folder of fetched datasets, in the cache folder."""
    return cache_folder() / "data"


def _tum(name: str, size_bytes: int | None = None) -> CatalogEntry:
    folder = f"rgbd_dataset_{name}"
    return CatalogEntry(
        name=name,
        kind="tum",
        homepage="https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
        licence="CC BY 4.0",
        citation=_TUM_CITATION,
        urls=(f"https://cvg.cit.tum.de/rgbd/dataset/{name.split('_')[0]}/{folder}.tgz",),
        size_bytes=size_bytes,
        inside=folder,
        leave_out=("*/depth/*",),
    )


def _euroc(name: str, place: str) -> CatalogEntry:
    site = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset"
    return CatalogEntry(
        name=name.lower(),
        kind="euroc",
        homepage="https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets",
        licence="for research; see the homepage",
        citation=_EUROC_CITATION,
        urls=(f"{site}/{place}/{name}/{name}.zip",),
        leave_out=("__MACOSX/*", "*.DS_Store"),
    )


_KITTI_STEPS = """KITTI asks for a registration, so this step is yours:
  1. Register at https://www.cvlibs.net/datasets/kitti/eval_odometry.php and download `odometry data set
     (grayscale, 22 GB)`, `odometry data set (calibration files, 1 MB)` and `odometry ground truth poses (4 MB)`.
  2. Unpack all three into {folder}
     so that {folder}/dataset/sequences/00/image_0 exists.
  3. Name it in a matrix as `use: kitti` with `fetched: kitti_odometry`."""

DATASETS: tuple[CatalogEntry, ...] = (
    _tum("freiburg3_long_office_household", 1_483_556_251),
    _tum("freiburg1_xyz"),
    _tum("freiburg1_desk"),
    _tum("freiburg1_room", 782_381_450),
    _tum("freiburg2_xyz"),
    _tum("freiburg2_desk", 1_893_351_095),
    _tum("freiburg3_structure_texture_far"),
    _tum("freiburg3_nostructure_texture_near_withloop"),
    _euroc("MH_01_easy", "machine_hall"),
    _euroc("MH_03_medium", "machine_hall"),
    _euroc("V1_01_easy", "vicon_room1"),
    CatalogEntry(
        name="kodak",
        kind="folder",
        homepage="https://r0k.us/graphics/kodak/",
        licence="released by Kodak for unrestricted use",
        citation="Kodak Lossless True Color Image Suite, PhotoCD PCD0992",
        urls=tuple(f"https://r0k.us/graphics/kodak/kodak/kodim{number:02d}.png" for number in range(1, 25)),
        size_bytes=15_400_000,
    ),
    CatalogEntry(
        name="kitti_odometry",
        kind="kitti",
        homepage="https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
        licence="CC BY-NC-SA 3.0",
        citation=_KITTI_CITATION,
        size_bytes=23_600_000_000,
        manual=_KITTI_STEPS,
    ),
)


def list_datasets() -> tuple[CatalogEntry, ...]:
    """All datasets of the catalog; `is_there` is true if one has been fetched."""
    return DATASETS


def find(name: str) -> CatalogEntry:
    """The catalog entry called `name`. Raises DatasetError with a suggestion."""
    for entry in DATASETS:
        if entry.name == name:
            return entry
    close = get_close_matches(name, [entry.name for entry in DATASETS], 1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise DatasetError(f"no dataset is called {name!r}; {hint}`codecbench data list` shows all")


def path(name: str) -> Path:
    """The folder of a fetched dataset. Raises DatasetError with the command that fetches it if it is missing."""
    entry = find(name)
    if not entry.is_there:
        raise DatasetError(f"{entry.folder}: dataset {name} is not fetched yet; run `codecbench data fetch {name}`")
    return entry.folder


def fetch(name: str, progress: Callable[[str, int, int | None], None] | None = None) -> Path:
    """Fetch a dataset into the cache folder unless it is there, and return its folder.

    progress: called with the file's name, the bytes received, and the total if it is known. Raises DatasetError
    if the network or the disk fails, a checksum is wrong or an archive is unsafe. If the dataset must be downloaded
    by hand, the error lists the steps.
    """
    return fetch_entry(find(name), progress)


def fetch_entry(entry: CatalogEntry, progress: Callable[[str, int, int | None], None] | None = None) -> Path:
    """Fetch an entry, which need not be in the catalog; see `fetch`."""
    if entry.is_there:
        return entry.folder
    if entry.manual:
        raise DatasetError(f"{entry.name}: " + entry.manual.format(folder=entry.folder))
    arriving = data_folder() / ".arriving" / entry.name
    files = []
    for number, url in enumerate(entry.urls):
        expected = entry.sha256[number] if number < len(entry.sha256) else None
        files.append(_fetch_file(entry, url, expected, arriving, progress))
    if len(files) == 1 and files[0].suffix in (".zip", ".tgz", ".gz", ".tar"):
        unpack(files[0], entry.folder, entry.inside, entry.leave_out)
    else:
        arriving.rename(entry.folder)
    shutil.rmtree(arriving, ignore_errors=True)
    return entry.folder


def _fetch_file(
    entry: CatalogEntry,
    url: str,
    expected: str | None,
    arriving: Path,
    progress: Callable[[str, int, int | None], None] | None,
) -> Path:
    import pooch  # slow to import, and needed only to fetch

    pooch.get_logger().setLevel(logging.WARNING)
    name = url.rsplit("/", 1)[-1]
    checksum = expected or recorded_checksum(entry, name)
    report: Progress | None = None if progress is None else lambda done, total: progress(name, done, total)
    downloader = ResumingDownloader(data_folder() / ".partial" / f"{entry.name}-{name}", report)
    try:
        arriving.mkdir(parents=True, exist_ok=True)
        file = Path(pooch.retrieve(url, checksum and f"sha256:{checksum}", name, arriving, downloader=downloader))
    except ValueError as error:
        source = "the catalog's" if expected else f"that of the first fetch, in {_checksum_file(entry)}"
        raise DatasetError(
            f"{url}: the download has the wrong checksum ({source}: {checksum}) and was deleted; fetch again. "
            "If that fails too, the publisher has changed the file"
        ) from error
    except OSError as error:
        raise DatasetError(f"{arriving}: cannot be written: {error.strerror or error}") from error
    if checksum is None:
        _record_checksum(entry, name, file)
    return file


def _checksum_file(entry: CatalogEntry) -> Path:
    return data_folder() / f"{entry.name}.sha256"


def recorded_checksum(entry: CatalogEntry, name: str) -> str | None:
    """The checksum that the first fetch of a file recorded as `sha256sum` would, None if there is none."""
    file = _checksum_file(entry)
    for line in file.read_text().splitlines() if file.is_file() else ():
        digest, _, file_name = line.partition("  ")
        if file_name == name:
            return digest
    return None


def _record_checksum(entry: CatalogEntry, name: str, file: Path) -> None:
    with open(file, "rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    with open(_checksum_file(entry), "a") as record:
        record.write(f"{digest}  {name}\n")
