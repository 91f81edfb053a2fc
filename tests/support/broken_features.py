"""Codecs of features that each break the contract in one way; `codecbench_corners` keeps it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from codecbench_corners.codec import Corners, CornersDecoder, CornersEncoder

from codecbench import (
    BitstreamError,
    Capabilities,
    FeatureDecoder,
    FeatureEncoder,
    Features,
    FeatureSet,
    Image,
    Loss,
    Packet,
)


class Broken(Corners):
    Encoding: ClassVar[type[CornersEncoder]] = CornersEncoder
    Decoding: ClassVar[type[CornersDecoder]] = CornersDecoder

    def encoder(self) -> FeatureEncoder:
        return self.Encoding(self.params)

    def decoder(self) -> FeatureDecoder:
        return self.Decoding()


class DrawsByChance(Broken):
    """Finds other features each time."""

    def extract(self, image: Image) -> Features:
        found = super().extract(image)
        return replace(found, responses=np.random.default_rng().random(len(found)))


class LosesTheLastBits(Broken):
    """Calls itself lossless and rounds positions."""

    class Encoding(CornersEncoder):
        def push(self, features: Features) -> Packet:
            return super().push(replace(features, pixels=np.rint(features.pixels)))


class ForgetsEmptySets(Broken):
    """Gives the set before where there is none."""

    class Decoding(CornersDecoder):
        shown: Features | None = None

        def push(self, packet: Packet | Loss) -> FeatureSet:
            found = super().push(packet)
            if found.features is not None and self.shown is not None and not len(found.features):
                return replace(found, features=self.shown)
            self.shown = found.features
            return found


class CutsWhatIsTooMuch(Broken):
    """Sends the first thousand of very many features and says nothing."""

    class Encoding(CornersEncoder):
        def push(self, features: Features) -> Packet:
            kept = slice(1000)
            return super().push(
                Features(
                    features.size,
                    features.pixels[kept],
                    features.octaves[kept],
                    features.angles[kept],
                    features.responses[kept],
                    features.descriptors[kept],
                )
            )


class RepeatsWhatWasLost(Broken):
    """Shows the last set for one that never came."""

    class Decoding(CornersDecoder):
        shown: Features | None = None

        def push(self, packet: Packet | Loss) -> FeatureSet:
            found = super().push(packet)
            self.shown = found.features or self.shown
            return replace(found, features=self.shown)


class BelievesItsReference(Broken):
    """Goes on after a loss with whatever set it had last, if that inflates."""

    class Decoding(CornersDecoder):
        def push(self, packet: Packet | Loss) -> FeatureSet:
            last = self.last
            found = super().push(packet)
            if isinstance(packet, Loss):
                self.last = last
            elif found.features is None and last is not None and packet.frame > 0:
                return FeatureSet(packet.frame, Features.none((160, 120)))
            return found


class SharesItsMemory(Broken):
    """The set before is one for all sessions."""

    class Encoding(CornersEncoder):
        known: ClassVar[list[bytes]] = [b""]

        def push(self, features: Features) -> Packet:
            if self.pushed:
                self.last = self.known[0]
            packet = super().push(features)
            self.known[0] = self.last
            return packet


class KeepsBytesBack(Broken):
    """Sends four bytes a set and leaves the rest where only this process finds it."""

    store: ClassVar[dict[bytes, bytes]] = {}

    class Encoding(CornersEncoder):
        def push(self, features: Features) -> Packet:
            packet = super().push(features)
            KeepsBytesBack.store[packet.data[-4:]] = packet.data
            return replace(packet, data=packet.data[-4:])

    class Decoding(CornersDecoder):
        def push(self, packet: Packet | Loss) -> FeatureSet:
            if isinstance(packet, Loss):
                return super().push(packet)
            if packet.data not in KeepsBytesBack.store:
                raise BitstreamError("never seen")
            return super().push(replace(packet, data=KeepsBytesBack.store[packet.data]))


class SwallowsDamage(Broken):
    """Says of what is damaged that it is missing, as if it had been lost."""

    class Decoding(CornersDecoder):
        def push(self, packet: Packet | Loss) -> FeatureSet:
            try:
                return super().push(packet)
            except BitstreamError:
                return FeatureSet(self.next - 1, None)


class StartsAnywhere(Broken):
    """Claims of every packet that decoding can start there."""

    class Encoding(CornersEncoder):
        def push(self, features: Features) -> Packet:
            return replace(super().push(features), starts=True)


class CountsFromOne(Broken):
    """Numbers its packets as people do."""

    class Encoding(CornersEncoder):
        def push(self, features: Features) -> Packet:
            packet = super().push(features)
            return replace(packet, frame=packet.frame + 1)


class TakesAnyImage(Broken):
    """Says that it takes gray pictures only, and takes all."""

    capabilities = Capabilities(channels=(1,), lossless=True, thread_safe=False)


BROKEN: dict[type[Any], str] = {
    DrawsByChance: "extract",
    LosesTheLastBits: "lossless",
    ForgetsEmptySets: "empty",
    CutsWhatIsTooMuch: "limits",
    RepeatsWhatWasLost: "loss",
    BelievesItsReference: "loss",
    SharesItsMemory: "interleaved",
    KeepsBytesBack: "self_contained",
    SwallowsDamage: "damaged",
    StartsAnywhere: "starts",
    CountsFromOne: "bytes",
    TakesAnyImage: "bad_images",
}
"""Each with the check that is meant to catch it."""
