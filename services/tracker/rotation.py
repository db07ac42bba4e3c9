"""An attitude from the rotation matrix that some capture systems send. Pure."""

import math
from collections.abc import Sequence

Row = Sequence[float]


def from_matrix(rows: tuple[Row, Row, Row]) -> tuple[float, float, float, float]:
    """The unit quaternion, w first, of a rotation matrix by rows (Shepperd: divides by the largest of four candidates).

    Of a matrix with NaN it is not finite.
    """
    (a, b, c), (d, e, f), (g, h, i) = rows
    four = ((1 + a + e + i), (1 + a - e - i), (1 - a + e - i), (1 - a - e + i))
    largest = max(range(4), key=lambda n: four[n])
    s = 2.0 * math.sqrt(four[largest]) if four[largest] > 0 else math.nan
    w, x, y, z = (
        (s * s / 4, h - f, c - g, d - b),
        (h - f, s * s / 4, b + d, c + g),
        (c - g, b + d, s * s / 4, f + h),
        (d - b, c + g, f + h, s * s / 4),
    )[largest]
    return w / s, x / s, y / s, z / s
