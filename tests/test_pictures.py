"""Pictures are those of an earlier run: `python -m tests.pictures keep` draws anew what was meant to change.

They hold what is not computed: colours, line styles, markers, legends, titles and labels of points.
"""

import pytest
from matplotlib.testing.compare import compare_images

from tests import pictures

TOLERANCE = 1.0  # root mean square of the differences, of 255: three pixels that differ by 200


@pytest.mark.parametrize("draw", pictures.PICTURES, ids=lambda draw: draw.__name__)
def test_a_picture_is_that_of_a_run_before(draw, tmp_path):
    kept, drawn = pictures.KEPT / f"{draw.__name__}.png", tmp_path / "drawn.png"
    pictures.write(draw, drawn, pictures.DOTS)
    assert compare_images(kept, drawn, TOLERANCE) is None


def test_every_picture_of_the_package_is_kept():
    assert {path.stem for path in pictures.KEPT.glob("*.png")} == {draw.__name__ for draw in pictures.PICTURES}
