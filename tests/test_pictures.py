"""Pictures are those of a run before: `python -m tests.pictures keep` writes anew what was meant to change."""

import pytest
from matplotlib.testing.compare import compare_images

from tests import pictures

NEAR = 3.0  # root mean square of the differences, of 255: other processors round other last digits
OF_ONE_BRANCH = pictures.PICTURES[: pictures.PICTURES.index(pictures.basins)]
DRAWN = [
    pytest.param(draw, id=draw.__name__, marks=pytest.mark.slow if draw in OF_ONE_BRANCH else pytest.mark.long)
    for draw in pictures.PICTURES
]


@pytest.mark.parametrize("draw", DRAWN)
def test_a_picture_is_that_of_a_run_before(draw, tmp_path):
    kept, drawn = pictures.KEPT / f"{draw.__name__}.png", tmp_path / "drawn.png"
    pictures.write(draw, drawn, pictures.DOTS)
    assert compare_images(kept, drawn, NEAR) is None


def test_every_picture_of_the_package_is_kept():
    """And no file is left of one that is drawn no more."""
    assert {each.stem for each in pictures.KEPT.glob("*.png")} == {draw.__name__ for draw in pictures.PICTURES}
