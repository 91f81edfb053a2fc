from __future__ import annotations

import numpy as np

from codecbench import check_image


def test_an_image_is_copied_only_where_kernels_would_be_compiled_for_it_alone(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    assert check_image(image) is image
    read_only = image.copy()
    read_only.flags.writeable = False
    for given in (read_only, np.repeat(image, 2, axis=1)[:, ::2]):
        checked = check_image(given)
        np.testing.assert_array_equal(checked, image)
        assert checked.flags.c_contiguous
        assert checked.flags.writeable
