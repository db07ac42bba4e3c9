"""What several tests draw from."""

import numpy as np
from hypothesis import strategies as st

from services.physics import Array, norm


def vectors(limit: float, size: int = 3) -> st.SearchStrategy[Array]:
    return st.lists(st.floats(-limit, limit), min_size=size, max_size=size).map(np.array)


def unit(v: Array) -> Array:
    return v / norm(v)


FORCES = vectors(5.0)
UNIT = vectors(1.0).filter(lambda v: norm(v) > 0.1).map(unit)
QUATERNIONS = vectors(1.0, 4).filter(lambda q: norm(q) > 0.1).map(unit)
DT = st.floats(1e-4, 0.1)
