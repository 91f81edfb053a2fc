from codecbench_posterize.codec import Posterize

from codecbench.pytesting import CodecSuite


class TestPosterize(CodecSuite):
    codec = Posterize
