"""Which plugins there are in the zoo, and what each may cost. This module imports none of them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

UNSUPPORTED, FAILED, CRASHED, TIMED_OUT, OK = "unsupported", "failed", "crashed", "timed_out", "ok"


@dataclass(frozen=True)
class Case:
    """A plugin that misbehaves.

    status: of the rows that it takes part in. words: what their reason holds besides the name of the plugin.
    """

    kind: str
    name: str
    target: str
    status: str
    words: str = ""

    @property
    def summary(self) -> str:
        return f"misbehaves in {self.target.partition(':')[0].rpartition('.')[2]}"

    @property
    def title(self) -> str:
        """The plugin and its distribution, as reasons name them."""
        return f"{self.kind.replace('_', ' ')} {self.name} of codecbench-zoo 1.0"


ENDED = "its process "
NO_ANSWER = "no answer within "
NONSENSE = "it sent an invalid answer"
_NO_RESULT = "no result within "
_FIRST = "encode, frame 0: "
_DECODED = "decode, frame 0: "
_MEASURED = "evaluate, frame 0: "
_NO_NUMBER = _MEASURED + "gain: a value is a number, got "

_Rows = dict[str, tuple[str, str]]

CODECS: dict[str, _Rows] = {
    "constructing": {
        "Exits": (UNSUPPORTED, "SystemExit: 0"),
        "Leaves": (UNSUPPORTED, ENDED + "exited with status 0"),
        "Raises": (UNSUPPORTED, "KeyboardInterrupt: as if somebody had pressed it"),
        "Dies": (UNSUPPORTED, ENDED + "was killed by SIGKILL"),
        "StopsIterating": (UNSUPPORTED, "StopIteration"),
        "Hangs": (UNSUPPORTED, NO_ANSWER),
        "Mumbles": (UNSUPPORTED, "Untold"),
        "Screams": (UNSUPPORTED, "ValueError: \\x1b[31maaaa"),
        "Twins": (OK, ""),
        "Babbles": (UNSUPPORTED, NONSENSE),
        "Slams": (UNSUPPORTED, "its process "),
        "Printed": (OK, ""),
        "Vague": (UNSUPPORTED, "codecbench_zoo.constructing:Vague has no class attribute 'capabilities'"),
        "Unfinished": (UNSUPPORTED, "codecbench_zoo.constructing:Unfinished does not define decode"),
        "Stranger": (UNSUPPORTED, "codecbench_zoo.constructing:Stranger is not a subclass of codecbench.Codec"),
        "Renamed": (UNSUPPORTED, "codecbench_zoo.constructing:Renamed has the name 'jpeg'"),
        "Absent": (UNSUPPORTED, "codecbench_zoo.constructing has no Absent"),
        "Odd": (UNSUPPORTED, "Odd.version is 2.5; it must be a string"),
        "Boastful": (UNSUPPORTED, "AttributeError: 'str' object has no attribute 'channels'"),
        "Colorless": (UNSUPPORTED, "Colorless.capabilities.channels is []"),
        "Formless": (UNSUPPORTED, "AttributeError"),
        "BadDefault": (UNSUPPORTED, "parameter quality: Input should be a finite number"),
        "Tabular": (UNSUPPORTED, "PydanticSerializationError"),
        "Unidentified": (UNSUPPORTED, "its description is not valid JSON: "),
        "Moody": (OK, ""),
        "Bloated": (UNSUPPORTED, "Bloated.version"),
    },
    "gone": {"Gone": (UNSUPPORTED, "codecbench_zoo.gone does not import: ModuleNotFoundError")},
    "refuses": {"Refuses": (UNSUPPORTED, "codecbench_zoo.refuses does not import: RuntimeError: not today")},
    "exiting": {"Exiting": (UNSUPPORTED, "SystemExit: 0")},
    "encoding": {
        "Segfaults": (CRASHED, "encode: " + ENDED + "was killed by SIGSEGV"),
        "KillsItself": (CRASHED, "encode: " + ENDED + "was killed by SIGKILL"),
        "KillsItsParent": (CRASHED, "encode: " + ENDED + "was killed by SIGKILL"),
        "Terminates": (CRASHED, "encode: " + ENDED + "was killed by SIGTERM"),
        "Aborts": (CRASHED, "encode: " + ENDED + "was killed by SIGABRT"),
        "Stops": (TIMED_OUT, "while encoding: " + _NO_RESULT),
        "Sleeps": (TIMED_OUT, "while encoding: " + _NO_RESULT),
        "LeavesWell": (CRASHED, "encode: " + ENDED + "exited with status 0"),
        "LeavesLikeOurs": (CRASHED, "encode: " + ENDED + "exited with status 86"),
        "LeavesAnHeir": (CRASHED, "encode: " + ENDED + "exited with status 3"),
        "ExitsLate": (FAILED, _FIRST + "SystemExit: 0"),
        "Interrupts": (FAILED, _FIRST + "KeyboardInterrupt"),
        "StopsTheGenerator": (FAILED, _FIRST + "GeneratorExit: no more"),
        "StopsIteration": (FAILED, _FIRST + "StopIteration: no more"),
        "RaisesOfItsOwn": (FAILED, _FIRST + "_Private: of its own kind"),
        "RaisesUntold": (FAILED, _FIRST + "_Silent"),
        "RaisesMuch": (FAILED, _FIRST + "ValueError: \\x1b[31m\\x00aaaa"),
        "RaisesInCircles": (FAILED, _FIRST + "ValueError: first"),
        "Declines": (UNSUPPORTED, _FIRST + "not on a Sunday"),
        "Recurses": (FAILED, _FIRST + "RecursionError"),
        "Hogs": (FAILED, _FIRST + "MemoryError"),
        "HogsInChildren": (CRASHED, "while encoding: used "),
        "ReturnsNone": (FAILED, _FIRST + "encode returned NoneType; a bitstream is bytes"),
        "ReturnsText": (FAILED, _FIRST + "encode returned str"),
        "ReturnsView": (FAILED, _FIRST + "encode returned memoryview"),
        "ReturnsBytearray": (FAILED, _FIRST + "encode returned bytearray"),
        "ReturnsNothing": (FAILED, _FIRST + "encode returned no bytes"),
        "ReturnsLight": (OK, ""),
        "Forks": (OK, ""),
        "ClosesEverything": (CRASHED, "encode: " + ENDED + "exited with status 1"),
        "ClosesAndStays": (CRASHED, "encode: its process closed the connection"),
        "AnswersForUs": (FAILED, "encode: " + NONSENSE),
        "AnswersWithoutEnd": (FAILED, "encode: its answer has more than 64 MB"),
        "FillsThePipe": (OK, ""),
    },
    "decoding": {
        "DecodesNone": (FAILED, _DECODED + "decode returned NoneType"),
        "DecodesLists": (FAILED, _DECODED + "decode returned list"),
        "DecodesFloats": (FAILED, _DECODED + "decode returned dtype float32"),
        "DecodesObjects": (FAILED, _DECODED + "decode returned ndarray of dtype object"),
        "DecodesTurned": (FAILED, _DECODED + "decode returned shape (128, 96); the frame has (96, 128)"),
        "DecodesColor": (FAILED, _DECODED + "decode returned shape (96, 128, 3)"),
        "DecodesNothing": (FAILED, _DECODED + "decode returned shape (0, 128)"),
        "DecodesPretenders": (FAILED, _DECODED + "decode returned "),
        "DecodesShy": (OK, ""),
        "DecodesBackwards": (OK, ""),
        "DecodeSegfaults": (CRASHED, ": " + ENDED + "was killed by SIGSEGV"),
        "DecodeKills": (CRASHED, ": " + ENDED + "was killed by SIGKILL"),
        "DecodeSleeps": (TIMED_OUT, "while evaluating: " + _NO_RESULT),
        "DecodeExits": (FAILED, _DECODED + "SystemExit: enough"),
        "DecodeRefuses": (FAILED, _DECODED + "I do not know these bytes"),
        "DecodeBlames": (FAILED, _DECODED + "it was like this when I came"),
        "Remembers": (FAILED, _DECODED + "KeyError: 0"),
        "Rolls": (FAILED, "decode returns other pixels for the same bitstream in a new process"),
        "RemovesItsFolder": (FAILED, "FileNotFoundError"),
        "LibrariesOfObjects": (FAILED, "libraries"),
        "LibrariesOfCode": (OK, ""),
        "LibrariesFail": (FAILED, "libraries: RuntimeError: who knows"),
    },
    "lingering": {
        "Cleans": (OK, ""),
        "Scribbles": (OK, ""),
        "LowersTheStack": (OK, ""),
        "SetsTimers": (OK, ""),
        "CatchesSignals": (OK, ""),
        "LowersLimits": (OK, ""),
        "ClosesOutput": (OK, ""),
        "LeavesItsGroup": (OK, ""),
        "LeavesThreads": (OK, ""),
        "LeavesChildren": (OK, ""),
        "LeavesAHook": (OK, ""),
        "Innocent": (OK, ""),
    },
    "patching": {
        "Patches": (OK, ""),
        "PatchesJson": (FAILED, "encode: " + NONSENSE),
        "PatchesOpen": (OK, ""),
    },
}
DATASETS: dict[str, _Rows] = {
    "opening": {
        "Broken": (UNSUPPORTED, "KeyError: 'not there'"),
        "Abandoned": (UNSUPPORTED, ENDED + "exited with status 3"),
        "Departs": (UNSUPPORTED, "SystemExit: 0"),
        "OpensForEver": (UNSUPPORTED, NO_ANSWER),
        "OpensNothing": (UNSUPPORTED, "open returned NoneType"),
        "Nameless": (UNSUPPORTED, "AttributeError"),
        "OddName": (UNSUPPORTED, "name is 7; it must be a string"),
        "LongName": (OK, ""),
        "Frameless": (UNSUPPORTED, "has no frames"),
        "Untimely": (UNSUPPORTED, "timestamps_s"),
        "Backwards": (UNSUPPORTED, "timestamps_s"),
        "TwoDimensional": (UNSUPPORTED, "timestamps_s"),
        "FourChannels": (UNSUPPORTED, "channels is 4"),
        "Boundless": (UNSUPPORTED, "timestamps_s"),
        "Negative": (UNSUPPORTED, "ValueError: __len__() should return >= 0"),
        "Impostor": (UNSUPPORTED, "it has the same fingerprint as drawn"),
    },
    "reading": {
        "ReadsNone": (FAILED, "read, frame 0: read returned NoneType"),
        "ReadsFloats": (FAILED, "read, frame 0: an image has dtype uint8, got float64"),
        "ReadsEmpty": (FAILED, "read, frame 0: image of shape (0, 64) has no pixels"),
        "ReadsLists": (FAILED, "read, frame 0: an image is a numpy array, got list"),
        "ReadsColor": (FAILED, "read, frame 0: image has 3 channel(s); allowed here: 1"),
        "ReadsFails": (FAILED, "read, frame 2: frames.bin, byte 17: torn"),
        "ReadsLeaves": (CRASHED, "read, frame 0: " + ENDED + "exited with status 0"),
        "ReadsForEver": (TIMED_OUT, _NO_RESULT),
        "Grows": (OK, ""),
        "ChangesItsMind": (FAILED, "open: changes_its_mind has changed since the plan was made"),
        "LongTruth": (OK, ""),
    },
}
EVALUATORS: dict[str, _Rows] = {
    "declaring": {
        "Uncertain": (UNSUPPORTED, "RuntimeError: it depends"),
        "Countless": (UNSUPPORTED, "Countless.repeats is 1000000000"),
        "Halves": (UNSUPPORTED, "TypeError: 'float' object cannot be interpreted as an integer"),
        "QuitsWhenAsked": (UNSUPPORTED, "SystemExit: 0"),
        "UsesWhatIsNot": (UNSUPPORTED, "no codec is called 'not_there'"),
        "UsesItself": (OK, ""),
        "NeedsNothingKnown": (UNSUPPORTED, "TypeError"),
        "Timeless": (UNSUPPORTED, "its description is not valid JSON: "),
        "Shapeless": (FAILED, "evaluate: Shapeless is not a FrameEvaluator, SequenceEvaluator or CodecEvaluator"),
        "Loud": (UNSUPPORTED, "metric"),
        "Mimics": (OK, ""),
        "Ages": (UNSUPPORTED, NO_ANSWER),
    },
    "misdeclared.unmeasured": {"Unmeasured": (UNSUPPORTED, "codecbench_zoo.misdeclared.unmeasured does not import")},
    "misdeclared.doubled": {"Doubled": (UNSUPPORTED, "Doubled: metrics declares gain twice")},
    "misdeclared.unitless": {"Unitless": (UNSUPPORTED, "missing 3 required positional arguments: 'unit'")},
    "misdeclared.upwards": {"Upwards": (UNSUPPORTED, "metric 'gain': better is 'up'; it must be one of higher")},
    "misdeclared.heroic": {"Heroic": (UNSUPPORTED, "metric 'gain': role is 'hero'; it must be one of rate")},
    "misdeclared.unseen": {"Unseen": (UNSUPPORTED, "Unseen: view 'Speed' names 'speed'; declared are")},
    "measuring": {
        "MeasuresNan": (FAILED, _MEASURED + "gain: NaN without a reason"),
        "MeasuresInfinity": (OK, ""),
        "MeasuresComplex": (FAILED, _NO_NUMBER + "complex"),
        "MeasuresText": (FAILED, _NO_NUMBER + "str"),
        "MeasuresTruth": (FAILED, _NO_NUMBER + "bool"),
        "MeasuresFractions": (FAILED, _NO_NUMBER + "Fraction"),
        "MeasuresArrays": (FAILED, _NO_NUMBER + "ndarray"),
        "MeasuresGoogols": (FAILED, _MEASURED + "OverflowError"),
        "MeasuresTheUndeclared": (FAILED, _MEASURED + "metric 'speed' is not declared"),
        "MeasuresUnchecked": (FAILED, "metric 'speed' is not declared"),
        "MeasuresNothing": (OK, ""),
        "MeasuresNone": (FAILED, _MEASURED + "TypeError: 'NoneType' object is not iterable"),
        "MeasuresNumbers": (FAILED, _MEASURED + "yielded float; evaluators yield Measurement"),
        "MeasuresOtherFrames": (FAILED, _MEASURED + "gain: measured on frame 0 but yielded for frame 99"),
        "MeasuresStages": (FAILED, _MEASURED + "gain: stage and reason are text, got int"),
        "MeasuresForEver": (FAILED, "evaluate: gain: more than 5,000 measurements"),
        "MeasuresWithCode": (OK, ""),
        "MeasuresNever": (TIMED_OUT, "while evaluating: " + _NO_RESULT),
        "MeasuresAndLeaves": (CRASHED, _MEASURED + ENDED + "exited with status 0"),
        "MeasuresAndExits": (FAILED, _MEASURED + "SystemExit: 0"),
        "MeasuresAndDies": (CRASHED, _MEASURED + ENDED + "was killed by SIGSEGV"),
        "MeasuresAndFails": (FAILED, _MEASURED + "ZeroDivisionError: of nothing"),
        "Overwrites": (OK, ""),
        "MeasuresMillions": (FAILED, "evaluate: gain: more than 5,000 "),
        "MeasuresManyStages": (FAILED, "evaluate: gain: more than 1,000 stages"),
        "ExplainsMuch": (OK, ""),
        "AsksForFrames": (FAILED, "evaluate: IndexError: frame -1 is not one of 0..2"),
        "UsesTheUndeclared": (FAILED, "evaluate: codec 'jpeg' is used but not declared"),
        "LeavesFolders": (FAILED, "artifacts: artifact 'map' is a folder"),
        "LeavesARecord": (FAILED, "artifacts: artifact 'record.json' is a folder or has a name"),
        "LeavesALink": (FAILED, "artifacts: artifact 'passwords' is "),
        "LeavesAPipe": (FAILED, "artifacts: artifact 'pipe' is "),
        "LeavesOddNames": (FAILED, "artifacts: artifact '\\x1b[2J\\n' "),
        "RemovesArtifacts": (FAILED, "artifacts: FileNotFoundError"),
    },
    "comparing": {
        "Comparing": (OK, ""),
        "Quitting": (OK, ""),
        "ComparesNone": (OK, ""),
        "ComparesNan": (OK, ""),
        "ComparesTheUndeclared": (OK, ""),
        "ComparesText": (OK, ""),
        "ComparesMillions": (OK, ""),
        "ComparesWell": (OK, ""),
        "DrawsText": (OK, ""),
        "DrawsNowhere": (OK, ""),
        "DrawsMillions": (OK, ""),
        "DrawsForEver": (OK, ""),
    },
}
SLAM_BACKENDS: dict[str, _Rows] = {
    "backends": {
        "TracksNone": (FAILED, "evaluate, frame 2: slam backend tracks_none returned NoneType"),
        "TracksNan": (FAILED, "trajectory has poses that are not finite"),
        "TracksFlat": (FAILED, "trajectory has poses (3, 3) for 3 stamps"),
        "TracksMore": (FAILED, "tracks_more returned 4 states for 3 frames"),
        "TracksLess": (FAILED, "tracks_less returned 2 states for 3 frames"),
        "TracksBackwards": (FAILED, "timestamps of trajectory do not increase"),
        "TracksUntimely": (FAILED, "timestamps of trajectory"),
        "TracksLists": (FAILED, "evaluate, frame 2: AttributeError"),
        "TracksEndlessPoints": (FAILED, "points_world has shape (5, 2)"),
        "TracksForEver": (TIMED_OUT, "while evaluating: " + _NO_RESULT),
        "TracksAndExits": (FAILED, "SystemExit: 0"),
        "TracksAndDies": (CRASHED, ENDED + "was killed by SIGSEGV"),
        "LeavesTheTrack": (UNSUPPORTED, ENDED + "exited with status 0"),
        "Unbuilt": (FAILED, "evaluate: "),
        "TracksWell": (OK, ""),
    },
}
EXECUTORS: dict[str, _Rows] = {
    "executors": {"Unexecuted": (UNSUPPORTED, "codecbench_zoo.executors:Unexecuted is not a subclass")},
}
_BY_KIND = {
    "codec": CODECS,
    "dataset": DATASETS,
    "evaluator": EVALUATORS,
    "slam_backend": SLAM_BACKENDS,
    "executor": EXECUTORS,
}


@cache
def cases(kind: str) -> tuple[Case, ...]:
    """All plugins of a kind, in the order in which a matrix names them."""
    return tuple(
        Case(kind, snake(name), f"codecbench_zoo.{module}:{name}", status, words)
        for module, rows in _BY_KIND[kind].items()
        for name, (status, words) in rows.items()
    )


def snake(name: str) -> str:
    """`returns_none` of `ReturnsNone`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
