"""Dark columns of a detector."""

import numpy as np

from gss.domain.dark_columns import DarkColumns


def test_rows_are_split_and_joined_in_the_order_of_the_read_out() -> None:
    """The first three and the last forty columns are dark (Jacobs 1995 §2.2.1.2)."""
    columns = DarkColumns(3, 40)
    picture = np.arange(2 * 795, dtype=np.uint16).reshape(2, 795)
    pixels, dark = columns.split(picture, 752)
    assert dark is not None
    assert (pixels == picture[:, 3:755]).all()
    assert (dark[0] == [0, 1, 2, *range(755, 795)]).all()
    assert (columns.join(pixels, dark) == picture).all()


def test_a_picture_without_dark_columns_is_unchanged() -> None:
    """Light-sensitive pixels, and pictures of a detector without dark columns, are returned as they are."""
    pixels = np.zeros((2, 752), np.uint8)
    for columns in (DarkColumns(3, 40), DarkColumns()):
        same, dark = columns.split(pixels, 752)
        assert same is pixels
        assert dark is None
        assert columns.join(pixels, None) is pixels
