from codecbench_posterize.codec import Posterize

from codecbench.testing import CodecSuite


class TestPosterize(CodecSuite):
    codec = Posterize
