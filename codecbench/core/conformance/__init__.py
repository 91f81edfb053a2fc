"""Checks of the codec contract, which authors can run on their own codecs.

    from codecbench.core.conformance.suite import run_checks
    for result in run_checks(MyCodec, MyCodec.params_type()):
        print(result)

`codecbench verify` runs them from the command line, `codecbench.pytesting.CodecSuite` under pytest.
"""
