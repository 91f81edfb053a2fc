from codecbench_posterize.codec import Posterize

from codecbench.pytesting.suite import CodecSuite


class TestPosterize(CodecSuite):
    codec = Posterize
